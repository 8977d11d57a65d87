// RUN: tai-opt %s --split-input-file --verify-diagnostics

// (kernel_c2)
// expected-error @+1 {{'tai.kernel' op argument 0 has type 'tensor<2xf32>'; expects a scalar, a vector, or a memref of them with the identity layout}}
tai.kernel @k(%a: tensor<2xf32>) {
  tai.return
}

// -----

// (kernel_c2)
// expected-error @+1 {{'tai.kernel' op argument 0 has type 'memref<2xmemref<2xf32>>'}}
tai.kernel @k(%a: memref<2xmemref<2xf32>>) {
  tai.return
}

// -----

// (kernel_c2)
// expected-error @+1 {{'tai.kernel' op argument 0 has type 'vector<[4]xf32>'}}
tai.kernel @k(%a: vector<[4]xf32>) {
  tai.return
}

// -----

// (kernel_c3)
// expected-error @+1 {{'tai.kernel' op expects at most one result, but got 2}}
tai.kernel @k(%a: f32) -> (f32, f32) {
  tai.return %a, %a : f32, f32
}

// -----

// (kernel_c3)
// expected-error @+1 {{'tai.kernel' op returns 'memref<2xf32>'; expects a scalar or a vector}}
tai.kernel @k(%a: memref<2xf32>) -> memref<2xf32> {
  tai.return %a : memref<2xf32>
}

// -----

// expected-note @+1 {{kernel defined here}}
tai.kernel @k(%a: f32) -> i32 {
  // (return_c1)
  // expected-error @+1 {{'tai.return' op expects operands of types ('i32'), but got ('f32')}}
  tai.return %a : f32
}

// -----

tai.kernel @k(%n: index) {
  tai.parallel_for (%i) = (%n) to (%n) {
    // (parallel_for_c3)
    // expected-error @+1 {{'tai.parallel_for' op cannot stand in another parallel loop; use 'scf.for'}}
    tai.parallel_for (%j) = (%n) to (%n) {
    }
  }
  tai.return
}

// -----

tai.kernel @k() {
  // (parallel_for_c4)
  // expected-error @+1 {{'tai.parallel_for' op expects at least one dimension}}
  tai.parallel_for () = () to () {
  }
  tai.return
}

// -----

