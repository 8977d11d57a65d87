// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

// Iterations that are run again with loops whose count nobody needs, and in two
// places of one kernel.

!t = !tai.root<dense<[i: 16], {x: f64, gx: f64, y: f64, gy: f64, n: i32, c: i32}>, {a: f64, ga: f64}>
tai.tree @t : !t
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @ga = @t["ga"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @a = @t["a"] : f64, rank 0, adjoint @ga
tai.field @n = @t["n"] : i32, rank 1
tai.field @c = @t["c"] : i32, rank 1

// A loop that records nothing is repeated as it is, without a count.
// CHECK-LABEL: tai.kernel @while_inside_grad(
//       CHECK:     scf.while (%{{.+}} = %{{.+}}, %{{.+}} = %{{.+}}) : (index, f64) -> {{.*}}f64
//       CHECK:     tai.store %{{.+}}, @x
//       CHECK:   tai.return
tai.kernel @while_inside(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %half = arith.constant 0.5 : f64
  tai.parallel_for (%i) in @x {
    %w:2 = scf.while (%k = %c0, %f = %half) : (index, f64) -> (index, f64) {
      %go = arith.cmpi slt, %k, %n : index
      scf.condition(%go) %k, %f : index, f64
    } do {
    ^bb0(%k: index, %f: f64):
      %k2 = arith.addi %k, %c1 : index
      %f2 = arith.mulf %f, %half : f64
      scf.yield %k2, %f2 : index, f64
    }
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %w#1 : f64
    %2 = math.sin %1 : f64
    tai.store %2, @x[%i] : f64
    %3 = tai.load @x[%i] : f64
    %5 = math.sin %3 : f64
    tai.store %5, @x[%i] : f64
  }
  tai.return
}

// Serial code, and then each iteration of a loop that takes a value of it.
// CHECK-LABEL: tai.kernel @two_places_grad() attributes {{.*}}reexecutes
//       CHECK:   %[[A:.+]] = tai.load @a[]
//       CHECK:   tai.store %{{.+}}, @a[]
//       CHECK:   tai.load @a[]
//       CHECK:   tai.parallel_for
//       CHECK:     tai.load @x
//       CHECK:     tai.store %{{.+}}, @x
//       CHECK:   tai.return
tai.kernel @two_places() {
  %c0 = arith.constant 0 : index
  %0 = tai.load @a[] : f64
  %1 = math.sin %0 : f64
  tai.store %1, @a[] : f64
  %2 = tai.load @a[] : f64
  %3 = math.exp %2 : f64
  tai.store %3, @a[] : f64
  tai.parallel_for (%i) in @x {
    %4 = tai.load @x[%i] : f64
    %5 = arith.mulf %4, %2 : f64
    %6 = math.sin %5 : f64
    tai.store %6, @x[%i] : f64
    %7 = tai.load @x[%i] : f64
    %8 = math.sin %7 : f64
    tai.store %8, @x[%i] : f64
  }
  tai.return
}

// A value of a branch, which the adjoint asks for outside of it.
// CHECK-LABEL: tai.kernel @in_branch_grad(
//       CHECK:     scf.if
//       CHECK:     tai.store %{{.+}}, @x
//       CHECK:   tai.return
tai.kernel @in_branch(%c: i1) {
  tai.parallel_for (%i) in @x {
    %r = scf.if %c -> f64 {
      %0 = tai.load @x[%i] : f64
      %1 = math.sin %0 : f64
      scf.yield %1 : f64
    } else {
      %0 = tai.load @x[%i] : f64
      scf.yield %0 : f64
    }
    %s = math.exp %r : f64
    tai.store %s, @x[%i] : f64
    %2 = tai.load @x[%i] : f64
    %3 = arith.mulf %2, %r : f64
    %4 = math.sin %3 : f64
    tai.store %4, @x[%i] : f64
  }
  tai.return
}
