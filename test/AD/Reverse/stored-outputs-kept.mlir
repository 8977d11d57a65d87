// RUN: tai-opt %s --tai-make-adjoint=stored-outputs | FileCheck %s

// Stores whose value an adjoint cannot load: no second form is made.

// CHECK-NOT: stored_form
// CHECK-NOT: _grad_stored

!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, z: f64, gz: f64, n: i32, ni: i32, gi: i32}>, dense<[i: 8, j: 8], {s: f64, gs: f64}>, bitmasked<[i: 16], {h: f64, gh: f64}>, dense<[i: 8], {v: vector<2xf64>, gv: vector<2xf64>}>>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @gz = @t["gz"] : f64, rank 1
tai.field @gs = @t["gs"] : f64, rank 2
tai.field @gh = @t["gh"] : f64, rank 1
tai.field @gi = @t["gi"] : i32, rank 1
tai.field @gv = @t["gv"] : vector<2xf64>, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @z = @t["z"] : f64, rank 1, adjoint @gz
tai.field @s = @t["s"] : f64, rank 2, adjoint @gs
tai.field @h = @t["h"] : f64, rank 1, adjoint @gh
tai.field @ni = @t["ni"] : i32, rank 1, adjoint @gi
tai.field @v = @t["v"] : vector<2xf64>, rank 1, adjoint @gv
tai.field @n = @t["n"] : i32, rank 1

// The index is computed by too many ops, or by a branch.
tai.kernel @deep_index(%k: index) {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %i0 = arith.addi %i, %k : index
    %i1 = arith.addi %i0, %c1 : index
    %i2 = arith.addi %i1, %c1 : index
    %i3 = arith.addi %i2, %c1 : index
    %i4 = arith.addi %i3, %c1 : index
    %i5 = arith.addi %i4, %c1 : index
    %i6 = arith.addi %i5, %c1 : index
    %i7 = arith.addi %i6, %c1 : index
    %i8 = arith.addi %i7, %c1 : index
    %i9 = arith.addi %i8, %c1 : index
    %i10 = arith.addi %i9, %c1 : index
    %i11 = arith.addi %i10, %c1 : index
    %i12 = arith.addi %i11, %c1 : index
    %i13 = arith.addi %i12, %c1 : index
    %i14 = arith.addi %i13, %c1 : index
    %i15 = arith.addi %i14, %c1 : index
    %i16 = arith.addi %i15, %c1 : index
    %i17 = arith.addi %i16, %c1 : index
    %i18 = arith.addi %i17, %c1 : index
    %i19 = arith.addi %i18, %c1 : index
    %i20 = arith.addi %i19, %c1 : index
    tai.store %1, @y[%i20] : f64
  }
  tai.return
}
tai.kernel @branch_index(%k: i1) {
  %c1 = arith.constant 1 : index
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %j = scf.if %k -> index {
      scf.yield %i : index
    } else {
      scf.yield %c0 : index
    }
    tai.store %1, @y[%j] : f64
  }
  tai.return
}

// A cell may not be there; a tape does not watch gradients; a component that a
// field names is one of several.
tai.kernel @cells() {
  tai.parallel_for (%i) in @h {
    %0 = tai.load @h[%i] : f64
    %1 = math.tanh %0 : f64
    %2 = arith.mulf %1, %1 : f64
    tai.store %1, @h[%i] : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}
tai.kernel @to_gradient() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %2 = arith.mulf %1, %1 : f64
    tai.store %1, @gz[%i] : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}
tai.kernel @component(%k: index) {
  tai.parallel_for (%i) in @v {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %2 = arith.mulf %1, %1 : f64
    %m = tai.load @n[%i] : i32
    %j = arith.index_cast %m : i32 to index
    tai.store %1, @v[%i] component [%j] : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}

// Another iteration stores to the element: of the outer loop, too.
tai.kernel @nested_parallel() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    scf.parallel (%j) = (%c0) to (%c8) step (%c1) {
      %0 = tai.load @s[%i, %j] : f64
      %1 = math.tanh %0 : f64
      tai.store %1, @y[%j] : f64
    }
  }
  tai.return
}

// A branch that stores is not always taken, and the last value is not the former
// one.
tai.kernel @other_block(%k: i1) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %2 = arith.mulf %1, %1 : f64
    scf.if %k {
      tai.store %1, @z[%i] : f64
    }
    tai.store %2, @y[%i] : f64
  }
  tai.return
}

// The gradient adds to what the kernel adds to.
tai.kernel @accumulated() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    %2 = arith.mulf %1, %1 : f64
    tai.store %2, @y[%i] : f64
    tai.atomic add %1, @gz[%i] : f64
  }
  tai.return
}

// A function has no tape.
func.func @no_kernel() attributes {tai.differentiate} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.tanh %0 : f64
    tai.store %1, @y[%i] : f64
  }
  return
}
