// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics

tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32, x_grad: f32}>>>
tai.tree @d : !tai.root<dense<[i: 32], {y: f32, y_grad: f32}>>
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @d["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @d["y"] : f32, rank 1, adjoint @y_grad

// The former value would be needed again, and its adjoint become zero.
tai.kernel @clears() {
  tai.parallel_for (%i) in @x {
    // expected-note @+1 {{reads or writes it here; deactivate in a kernel of its own, or by 'deactivate_all' between kernels}}
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
    // expected-error @+1 {{cannot differentiate a kernel that deactivates cells of a tree which it reads or writes}}
    tai.deactivate @x[%i] level 2
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dynamic<[i: 64], chunk 8, {x: f32, x_grad: f32}>>
tai.tree @d : !tai.root<dense<[i: 32], {y: f32, y_grad: f32}>>
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @d["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @d["y"] : f32, rank 1, adjoint @y_grad

tai.kernel @appends() {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f32
    // expected-error @+2 {{a derivative is lost in 'tai.append', which cannot be differentiated}}
    // expected-note @+1 {{store the value to the element by an index; the list grows to the highest one}}
    %at = tai.append %0, @x[] : f32
  }
  tai.return
}

// Where the adjoint of the second store is cannot be found again.
tai.kernel @stores_to_the_new() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f32
    // expected-error @+1 {{the result of 'tai.append' is needed by the gradient and cannot be computed again}}
    %at = tai.append %zero, @x[] : f32
    tai.store %0, @x[%at] : f32
  }
  tai.return
}
