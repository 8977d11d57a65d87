// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

// Appendix B, "The make_adjoint pass": y_i = sin(x_i^2) and its adjoint kernel.

tai.tree @arrays : !tai.root<dense<[i: 16], {x: f32, y: f32, x_adj: f32, y_adj: f32}>>
tai.field @x_adj = @arrays["x_adj"] : f32, rank 1
tai.field @y_adj = @arrays["y_adj"] : f32, rank 1
tai.field @x = @arrays["x"] : f32, rank 1, adjoint @x_adj
tai.field @y = @arrays["y"] : f32, rank 1, adjoint @y_adj

// The primal names its adjoint and is otherwise as it was.
// CHECK-LABEL: tai.kernel @sines() attributes {adjoint = @sines_grad}
//       CHECK:   tai.parallel_for
//       CHECK:     tai.store %{{.+}}, @y[%{{.+}}] : f32

// The loop stays parallel. The adjoint variables of the listing are values; the
// forward computation is repeated as far as it is needed: sin is not.
// CHECK-LABEL: tai.kernel @sines_grad()
//       CHECK:   tai.parallel_for (%[[I:.+]]) = (%{{.+}}) to (%{{.+}}) {
//       CHECK:     %[[V1:.+]] = tai.load @x[%[[I]]] : f32
//       CHECK:     %[[V2:.+]] = arith.mulf %[[V1]], %[[V1]]
//   CHECK-NOT:     math.sin
//       CHECK:     %[[V3ADJ:.+]] = tai.load @y_adj[%[[I]]] : f32
//       CHECK:     %[[V5:.+]] = math.cos %[[V2]]
//       CHECK:     %[[V2ADJ:.+]] = arith.mulf %[[V3ADJ]], %[[V5]]
//       CHECK:     %[[HALF:.+]] = arith.mulf %[[V2ADJ]], %[[V1]]
//       CHECK:     %[[V1ADJ:.+]] = arith.addf %[[HALF]], %[[HALF]]
//       CHECK:     tai.atomic add %[[V1ADJ]], @x_adj[%[[I]]] exclusive : f32
//   CHECK-NOT:     tai.store
tai.kernel @sines() {
  %c0 = arith.constant 0 : index
  %c16 = arith.constant 16 : index
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %1 = tai.load @x[%i] : f32
    %2 = arith.mulf %1, %1 : f32
    %3 = math.sin %2 : f32
    tai.store %3, @y[%i] : f32
  }
  tai.return
}
