// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics

// A program without a derivative is refused at its line, with a remedy.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, n: i32, plain: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @n = @t["n"] : i32, rank 1
tai.field @plain = @t["plain"] : f32, rank 1

// In serial code, an atomic is a load and a store.
tai.kernel @serial_maximum() {
  %c0 = arith.constant 0 : index
  %0 = tai.load @x[%c0] : f32
  // expected-error @+2 {{cannot differentiate this read-modify-write of a field with an adjoint}}
  // expected-note @+1 {{run 'tai-expand-atomics' first, or write it as a load and a store}}
  tai.atomic max %0, @y[%c0] : f32
  tai.return
}

// The read value depends on the iterations that have run.
tai.kernel @maximum_so_far() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{an element that iterations combine at the same time is also accessed in another way}}
    // expected-note @+1 {{do this in a loop of its own}}
    tai.atomic max %0, @y[%c0] : f32
    // expected-note @+1 {{read here}}
    %1 = tai.load @y[%c0] : f32
    tai.atomic add %1, @x[%i] : f32
  }
  tai.return
}

// The order of a sum and a product decides.
tai.kernel @two_kinds() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{an element that iterations combine at the same time is also accessed in another way}}
    // expected-note @+1 {{do this in a loop of its own}}
    tai.atomic mul %0, @y[%c0] : f32
    // expected-note @+1 {{written here}}
    tai.atomic add %0, @y[%c0] : f32
  }
  tai.return
}

// The gradient needs the element as it was before the loop.
tai.kernel @cleared_before() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f32
  // expected-note @+1 {{written here}}
  tai.store %zero, @y[%c0] : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{an element that iterations combine at the same time is also accessed outside of the loop}}
    // expected-note @+1 {{do this in a kernel of its own}}
    tai.atomic max %0, @y[%c0] : f32
  }
  tai.return
}

// How many values there will be is not known before the loop.
tai.kernel @as_often_as_a_field_says() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @n[%i] : i32
    %2 = arith.index_cast %1 : i32 to index
    // expected-note @+1 {{because of this loop}}
    scf.for %j = %c0 to %2 step %c1 {
      // expected-error @+2 {{how often an iteration combines its values with those of others is not known before the loop}}
      // expected-note @+1 {{combine them in a local variable first, and then that with the field}}
      tai.atomic min %0, @y[%c0] : f32
    }
  }
  tai.return
}

// The condition depends on the order of iterations.
tai.kernel @first_come() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %ten = arith.constant 10 : i32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{the value before the update is needed by the gradient, but is gone when the gradient runs}}
    // expected-note @+1 {{store it to a field}}
    %1 = tai.atomic add %one, @n[%c0] : i32
    %2 = arith.cmpi slt, %1, %ten : i32
    scf.if %2 {
      tai.atomic max %0, @y[%c0] : f32
    }
  }
  tai.return
}

tai.kernel @old_value() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{the value before the accumulation is used in what the gradient is taken of}}
    // expected-note @+1 {{an element must not be read before its accumulation is done; load it in a later loop}}
    %1 = tai.atomic add %0, @y[%c0] : f32
    tai.atomic add %1, @x[%i] : f32
  }
  tai.return
}

// The slot that a counter gave away cannot be found again.
tai.kernel @counter() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value before the update is needed by the gradient, but is gone when the gradient runs}}
    // expected-note @+1 {{store it to a field that nothing else writes, and load it from there}}
    %0 = tai.atomic add %one, @n[%c0] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    tai.store %2, @y[%1] : f32
  }
  tai.return
}

// The gradient would read the field it is adding to.
tai.kernel @reads_adjoint() {
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value read here is needed by the gradient, but is an adjoint that the gradient itself accumulates}}
    // expected-note @+1 {{copy the adjoint to a field of its own first}}
    %0 = tai.load @x_grad[%i] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.mulf %0, %1 : f32
    tai.store %2, @y[%i] : f32
  }
  tai.return
}

// Bits have no derivative, and a float must not pass through them unseen.
tai.kernel @bits() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
    // expected-note @+1 {{compute the value from differentiable ops, or keep it out of what the gradient is taken of}}
    %1 = arith.bitcast %0 : f32 to i32
    %2 = arith.bitcast %1 : i32 to f32
    tai.store %2, @y[%i] : f32
  }
  tai.return
}

// The reverse of an ordered loop runs the other way.
tai.kernel @random_in_order() {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) serialize {
    // expected-error @+2 {{a random number drawn here is needed by the gradient, whose iterations run in another order}}
    // expected-note @+1 {{draw it in a serial loop inside of a parallel one, or store it to a field in a kernel of its own}}
    %u = tai.random stream 0 : f32
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %u : f32
    tai.atomic add %1, @y[%c0] : f32
  }
  tai.return
}

// Parallel loops in a serial one are run many times: no launch has one state.
tai.kernel @parallel_in_serial() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %t = %c0 to %c4 step %c1 {
    tai.parallel_for (%i) in @x {
      // expected-error @+2 {{the value read here is needed by the gradient, but is overwritten}}
      // expected-note @+1 {{store the new value to another element}}
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      // expected-note @+2 {{overwritten here}}
      // expected-note @+1 {{and what stood there before is replaced here}}
      tai.store %1, @x[%i] : f32
    }
  }
  tai.return
}

// Both loops need what x held before them.
tai.kernel @two_loops() {
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{the value read here is needed by the gradient, but is overwritten}}
    // expected-note @+1 {{store the new value to another element}}
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    // expected-note @+2 {{overwritten here}}
    // expected-note @+1 {{and what stood there before is replaced here}}
    tai.store %1, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    // expected-note @+1 {{the gradient also needs the value read here}}
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

