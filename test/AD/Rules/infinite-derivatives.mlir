// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-forward-diff --canonicalize --cse | FileCheck %s --check-prefix=FORWARD

// Adjoints and tangents that may be infinite, or no number, in loops and in ops
// with several results or components.

!m = vector<2x2xf64>
!w = vector<3xf64>
!t = !tai.root<dense<[i: 8], {x: f64, dx: f64, gx: f64, y: f64, dy: f64, gy: f64, z: f64}>, dense<[i: 8], {a: !m, da: !m, ga: !m, b: !m, c: !w, dc: !w, gc: !w, e: !w, g: vector<2xf64>, gg: vector<2xf64>, dg: vector<2xf64>}>>
tai.tree @t : !t
tai.field @dx = @t["dx"] : f64, rank 1
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @dy = @t["dy"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @da = @t["da"] : !m, rank 1
tai.field @ga = @t["ga"] : !m, rank 1
tai.field @dc = @t["dc"] : !w, rank 1
tai.field @gc = @t["gc"] : !w, rank 1
tai.field @dg = @t["dg"] : vector<2xf64>, rank 1
tai.field @gg = @t["gg"] : vector<2xf64>, rank 1
tai.field @x = @t["x"] : f64, rank 1, dual @dx, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, dual @dy, adjoint @gy
tai.field @z = @t["z"] : f64, rank 1
tai.field @a = @t["a"] : !m, rank 1, dual @da, adjoint @ga
tai.field @b = @t["b"] : !m, rank 1
tai.field @c = @t["c"] : !w, rank 1, dual @dc, adjoint @gc
tai.field @e = @t["e"] : !w, rank 1
tai.field @g = @t["g"] : vector<2xf64>, rank 1, dual @dg, adjoint @gg

// A number times a number does not lose an infinite adjoint where the factor is a
// constant other than zero; a vector with a zero, and a factor that is no number,
// are tested.
// CHECK-LABEL: tai.kernel @constants_grad(
//       CHECK:   scf.for {{.*}} iter_args(%[[A:.+]] = %{{.+}}, %[[B:.+]] = %{{.+}}, %[[D:.+]] = %{{.+}})
//       CHECK:     %[[DN:.+]] = arith.mulf %[[D]]
//       CHECK:     arith.select %{{.+}}, %{{.+}}, %[[DN]] {tai.guard}
//       CHECK:     %[[BZ:.+]] = arith.mulf %[[B]]
//       CHECK:     %[[BG:.+]] = arith.select %{{.+}}, %{{.+}}, %[[BZ]] {tai.guard_infinite}
//       CHECK:     %[[AV:.+]] = arith.mulf %[[A]]
//   CHECK-NOT:     %[[AV]] {tai.guard
//       CHECK:     scf.yield %{{.+}}, %[[BG]]
tai.kernel @constants(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %nan = arith.constant 0x7FF8000000000000 : f64
  %v = arith.constant dense<[2.0, 3.0]> : vector<2xf64>
  %z = arith.constant dense<[2.0, 0.0]> : vector<2xf64>
  tai.parallel_for (%i) in @g {
    %0 = tai.load @g[%i] : vector<2xf64>
    %r:3 = scf.for %k = %c0 to %n step %c1 iter_args(%a = %0, %b = %0, %d = %nan) -> (vector<2xf64>, vector<2xf64>, f64) {
      %s = arith.mulf %a, %v : vector<2xf64>
      %q = arith.mulf %b, %z : vector<2xf64>
      %e = vector.extract %a[0] : f64 from vector<2xf64>
      %f = arith.mulf %e, %nan : f64
      scf.yield %s, %q, %f : vector<2xf64>, vector<2xf64>, f64
    }
    %1 = math.sqrt %r#0 : vector<2xf64>
    %2 = math.sqrt %r#1 : vector<2xf64>
    %3 = arith.addf %1, %2 : vector<2xf64>
    %4 = math.sqrt %r#2 : f64
    %5 = vector.broadcast %4 : f64 to vector<2xf64>
    %6 = arith.addf %3, %5 : vector<2xf64>
    tai.store %6, @g[%i] : vector<2xf64>
  }
  tai.return
}

// Either of two results may have an infinite adjoint.
// CHECK-LABEL: tai.kernel @two_infinite_grad(
//       CHECK:     %[[S:.+]] = arith.mulf %{{.+}}, %[[COS:.+]] : f64
//       CHECK:     %[[NO_COS:.+]] = arith.cmpf oeq, %[[COS]],
//       CHECK:     arith.select %[[NO_COS]], %{{.+}}, %[[S]] {tai.guard_infinite}
//       CHECK:     arith.select %{{.+}}, %{{.+}}, %{{.+}} {tai.guard_infinite}
tai.kernel @two_infinite(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %r:2 = scf.for %k = %c0 to %n step %c1 iter_args(%a = %0, %b = %0) -> (f64, f64) {
      %s, %c = math.sincos %a : f64
      scf.yield %s, %c : f64, f64
    }
    %1 = math.sqrt %r#0 : f64
    %2 = math.sqrt %r#1 : f64
    %3 = arith.addf %1, %2 : f64
    tai.store %3, @y[%i] : f64
  }
  tai.return
}

