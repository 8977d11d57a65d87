// RUN: tai-opt %s --tai-forward-diff --split-input-file --verify-diagnostics

// expected-error @below {{cannot make the tangent '@k_fwd': the name is taken}}
tai.kernel @k() {
  tai.return
}
// expected-note @below {{by this}}
func.func private @k_fwd()

// -----

!t = !tai.root<dense<[i: 4], {x: f32, d: f32}>>
tai.tree @t : !t
tai.field @d = @t["d"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, dual @d
tai.kernel @no_rule() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    // expected-error @below {{'arith.scaling_extf' has no tangent rule, but a tangent passes through it}}
    // expected-note @below {{compute the value from differentiable ops}}
    %y = arith.scaling_extf %x, %x : f32, f32 to f64
    %z = arith.truncf %y : f64 to f32
    tai.store %z, @x[%i] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 4], {x: f32, d: f32}>>
tai.tree @t : !t
tai.field @d = @t["d"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, dual @d
func.func private @f(f32) -> f32
tai.kernel @call() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    // expected-error @below {{cannot differentiate a call that was not inlined}}
    // expected-note @below {{run 'inline' first}}
    %y = func.call @f(%x) : (f32) -> f32
    tai.store %y, @x[%i] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 4], {x: f32, d: f32}>>
tai.tree @t : !t
tai.field @d = @t["d"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, dual @d
tai.kernel @view() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %m = memref.alloc() : memref<4xf32>
    // expected-error @below {{cannot differentiate 'memref.cast' on an array with a derivative}}
    // expected-note @below {{run '--fold-memref-alias-ops' before}}
    %v = memref.cast %m : memref<4xf32> to memref<?xf32>
    memref.store %x, %m[%c0] : memref<4xf32>
    %y = memref.load %v[%c0] : memref<?xf32>
    tai.store %y, @x[%i] : f32
  }
  tai.return
}

// -----

// Iterations of 'scf.parallel' cannot be put in order.
func.func @product(%x: memref<4xf32>, %p: memref<1xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  // expected-note @below {{use 'scf.for' here}}
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %v = memref.load %x[%i] : memref<4xf32>
    // expected-error @below {{may update this element at the same time, and its tangent cannot be kept in step}}
    %old = memref.atomic_rmw mulf %v, %p[%c0] : (f32, memref<1xf32>) -> f32
    scf.reduce
  }
  return
}

// -----

func.func @reduction(%x: memref<4xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f32
  // expected-error @below {{cannot differentiate a reduction that is not a sum}}
  // expected-note @below {{carry the value through an 'scf.for'}}
  %r = scf.parallel (%i) = (%c0) to (%c4) step (%c1) init (%one) -> f32 {
    %v = memref.load %x[%i] : memref<4xf32>
    scf.reduce(%v : f32) {
    ^bb0(%a: f32, %b: f32):
      %s = arith.mulf %a, %b : f32
      scf.reduce.return %s : f32
    }
  }
  memref.store %r, %x[%c0] : memref<4xf32>
  return
}

// -----

// expected-error @+2 {{cannot differentiate a function of several blocks; structured control flow is expected}}
// expected-note @+1 {{run '--lift-cf-to-scf' before}}
func.func @blocks(%x: memref<4xf32>) attributes {tai.differentiate} {
  cf.br ^bb1
^bb1:
  return
}
