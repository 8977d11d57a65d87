// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics

// expected-error @+1 {{cannot differentiate by argument 0, which is no float but 'i32'}}
tai.kernel @integer(%n: i32, %a: f32) attributes {tai.gradients = array<i64: 0, 1>} {
  tai.return
}

// -----

// expected-error @+1 {{cannot differentiate by result 0, which is no float but 'i32'}}
tai.kernel @integer_result(%n: i32) -> i32 attributes {tai.gradients = array<i64: 1>} {
  tai.return %n : i32
}

// -----

// expected-error @+1 {{cannot differentiate by argument 0, which is no float but 'memref<?xi32>'}}
tai.kernel @integers(%n: memref<?xi32>) attributes {tai.gradients = array<i64: 0>} {
  tai.return
}

// -----

// expected-error @+1 {{cannot differentiate by position 2: there are 1 arguments and 1 results}}
tai.kernel @outside(%a: f32) -> f32 attributes {tai.gradients = array<i64: 0, 2>} {
  tai.return %a : f32
}

// -----

// expected-error @+1 {{expects 'gradients' to be an array of positions in ascending order, such as array<i64: 0, 2>}}
tai.kernel @twice(%a: f32) attributes {tai.gradients = array<i64: 0, 0>} {
  tai.return
}

// -----

// expected-error @+1 {{'tai.kernel' op attribute 'gradients' failed to satisfy constraint: i64 dense array attribute}}
tai.kernel @no_array(%a: f32) attributes {tai.gradients = 0 : i64} {
  tai.return
}

// -----

// The result has no rule, and its adjoint is wanted.
tai.kernel @no_rule(%a: f32) -> f32 attributes {tai.gradients = array<i64: 0, 1>} {
  // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops}}
  %0 = arith.bitcast %a : f32 to i32
  %1 = arith.bitcast %0 : i32 to f32
  tai.return %1 : f32
}

// -----

tai.tree @t : !tai.root<{loss: f32, loss_grad: f32}>
tai.field @loss_grad = @t["loss_grad"] : f32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @loss_grad

// expected-note @+1 {{differentiated by arguments or results here; use fields instead}}
tai.kernel @k(%a: f32) attributes {tai.gradients = array<i64: 0>} {
  tai.atomic add %a, @loss[] : f32
  tai.return
}

func.func @main() {
  %one = arith.constant 1.0 : f32
  tai.tape loss(@loss) {
    // expected-error @+1 {{a host program cannot launch '@k' under a tape: it has no memory for the adjoints of arguments and results}}
    tai.launch @k(%one) : (f32) -> ()
  }
  return
}