tai.kernel @k() {
  // (parallel_for_c5)
  // expected-error @+1 {{'tai.parallel_for' op names '@x', which is not a field}}
  tai.parallel_for (%i) in @x {
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @k() {
  // (parallel_for_c5)
  // expected-error @+1 {{'tai.parallel_for' op expects 1 indices, but got 2}}
  tai.parallel_for (%i, %j) in @x {
  }
  tai.return
}

// -----

tai.kernel @k(%n: index) {
  // (parallel_for_c1)
  // expected-error @+1 {{'tai.parallel_for' op expects induction variables of type 'index', but got 'i32'}}
  "tai.parallel_for"(%n, %n) <{operandSegmentSizes = array<i32: 1, 1>}> ({
  ^bb0(%i: i32):
    tai.yield
  }) : (index, index) -> ()
  tai.return
}

// -----

tai.kernel @k(%n: index) {
  // (parallel_for_c4)
  // expected-error @+1 {{'tai.parallel_for' op expects 1 lower and upper bounds, but got 2 and 1}}
  "tai.parallel_for"(%n, %n, %n) <{operandSegmentSizes = array<i32: 2, 1>}> ({
  ^bb0(%i: index):
    tai.yield
  }) : (index, index, index) -> ()
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @k(%n: index) {
  // (parallel_for_c5)
  // expected-error @+1 {{'tai.parallel_for' op runs over a field and cannot take bounds}}
  "tai.parallel_for"(%n, %n) <{field = @x, operandSegmentSizes = array<i32: 1, 1>}> ({
  ^bb0(%i: index):
    tai.yield
  }) : (index, index) -> ()
  tai.return
}

// -----

tai.kernel @k() {
  // expected-error @+1 {{'tai.alloca' op expects a scalar or a vector, but got 'tensor<2xf32>'}}
  %0 = tai.alloca : !tai.local<tensor<2xf32>>
  tai.return
}

// -----

tai.kernel @k() {
  // expected-error @+1 {{'tai.stack_create' op expects a scalar of at most 64 bits, but got 'vector<2xf32>'}}
  %0 = tai.stack_create : !tai.stack<vector<2xf32>>
  tai.return
}

// -----

tai.kernel @k(%x: f64) {
  %0 = tai.stack_create : !tai.stack<f32>
  // expected-error @+1 {{'tai.stack_push' op failed to verify that the stack holds the type of the value}}
  "tai.stack_push"(%x, %0) : (f64, !tai.stack<f32>) -> ()
  tai.return
}

// -----

func.func @main() {
  // (launch_c1)
  // expected-error @+1 {{'tai.launch' op names '@k', which is not a kernel}}
  tai.launch @k() : () -> ()
  return
}

// -----

// expected-note @+1 {{kernel defined here}}
tai.kernel @k(%a: f32) {
  tai.return
}
func.func @main() {
  // (launch_c2)
  // expected-error @+1 {{'tai.launch' op expects the type '(f32) -> ()' of the kernel}}
  tai.launch @k() : () -> ()
  return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
func.func @main() {
  // (tape_c1)
  // expected-error @+1 {{'tai.tape' op expects the loss to be a float field of rank 0}}
  tai.tape loss(@x) {
  }
  return
}

// -----

tai.tree @t : !tai.root<{loss: f32}>
// expected-note @+1 {{field defined here}}
tai.field @loss = @t["loss"] : f32, rank 0
func.func @main() {
  // (tape_c2)
  // expected-error @+1 {{'tai.tape' op expects the loss to have an adjoint}}
  tai.tape loss(@loss) {
  }
  return
}

// -----

tai.tree @t : !tai.root<{loss: f32, g: f32, x: f32}>
tai.field @g = @t["g"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @g
func.func @main() {
  // (check_gradient_c2)
  // expected-error @+1 {{'tai_check.gradient' op expects field '@x' to have an adjoint}}
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
  }
  return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @k() {
  // (parallel_for_c2)
  // expected-error @+1 {{'tai.parallel_for' op expects a positive block_dim, but got 0}}
  tai.parallel_for (%i) in @x block_dim 0 {
  }
  tai.return
}

// -----

// Not in a loop: nothing of the kernel has run when a launch is refused.
tai.kernel @k(%ok: i1) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%c0) {
    // expected-error @+1 {{'tai.precondition' op expects parent op 'tai.kernel'}}
    tai.precondition %ok, "in a loop"
  }
  tai.return
}

// -----

// In the generic form a body may hold nothing.
// (kernel_c1)
// expected-error @+1 {{expects a body that ends with 'tai.return'}}
"tai.kernel"() <{function_type = () -> (), sym_name = "empty"}> ({
^bb0:
}) : () -> ()

// -----

// An attribute of another type is not left out.
// expected-error @+1 {{'tai.kernel' op attribute 'adjoint' failed to satisfy constraint}}
tai.kernel @k() attributes {adjoint = 3 : i32} {
  tai.return
}

// -----

tai.kernel @k(%n: index) {
  tai.parallel_for (%i) = (%n) to (%n) {
  // expected-error @+1 {{'tai.parallel_for' op attribute 'block_dim' failed to satisfy constraint}}
  } {block_dim = 0.5 : f32}
  tai.return
}

// -----

tai.tree @t : !tai.root<pointer<[i: 2], dense<[i: 4], {x: f32}>>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @k() {
  // (parallel_for_c6)
  // expected-error @+1 {{'tai.parallel_for' op names level 3 above @x, which has 2}}
  tai.parallel_for (%i) in @x level 3 {
  }
  tai.return
}
