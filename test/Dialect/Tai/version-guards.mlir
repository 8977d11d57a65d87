// RUN: tai-opt %s --tai-version-guards --canonicalize --split-input-file | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 64], {x: f64, gx: f64, gy: f64, p: i32}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @p = @t["p"] : i32, rank 1

// The product is tested; guards stand in the other branch alone.
// CHECK-LABEL: tai.kernel @scatter
//       CHECK:   %[[G:.+]] = tai.load @gy
//       CHECK:   %[[BARE:.+]] = arith.divf %[[G]], %[[X:.+]] : f64
//       CHECK:   %[[PRODUCT:.+]] = arith.mulf %[[BARE]], %[[X]] : f64
//   CHECK-NOT:   tai.guard
//       CHECK:   %[[TEST:.+]] = arith.mulf %[[PRODUCT]], %{{.+}} : f64
//       CHECK:   %[[FINITE:.+]] = arith.cmpf ord, %[[TEST]], %[[TEST]]
//       CHECK:   scf.if %[[FINITE]] {
//  CHECK-NEXT:     tai.atomic add %[[PRODUCT]]
//  CHECK-NEXT:   } else {
//       CHECK:     arith.cmpf oeq, %[[G]]
//       CHECK:     arith.select %{{.+}} {tai.guard}
//       CHECK:     arith.select %{{.+}} {tai.guard_infinite}
//       CHECK:     tai.atomic add
//       CHECK:   }
tai.kernel @scatter() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %g = tai.load @gy[%i] : f64
    %q = arith.divf %g, %x : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    %r = arith.mulf %a, %x : f64
    %drops = arith.cmpf oeq, %x, %zero : f64
    %b = arith.select %drops, %zero, %r {tai.guard_infinite} : f64
    tai.atomic add %b, @gx[%j] : f64
  }
  tai.return
}

// Lanes of a vector take both branches of what is tested.
// CHECK-LABEL: tai.kernel @elementwise
//   CHECK-NOT:   scf.if
//       CHECK:   tai.guard
tai.kernel @elementwise() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %g = tai.load @gy[%i] : f64
    %q = arith.divf %g, %x : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    %r = arith.mulf %a, %x : f64
    %drops = arith.cmpf oeq, %x, %zero : f64
    %b = arith.select %drops, %zero, %r {tai.guard_infinite} : f64
    tai.atomic add %b, @gx[%i] exclusive : f64
  }
  tai.return
}

// A quotient by what a guard has decided hides an infinite value: 1 / inf = 0.
// CHECK-LABEL: tai.kernel @divisor
//   CHECK-NOT:   scf.if
//       CHECK:   tai.guard
tai.kernel @divisor() {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %g = tai.load @gy[%i] : f64
    %q = arith.divf %g, %x : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    %b = arith.divf %one, %a : f64
    tai.atomic add %b, @gx[%j] : f64
  }
  tai.return
}

// Values that a loop carries come out of both branches.
// CHECK-LABEL: tai.kernel @carried
//       CHECK:   scf.for {{.*}} iter_args(%[[C:.+]] = %{{.+}})
//       CHECK:     %[[BARE:.+]] = arith.divf %[[C]]
//       CHECK:     %[[NEXT:.+]] = scf.if %{{.+}} -> (f64) {
//   CHECK-NOT:       tai.guard
//       CHECK:       scf.yield %[[BARE]]
//       CHECK:     } else {
//       CHECK:       tai.guard
//       CHECK:     scf.yield %[[NEXT]]
tai.kernel @carried() {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  tai.parallel_for (%i) in @x {
    %g = tai.load @gy[%i] : f64
    %d = scf.for %n = %c0 to %c9 step %c1 iter_args(%c = %g) -> f64 {
      %x = tai.load @x[%n] : f64
      %q = arith.divf %c, %x : f64
      %none = arith.cmpf oeq, %c, %zero : f64
      %a = arith.select %none, %zero, %q {tai.guard} : f64
      scf.yield %a : f64
    }
    tai.store %d, @gx[%i] : f64
  }
  tai.return
}

// What stands in a region behind the guards moves with it, and a region between
// them ends what is tested.
// CHECK-LABEL: tai.kernel @regions
//       CHECK:   %[[S:.+]] = scf.if %{{.+}} -> (f64)
//       CHECK:   scf.if %{{.+}} {
//       CHECK:     scf.if
//       CHECK:       tai.atomic add
//       CHECK:   } else {
//       CHECK:     tai.guard
//       CHECK:     scf.if
//       CHECK:       tai.atomic add
tai.kernel @regions() {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %g = tai.load @gy[%i] : f64
    %low = arith.cmpf olt, %x, %one : f64
    %s = scf.if %low -> f64 {
      %t = tai.load @x[%j] : f64
      scf.yield %t : f64
    } else {
      scf.yield %one : f64
    }
    %q = arith.divf %g, %s : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    %r = arith.mulf %a, %x : f64
    scf.if %low {
      tai.atomic add %r, @gx[%j] : f64
    }
  }
  tai.return
}
