// RUN: tai-opt %s --tai-expand-atomics --tai-make-adjoint --split-input-file --verify-diagnostics

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// A tape brings back what stood there before, for kernels alone.
func.func @in_function() attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    // expected-error @+2 {{iterations combine values at the same time, in a function that is no kernel}}
    // expected-note @+1 {{make it a kernel}}
    tai.atomic max %0, @y[%c0] : f64
  }
  return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// Nobody knows how often a loop runs before it does.
tai.kernel @while_loop(%to: i32) {
  %c0 = arith.constant 0 : index
  %z = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    // expected-note @+1 {{because of this loop}}
    scf.while (%k = %z) : (i32) -> i32 {
      %go = arith.cmpi slt, %k, %to : i32
      scf.condition(%go) %k : i32
    } do {
    ^bb0(%k: i32):
      %0 = tai.load @x[%i] : f64
      // expected-error @+2 {{how often an iteration combines its values with those of others is not known before the loop}}
      // expected-note @+1 {{combine them in a local variable first, and then that with the field}}
      tai.atomic max %0, @y[%c0] : f64
      %n = arith.addi %k, %one : i32
      scf.yield %n : i32
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// Nor where the first iteration, or the step, is read in the loop.
tai.kernel @lower() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    %k = tai.load @n[%i] : i32
    %l = arith.index_cast %k : i32 to index
    // expected-note @+1 {{because of this loop}}
    scf.for %j = %l to %c4 step %c1 {
      %0 = tai.load @x[%i] : f64
      // expected-error @+2 {{how often an iteration combines its values with those of others is not known before the loop}}
      // expected-note @+1 {{combine them in a local variable first, and then that with the field}}
      tai.atomic max %0, @y[%c0] : f64
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

tai.kernel @step() {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    %k = tai.load @n[%i] : i32
    %l = arith.index_cast %k : i32 to index
    // expected-note @+1 {{because of this loop}}
    scf.for %j = %c0 to %c4 step %l {
      %0 = tai.load @x[%i] : f64
      // expected-error @+2 {{how often an iteration combines its values with those of others is not known before the loop}}
      // expected-note @+1 {{combine them in a local variable first, and then that with the field}}
      tai.atomic max %0, @y[%c0] : f64
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// The value is one of several that the iteration stores to the element.
tai.kernel @overwritten() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.sin %0 : f64
    tai.store %1, @x[%i] : f64
    // expected-error @+2 {{the value read here decides on a value that iterations combine, and is overwritten by the loop}}
    // expected-note @+1 {{combine the values in a loop of its own}}
    %2 = tai.load @x[%i] : f64
    %3 = math.exp %2 : f64
    tai.store %3, @x[%i] : f64
    tai.atomic max %2, @y[%c0] : f64
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// The gradient adds to what decides.
tai.kernel @adjoint_read() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    // expected-error @+2 {{the value read here is needed by the gradient, but is an adjoint that the gradient itself accumulates}}
    // expected-note @+1 {{copy the adjoint to a field of its own first}}
    %g = tai.load @x_grad[%i] : f64
    %1 = arith.mulf %0, %g : f64
    tai.atomic max %1, @y[%c0] : f64
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// There is no room for a number of each element.
tai.kernel @too_many() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @n[%i] : i32
    %l = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f64
    // expected-error @+2 {{the gradient needs room for every element of the field that iterations combine here, and they are too many}}
    // expected-note @+1 {{combine into a smaller field}}
    tai.atomic max %0, @h[%l, %l] : f64
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// Whether the two rows are one is not known.
tai.kernel @other_row(%k: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %m = tai.load @n[%i] : i32
    %l = arith.index_cast %m : i32 to index
    // expected-note @+1 {{read here}}
    %0 = tai.load @z[%l, %c1] : f64
    // expected-error @+2 {{an element that iterations combine at the same time is also accessed in another way}}
    // expected-note @+1 {{do this in a loop of its own}}
    tai.atomic max %0, @z[%c0, %k] : f64
  }
  tai.return
}