// The exponent of a number that may be negative has no derivative, and passes
// that on. Where it is zero, it takes nothing of it; where the base is positive,
// nothing is missing, and nobody asks.
// CHECK-LABEL: tai.kernel @undefined_grad(
//       CHECK:     %{{.+}} = arith.select %[[NONE:[a-z0-9_]+]], %{{.+}}, %{{.+}} : f64
//       CHECK:     %[[SLOPE:.+]] = arith.select %[[NONE]], %{{.+}}, %{{.+}} : f64
//       CHECK:     %[[NO_SLOPE:.+]] = arith.cmpf oeq, %[[SLOPE]],
//       CHECK:     arith.select %[[NO_SLOPE]], %{{.+}}, %{{.+}} {tai.guard}
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @positive_power_grad(
//   CHECK-NOT:   arith.cmpf ord
//       CHECK:   tai.return
tai.kernel @undefined(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %two = arith.constant 2.0 : f64
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %r = scf.for %k = %c0 to %n step %c1 iter_args(%a = %0) -> f64 {
      %s = arith.mulf %a, %two : f64
      %q = arith.addf %s, %0 : f64
      %p = math.powf %0, %q : f64
      scf.yield %p : f64
    }
    tai.store %r, @y[%i] : f64
  }
  tai.return
}
tai.kernel @positive_power(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %b = math.exp %0 : f64
    %r = scf.for %k = %c0 to %n step %c1 iter_args(%a = %0) -> f64 {
      %p = math.powf %b, %a : f64
      scf.yield %p : f64
    }
    tai.store %r, @y[%i] : f64
  }
  tai.return
}

// Without guards there are no tests, of powers and in branches either.
// CHECK-LABEL: tai.kernel @pow_without_guards_grad(
//   CHECK-NOT:   tai.guard
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @branch_without_guards_grad(
//   CHECK-NOT:   tai.
//       CHECK:   tai.parallel_for
//   CHECK-NOT:   {tai.
//       CHECK:   tai.return
tai.kernel @pow_without_guards() attributes {conventions = {guards = false}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.powf %0, %0 : f64
    tai.store %1, @y[%i] : f64
  }
  tai.return
}
tai.kernel @branch_without_guards(%k: i1) attributes {conventions = {guards = false}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %r = scf.if %k -> f64 {
      %1 = math.sqrt %0 : f64
      scf.yield %1 : f64
    } else {
      scf.yield %0 : f64
    }
    tai.store %r, @y[%i] : f64
  }
  tai.return
}

// The tangent of a sum with a shared factor is the usual one where the rest has a
// tangent, and none where nothing is left.
// FORWARD-LABEL: tai.kernel @shared_with_tangents_fwd(
//       FORWARD:   %[[DY:.+]] = tai.load @dy
//       FORWARD:   %[[A:.+]] = math.acos
//       FORWARD:   arith.mulf %[[DY]], %[[A]]
//       FORWARD:   tai.store %{{.+}}, @dy
// FORWARD-LABEL: tai.kernel @nothing_left_fwd(
//       FORWARD:   %[[ZERO:.+]] = arith.constant 0.0
//       FORWARD:   tai.store %[[ZERO]], @dy
tai.kernel @shared_with_tangents() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = tai.load @y[%i] : f64
    %2 = math.acos %0 : f64
    %4 = arith.mulf %2, %1 : f64
    %5 = arith.subf %2, %4 : f64
    %6 = arith.subf %4, %2 : f64
    %7 = arith.subf %2, %2 : f64
    %8 = arith.addf %2, %2 : f64
    %9 = arith.addf %5, %6 : f64
    %10 = arith.addf %7, %8 : f64
    %11 = arith.addf %9, %10 : f64
    tai.store %11, @y[%i] : f64
  }
  tai.return
}
tai.kernel @nothing_left() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = math.acos %0 : f64
    %2 = arith.subf %1, %1 : f64
    tai.store %2, @y[%i] : f64
  }
  tai.return
}

// The terms of a cross product are guarded one by one.
// FORWARD-LABEL: tai.kernel @cross_infinite_fwd(
// FORWARD-COUNT-12: {tai.guard} : f64
//       FORWARD:   tai.store %{{.+}}, @dc
tai.kernel @cross_infinite() {
  tai.parallel_for (%i) in @c {
    %0 = tai.load @c[%i] : !w
    %1 = math.log %0 : !w
    %2 = tai.cross %0, %1 : !w
    tai.store %2, @c[%i] : !w
  }
  tai.return
}

// Factors of a constant matrix are constants in a product.
// FORWARD-LABEL: tai.kernel @frame_of_constant_fwd(
//       FORWARD:   %[[DA:.+]] = tai.load @da
//       FORWARD:   %[[U:.+]], %{{.+}}, %[[V:.+]] = tai.svd
//       FORWARD:   tai.matmul %[[U]], %[[DA]]
//   FORWARD-NOT:   arith.divf
//       FORWARD:   tai.store %{{.+}}, @da
tai.kernel @frame_of_constant() {
  tai.parallel_for (%i) in @a {
    %0 = tai.load @b[%i] : !m
    %1 = tai.load @a[%i] : !m
    %u, %s, %v = tai.svd %0 : !m
    %p = tai.matmul %u, %1 : (!m, !m) -> !m
    %q = tai.transpose %v : !m -> !m
    %r = tai.matmul %p, %q : (!m, !m) -> !m
    tai.store %r, @a[%i] : !m
  }
  tai.return
}