func.func private @helper(%v: f32) -> f32 {
  tai.print "{}"(%v) : f32
  return %v : f32
}
tai.kernel @call() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+2 {{a derivative is lost in 'func.call', which cannot be differentiated}}
    // expected-note @+1 {{run 'inline' first}}
    %1 = func.call @helper(%0) : (f32) -> f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// -----

// expected-note @+1 {{by this}}
func.func @k_grad() {
  return
}
// expected-error @+1 {{cannot make the adjoint '@k_grad': the name is taken}}
tai.kernel @k() {
  tai.return
}

// -----

func.func @copy(%x: memref<?xf32>, %y: memref<?xf32>) attributes {tai.differentiate} {
  // expected-error @+2 {{cannot differentiate 'memref.copy' on an array with a derivative}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  memref.copy %x, %y : memref<?xf32> to memref<?xf32>
  return
}

// -----

func.func @product(%x: memref<4xf32>, %out: memref<f32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f32
  // expected-error @+2 {{cannot differentiate a reduction that is not a sum}}
  // expected-note @+1 {{carry the value through an 'scf.for'}}
  %p = scf.parallel (%i) = (%c0) to (%c4) step (%c1) init (%one) -> f32 {
    %v = memref.load %x[%i] : memref<4xf32>
    scf.reduce(%v : f32) {
    ^bb0(%l: f32, %r: f32):
      %m = arith.mulf %l, %r : f32
      scf.reduce.return %m : f32
    }
  }
  memref.store %p, %out[] : memref<f32>
  return
}

// -----

// The former contents of the caller's array cannot be restored.
// expected-warning @+2 {{'@in_place_grad' runs '@in_place' again, on copies: call it with the arrays as they are before '@in_place'}}
// expected-note @+1 {{this concerns the arguments at the positions 0}}
func.func @in_place(%x: memref<?xf32>, %y: memref<?xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<?xf32>
  %1 = arith.mulf %0, %0 : f32
  memref.store %1, %x[%c0] : memref<?xf32>
  return
}

// -----

// expected-error @+2 {{cannot differentiate a function of several blocks; structured control flow is expected}}
// expected-note @+1 {{run '--lift-cf-to-scf' before}}
func.func @blocks(%x: memref<4xf32>) attributes {tai.differentiate} {
  cf.br ^next
^next:
  return
}

// -----

// How many copies there are is known when this runs alone.
func.func @scalable(%x: memref<f32>, %y: memref<f32>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f32>
  // expected-error @+2 {{'vector.broadcast' has no derivative rule for scalable vectors, but a gradient passes through it}}
  // expected-note @+1 {{use vectors of a fixed length}}
  %1 = vector.broadcast %0 : f32 to vector<[4]xf32>
  %2 = math.sin %1 : vector<[4]xf32>
  %3 = vector.reduction <add>, %2 : vector<[4]xf32> into f32
  memref.store %3, %y[] : memref<f32>
  return
}

// -----

func.func @scalable_array(%x: memref<4xvector<[2]xf32>>, %y: memref<f32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{'memref.load' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field or from an argument that is a memref of floats}}
  %0 = memref.load %x[%c0] : memref<4xvector<[2]xf32>>
  %1 = vector.reduction <add>, %0 : vector<[2]xf32> into f32
  memref.store %1, %y[] : memref<f32>
  return
}

// -----

// expected-error @+1 {{cannot differentiate by argument 0, which is no float but 'vector<[2]xf32>'}}
func.func @scalable_argument(%x: vector<[2]xf32>, %y: memref<f32>)
    attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  %0 = vector.reduction <add>, %x : vector<[2]xf32> into f32
  memref.store %0, %y[] : memref<f32>
  return
}

// -----

// Nothing says how memory holds a complex number for each iteration.
func.func @carried_complex(%x: memref<4xf64>, %y: memref<f64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f64
  %z = complex.constant [1.0, 0.5] : complex<f64>
  // expected-error @+2 {{the gradient needs the values that this loop carries, but those of type 'complex<f64>' cannot be recorded}}
  // expected-note @+1 {{carry numbers, or vectors of a fixed length}}
  %r:2 = scf.for %i = %c0 to %n step %c1 iter_args(%s = %z, %a = %one) -> (complex<f64>, f64) {
    %v = memref.load %x[%i] : memref<4xf64>
    %re = complex.re %s : complex<f64>
    %p = arith.mulf %a, %re : f64
    %q = arith.mulf %p, %v : f64
    %t = complex.mul %s, %s : complex<f64>
    scf.yield %t, %q : complex<f64>, f64
  }
  memref.store %r#1, %y[] : memref<f64>
  return
}

// -----

func.func private @elsewhere(f32) -> f32
func.func @calls(%x: memref<f32>, %y: memref<f32>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f32>
  // expected-error @+2 {{a derivative is lost in 'func.call', which cannot be differentiated}}
  // expected-note @+1 {{run 'inline' first}}
  %1 = func.call @elsewhere(%0) : (f32) -> f32
  memref.store %1, %y[] : memref<f32>
  return
}

// -----

func.func @unsigned(%x: memref<f64>, %y: memref<f64>, %n: i32) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{cannot reverse a loop with unsigned bounds}}
  // expected-note @+1 {{count in 'index'}}
  %r = scf.for unsigned %i = %c0 to %n step %c1 iter_args(%a = %0) -> (f64) : i32 {
    %m = arith.mulf %a, %0 : f64
    scf.yield %m : f64
  }
  memref.store %r, %y[] : memref<f64>
  return
}
