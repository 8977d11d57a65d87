// RUN: tai-opt %s --tai-forward-diff --split-input-file --verify-diagnostics

// A region that hands on a tangent needs a rule.
func.func @yields(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{'scf.execute_region' has no tangent rule, but a tangent passes through it}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %r = scf.execute_region -> f64 {
    %0 = memref.load %x[%c0] : memref<4xf64>
    scf.yield %0 : f64
  }
  memref.store %r, %y[%c0] : memref<4xf64>
  return
}

// -----

// Errors inside of a region, a branch and each part of a loop are those of the
// function.
func.func @inside(%x: memref<4xf64>, %y: memref<4xf64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  scf.execute_region {
    %m = memref.alloc() : memref<1xf64>
    // expected-error @+2 {{cannot differentiate 'memref.cast' on an array with a derivative}}
    // expected-note @+1 {{run '--fold-memref-alias-ops' before}}
    %v = memref.cast %m : memref<1xf64> to memref<?xf64>
    memref.store %0, %m[%c0] : memref<1xf64>
    scf.yield
  }
  %positive = arith.cmpi sgt, %n, %c0 : index
  %b = scf.if %positive -> f64 {
    %m = memref.alloc() : memref<1xf64>
    // expected-error @+2 {{cannot differentiate 'memref.cast' on an array with a derivative}}
    // expected-note @+1 {{run '--fold-memref-alias-ops' before}}
    %v = memref.cast %m : memref<1xf64> to memref<?xf64>
    memref.store %0, %m[%c0] : memref<1xf64>
    scf.yield %0 : f64
  } else {
    scf.yield %0 : f64
  }
  %w:2 = scf.while (%k = %c0, %a = %b) : (index, f64) -> (index, f64) {
    %m = memref.alloc() : memref<1xf64>
    // expected-error @+2 {{cannot differentiate 'memref.cast' on an array with a derivative}}
    // expected-note @+1 {{run '--fold-memref-alias-ops' before}}
    %v = memref.cast %m : memref<1xf64> to memref<?xf64>
    memref.store %a, %m[%c0] : memref<1xf64>
    %go = arith.cmpi slt, %k, %n : index
    scf.condition(%go) %k, %a : index, f64
  } do {
  ^bb0(%k: index, %a: f64):
    %next = arith.addi %k, %c1 : index
    scf.yield %next, %a : index, f64
  }
  %u:2 = scf.while (%k = %c0, %a = %b) : (index, f64) -> (index, f64) {
    %go = arith.cmpi slt, %k, %n : index
    scf.condition(%go) %k, %a : index, f64
  } do {
  ^bb0(%k: index, %a: f64):
    %m = memref.alloc() : memref<1xf64>
    // expected-error @+2 {{cannot differentiate 'memref.cast' on an array with a derivative}}
    // expected-note @+1 {{run '--fold-memref-alias-ops' before}}
    %v = memref.cast %m : memref<1xf64> to memref<?xf64>
    memref.store %a, %m[%c0] : memref<1xf64>
    %next = arith.addi %k, %c1 : index
    scf.yield %next, %a : index, f64
  }
  %s = arith.addf %w#1, %u#1 : f64
  memref.store %s, %y[%c0] : memref<4xf64>
  return
}

// -----

// An array is no element of an array.
func.func @array_of_arrays(%x: memref<4xf64>, %y: memref<4xf64>, %z: memref<2xmemref<4xf64>>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  memref.store %0, %y[%c0] : memref<4xf64>
  // expected-error @+2 {{cannot differentiate 'memref.store' on an array with a derivative}}
  // expected-note @+1 {{access its elements by}}
  memref.store %y, %z[%c0] : memref<2xmemref<4xf64>>
  return
}

// -----

// A float from an op without a rule is refused even where nothing is stored.
func.func @no_rule(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  // expected-error @+2 {{'arith.scaling_extf' has no tangent rule, but a tangent passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops}}
  %1 = arith.scaling_extf %0, %0 : f64, f64 to f128
  memref.store %0, %y[%c0] : memref<4xf64>
  return
}

