// RUN: tai-opt %s --tai-version-guards --canonicalize --split-input-file | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 64], {x: f64, gx: f64, gy: f64, p: i32}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @p = @t["p"] : i32, rank 1

// A quotient says that its divisor is not zero. It is tested before the guards;
// these stand in the other branch alone.
// CHECK-LABEL: tai.kernel @scatter
//       CHECK:   %[[X:.+]] = tai.load @x
//       CHECK:   %[[BARE:.+]] = arith.divf %{{.+}}, %[[X]] : f64
//   CHECK-NOT:   tai.guard
//       CHECK:   %[[TEST:.+]] = arith.mulf %[[BARE]], %{{.+}} : f64
//       CHECK:   %[[FINITE:.+]] = arith.cmpf ord, %[[TEST]], %[[TEST]]
//       CHECK:   %[[LIKELY:.+]] = llvm.intr.expect %[[FINITE]]
//       CHECK:   scf.if %[[LIKELY]] {
//  CHECK-NEXT:     %[[PRODUCT:.+]] = arith.mulf %[[BARE]], %[[X]] : f64
//  CHECK-NEXT:     tai.atomic add %[[PRODUCT]]
//  CHECK-NEXT:   } else {
//       CHECK:     arith.cmpf oeq
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

// Lanes of a vector take both branches of a test.
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

// A quotient by the result of a guard hides an infinite value: 1 / inf = 0.
// The operands of the second partial come behind the first guard, so that there
// is no test in front of both.
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
    %y = tai.load @gx[%i] : f64
    %r = arith.divf %g, %y : f64
    %c = arith.select %none, %zero, %r {tai.guard} : f64
    %d = arith.divf %one, %c : f64
    tai.atomic add %d, @gx[%j] : f64
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

// Code in a region behind the guards moves with it, and a region between them
// ends the tested part.
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

// A quotient and a logarithm that are finite show that their operands are not
// zero: one sum of both is tested. The conditions stand behind the first guard,
// and are moved in front of it.
// CHECK-LABEL: tai.kernel @witnesses
//       CHECK:   arith.divf
//       CHECK:   %[[U:.+]] = arith.divf
//       CHECK:   %[[L:.+]] = math.log
//       CHECK:   %[[SUM:.+]] = arith.addf %[[U]], %[[L]]
//       CHECK:   %[[TEST:.+]] = arith.mulf %[[SUM]]
//       CHECK:   %[[FINITE:.+]] = arith.cmpf ord, %[[TEST]], %[[TEST]]
//  CHECK-NEXT:   %[[LIKELY:.+]] = llvm.intr.expect %[[FINITE]]
//       CHECK:   scf.if %[[LIKELY]]
//   CHECK-NOT:     tai.guard
//       CHECK:   } else {
tai.kernel @witnesses() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %y = tai.load @x[%j] : f64
    %g = tai.load @gy[%i] : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %q = arith.divf %g, %x : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    %u = arith.divf %y, %x : f64
    %r = arith.mulf %q, %u : f64
    %b = arith.select %none, %zero, %r {tai.guard} : f64
    %l = math.log %y : f64
    %m = arith.mulf %g, %l : f64
    %c = arith.select %none, %zero, %m {tai.guard} : f64
    %s = arith.divf %g, %y : f64
    %d = arith.select %none, %zero, %s {tai.guard} : f64
    %ab = arith.addf %a, %b : f64
    %cd = arith.addf %c, %d : f64
    tai.atomic add %ab, @gx[%j] : f64
    tai.atomic add %cd, @gx[%i] : f64
  }
  tai.return
}

// A loop-carried value may be infinite since an earlier iteration. It is
// tested, by a quotient of it, where an infinite adjoint has a guard.
// CHECK-LABEL: tai.kernel @carried_infinite
//       CHECK:   scf.for {{.*}} iter_args(%[[C:.+]] = %{{.+}})
//       CHECK:     %[[Q:.+]] = arith.divf %[[C]], %{{.+}}
//       CHECK:     %[[TEST:.+]] = arith.mulf %[[Q]]
//       CHECK:     arith.cmpf ord, %[[TEST]], %[[TEST]]
//       CHECK:     llvm.intr.expect
//       CHECK:     scf.if %{{.+}} -> (f64) {
//   CHECK-NOT:       tai.guard
//       CHECK:     } else {
tai.kernel @carried_infinite() {
  %zero = arith.constant 0.0 : f64
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
      %r = arith.mulf %a, %x : f64
      %drops = arith.cmpf oeq, %x, %zero : f64
      %b = arith.select %drops, %zero, %r {tai.guard_infinite} : f64
      %t = arith.mulf %b, %x : f64
      %e = arith.select %drops, %zero, %t {tai.guard_infinite} : f64
      scf.yield %e : f64
    }
    tai.store %d, @gx[%i] : f64
  }
  tai.return
}

