// RUN: tai-opt %s --tai-make-adjoint --tai-forward-diff --canonicalize --cse | FileCheck %s

// An adjoint is a kernel like any other: with duals of adjoint fields, forward
// mode accumulates products of the Hessian and a vector in them.

!t = !tai.root<dense<[i: 16], {x: f32, xg: f32, xd: f32, xgd: f32, y: f32, yg: f32, yd: f32, ygd: f32}>>
tai.tree @t : !t
tai.field @xgd = @t["xgd"] : f32, rank 1
tai.field @ygd = @t["ygd"] : f32, rank 1
tai.field @xd = @t["xd"] : f32, rank 1
tai.field @yd = @t["yd"] : f32, rank 1
tai.field @xg = @t["xg"] : f32, rank 1, dual @xgd
tai.field @yg = @t["yg"] : f32, rank 1, dual @ygd
tai.field @x = @t["x"] : f32, rank 1, adjoint @xg, dual @xd
tai.field @y = @t["y"] : f32, rank 1, adjoint @yg, dual @yd

// CHECK-LABEL: tai.kernel @square_grad_fwd()
//       CHECK:   %[[X:.+]] = tai.load @x[
//       CHECK:   %[[DX:.+]] = tai.load @xd[
//       CHECK:   %[[G:.+]] = tai.load @yg[
//       CHECK:   %[[DG:.+]] = tai.load @ygd[
//       CHECK:   tai.atomic add %{{.+}}, @xg[
//       CHECK:   tai.atomic add %{{.+}}, @xgd[
tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// A guard is no branch. Where the adjoint is zero and its tangent is not, the
// tangent still counts: (sqrt(x) - 1)^2 has a curvature at x = 1.
// CHECK-LABEL: tai.kernel @root_grad_fwd()
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   %[[G:.+]] = tai.load @yg[
//       CHECK:   %[[DG:.+]] = tai.load @ygd[
//   CHECK-DAG:   %[[NO_G:.+]] = arith.cmpf oeq, %[[G]], %[[ZERO]]
//   CHECK-DAG:   %[[NO_DG:.+]] = arith.cmpf oeq, %[[DG]], %[[ZERO]]
//       CHECK:   %[[NEITHER:.+]] = arith.andi %[[NO_G]], %[[NO_DG]]
//       CHECK:   arith.select %[[NEITHER]], %[[ZERO]], %{{.+}} {tai.guard}
//       CHECK:   tai.atomic add %{{.+}}, @xgd[
tai.kernel @root() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sqrt %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}