// -----

// A call may do anything to the arrays, even one without operands.
func.func private @note()
func.func @calls(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{cannot differentiate a call that was not inlined}}
  // expected-note @+1 {{run 'inline' first}}
  call @note() : () -> ()
  %0 = memref.load %x[%c0] : memref<4xf64>
  memref.store %0, %y[%c0] : memref<4xf64>
  return
}

// -----

// A constant in an array that has no tangent loses nothing; a tangent does.
func.func @untracked(%x: memref<4xf64>, %m: memref<4xmemref<4xf64>>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %half = arith.constant 0.5 : f64
  %a = memref.load %m[%c0] : memref<4xmemref<4xf64>>
  memref.store %half, %a[%c0] : memref<4xf64>
  %0 = memref.load %x[%c0] : memref<4xf64>
  // expected-error @+2 {{a tangent is lost in an array, which has none}}
  // expected-note @+1 {{store what has a tangent to a field with a dual}}
  memref.store %0, %a[%c0] : memref<4xf64>
  memref.store %0, %x[%c0] : memref<4xf64>
  return
}

// -----

// An element of the inner loop alone is met by all iterations of the outer one.
func.func @nested(%x: memref<4xf64>, %p: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    // expected-note @+1 {{use 'scf.for' here}}
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = memref.load %x[%i] : memref<4xf64>
      // expected-error @+1 {{may update this element at the same time, and its tangent cannot be kept in step}}
      memref.atomic_rmw mulf %0, %p[%j] : (f64, memref<4xf64>) -> f64
    }
  }
  return
}

// -----

// Of a field, too.
tai.tree @t : !tai.root<dense<[i: 4], {f: f64, df: f64}>>
tai.field @df = @t["df"] : f64, rank 1
tai.field @f = @t["f"] : f64, rank 1, dual @df
tai.kernel @field() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  // expected-note @+1 {{use 'scf.for' here}}
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %0 = tai.load @f[%i] : f64
    // expected-error @+1 {{may update this element at the same time, and its tangent cannot be kept in step}}
    tai.atomic mul %0, @f[%c0] : f64
  }
  tai.return
}

// -----

// A value from outside of a reduction is added as often as values are reduced.
func.func @sum_of_others(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f64
  %q = scf.for %i = %c0 to %c4 step %c1 iter_args(%a = %one) -> f64 {
    // expected-error @+2 {{cannot differentiate a reduction that is not a sum}}
    // expected-note @+1 {{carry the value through an 'scf.for'}}
    %r = scf.parallel (%k) = (%c0) to (%c4) step (%c1) init (%one) -> f64 {
      %v = memref.load %x[%k] : memref<4xf64>
      scf.reduce(%v : f64) {
      ^bb0(%l: f64, %r: f64):
        %s = arith.addf %l, %a : f64
        scf.reduce.return %s : f64
      }
    }
    scf.yield %r : f64
  }
  memref.store %q, %y[%c0] : memref<4xf64>
  return
}

// -----

func.func @twice_the_left(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f64
  %sum = arith.addf %one, %one : f64
  // expected-error @+2 {{cannot differentiate a reduction that is not a sum}}
  // expected-note @+1 {{carry the value through an 'scf.for'}}
  %r:2 = scf.parallel (%k) = (%c0) to (%c4) step (%c1) init (%one, %one) -> (f64, f64) {
    %v = memref.load %x[%k] : memref<4xf64>
    scf.reduce(%v, %v : f64, f64) {
    ^bb0(%l: f64, %r: f64):
      %s = arith.addf %l, %l : f64
      scf.reduce.return %s : f64
    }, {
    ^bb0(%l: f64, %r: f64):
      scf.reduce.return %sum : f64
    }
  }
  memref.store %r#0, %y[%c0] : memref<4xf64>
  memref.store %r#1, %y[%c1] : memref<4xf64>
  return
}