// An adjoint that is infinite in front of a loop: the guard there has no part in
// the test of the loop, which is of the adjoint itself and not of the root's
// operand.
// CHECK-LABEL: tai.kernel @infinite_around
//       CHECK:   %[[SUM:.+]] = tai.load @x
//       CHECK:   %[[SEED:.+]] = arith.select %{{.+}}, %{{.+}}, %{{.+}} {tai.guard}
//       CHECK:   %[[TEST:.+]] = arith.mulf %[[SEED]]
//       CHECK:   %[[FINITE:.+]] = arith.cmpf ord, %[[TEST]], %[[TEST]]
//       CHECK:   scf.for
//       CHECK:     llvm.intr.expect %[[FINITE]]
tai.kernel @infinite_around() {
  %zero = arith.constant 0.0 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  tai.parallel_for (%i) in @x {
    %s = tai.load @x[%i] : f64
    %root = math.sqrt %s : f64
    %g = tai.load @gy[%i] : f64
    %q = arith.divf %g, %root : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    scf.for %n = %c0 to %c9 step %c1 {
      %x = tai.load @x[%n] : f64
      %r = arith.mulf %a, %x : f64
      %drops = arith.cmpf oeq, %x, %zero : f64
      %b = arith.select %drops, %zero, %r {tai.guard_infinite} : f64
      tai.atomic add %b, @gx[%n] : f64
    }
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 64], {x: f64, y: f64, gx: f64, gy: f64, p: i32, d: vector<3xf64>, gd: vector<3xf64>}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @y = @t["y"] : f64, rank 1
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @p = @t["p"] : i32, rank 1
tai.field @d = @t["d"] : vector<3xf64>, rank 1
tai.field @gd = @t["gd"] : vector<3xf64>, rank 1

// A branch between the guards, with one that depends on values that the branch
// alone computes: each part has a test, and the last one also of the branch's
// results. The guarded code behind the first test has none of these.
// CHECK-LABEL: tai.kernel @parts
//       CHECK:   %[[FIRST:.+]] = llvm.intr.expect
//       CHECK:   scf.if %[[FIRST]] {
//   CHECK-NOT:     tai.guard
//       CHECK:     %[[OUT:.+]] = scf.if %{{.+}} -> (f64) {
//       CHECK:       %[[SECOND:.+]] = llvm.intr.expect
//       CHECK:       scf.if %[[SECOND]]
//   CHECK-NOT:         tai.guard
//       CHECK:       } else {
//       CHECK:         tai.guard
//       CHECK:     %[[TEST:.+]] = arith.mulf %[[OUT]], %{{.+}} : f64
//       CHECK:     %[[FINITE:.+]] = arith.cmpf ord, %[[TEST]], %[[TEST]]
//       CHECK:     %[[THIRD:.+]] = llvm.intr.expect %[[FINITE]]
//       CHECK:     scf.if %[[THIRD]] {
//   CHECK-NOT:       tai.guard
//       CHECK:       tai.atomic add
//       CHECK:     } else {
//       CHECK:       tai.guard_infinite
//       CHECK:       tai.atomic add
//       CHECK:   } else {
//       CHECK:     tai.guard
//   CHECK-NOT:     llvm.intr.expect
//       CHECK:   tai.return
tai.kernel @parts() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %g = tai.load @gy[%i] : f64
    %q = arith.divf %g, %x : f64
    %none = arith.cmpf oeq, %g, %zero : f64
    %a = arith.select %none, %zero, %q {tai.guard} : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %s = scf.if %c -> (f64) {
      %y = tai.load @y[%j] : f64
      %z = arith.subf %y, %x : f64
      %r = arith.divf %a, %z : f64
      %no = arith.cmpf oeq, %a, %zero : f64
      %b = arith.select %no, %zero, %r {tai.guard} : f64
      tai.atomic add %b, @gy[%j] : f64
      scf.yield %b : f64
    } else {
      scf.yield %a : f64
    }
    %m = arith.mulf %s, %x : f64
    %drops = arith.cmpf oeq, %x, %zero : f64
    %e = arith.select %drops, %zero, %m {tai.guard_infinite} : f64
    tai.atomic add %e, @gx[%j] : f64
  }
  tai.return
}

// The power of a norm that is large enough says that the norm is not zero, and
// one comparison with infinity that it is finite.
// CHECK-LABEL: tai.kernel @norm
//       CHECK:   %[[N:.+]] = tai.norm
//       CHECK:   %[[P:.+]] = arith.mulf %[[N]], %[[N]] : f64
//       CHECK:   %[[LARGE:.+]] = arith.cmpf oge, %[[P]]
//       CHECK:   %[[SMALL:.+]] = arith.cmpf olt, %[[P]]
//       CHECK:   arith.andi %[[LARGE]], %[[SMALL]]
//       CHECK:   scf.if
//   CHECK-NOT:     arith.select
//       CHECK:   } else {
//       CHECK:     arith.select
tai.kernel @norm() {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  %zeros = arith.constant dense<0.0> : vector<3xf64>
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %d = tai.load @d[%i] : vector<3xf64>
    %n = tai.norm %d : vector<3xf64>
    %p = arith.mulf %n, %n : f64
    %g = tai.load @gd[%i] : vector<3xf64>
    %pb = vector.broadcast %p : f64 to vector<3xf64>
    %q = arith.divf %g, %pb : vector<3xf64>
    %none = arith.cmpf oeq, %g, %zeros : vector<3xf64>
    %a = arith.select %none, %zeros, %q {tai.guard} : vector<3xi1>, vector<3xf64>
    %is = arith.cmpf oeq, %n, %zero : f64
    %o = arith.select %is, %one, %n : f64
    %ob = vector.broadcast %o : f64 to vector<3xf64>
    %u = arith.divf %d, %ob : vector<3xf64>
    %e = arith.mulf %u, %a : vector<3xf64>
    %drops = arith.cmpf oeq, %u, %zeros : vector<3xf64>
    %f = arith.select %drops, %zeros, %e {tai.guard_infinite} : vector<3xi1>, vector<3xf64>
    tai.atomic add %f, @gd[%j] : vector<3xf64>
  }
  tai.return
}
