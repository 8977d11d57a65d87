// RUN: tai-opt %s --tai-autodiff | FileCheck %s

// Sections 2 and 3, the mass-spring simulator: forces of springs between
// particles, time integration, and the area of a triangle as the loss.

!particles = !tai.root<dense<[i: 1024, j: 3], {x: vector<2xf32>, x_grad: vector<2xf32>, v: vector<2xf32>, v_grad: vector<2xf32>, force: vector<2xf32>, force_grad: vector<2xf32>}>>
!springs = !tai.root<dense<[i: 3], {a: i32, b: i32, length: f32, length_grad: f32}>, {loss: f32, loss_grad: f32}>
tai.tree @particles : !particles
tai.tree @springs : !springs
tai.field @x_grad = @particles["x_grad"] : vector<2xf32>, rank 2
tai.field @v_grad = @particles["v_grad"] : vector<2xf32>, rank 2
tai.field @force_grad = @particles["force_grad"] : vector<2xf32>, rank 2
tai.field @x = @particles["x"] : vector<2xf32>, rank 2, adjoint @x_grad
tai.field @v = @particles["v"] : vector<2xf32>, rank 2, adjoint @v_grad
tai.field @force = @particles["force"] : vector<2xf32>, rank 2, adjoint @force_grad
tai.field @anchor_a = @springs["a"] : i32, rank 1
tai.field @anchor_b = @springs["b"] : i32, rank 1
tai.field @length_grad = @springs["length_grad"] : f32, rank 1
tai.field @length = @springs["length"] : f32, rank 1, adjoint @length_grad
tai.field @loss_grad = @springs["loss_grad"] : f32, rank 0
tai.field @loss = @springs["loss"] : f32, rank 0, adjoint @loss_grad

// Forces are scattered to the two ends of each spring, so the adjoint gathers
// the adjoints of both ends. A spring owns its rest length: that is a plain
// add. Particles are shared: those adds stay atomic. Both ends are indices, and
// carry no derivative.
// CHECK-LABEL: tai.kernel @apply_spring_force_grad(
//  CHECK-SAME:     %[[T:.+]]: i32)
//       CHECK:   tai.parallel_for (%[[S:.+]]) in @length {
//       CHECK:     %[[A32:.+]] = tai.load @anchor_a[%[[S]]]
//       CHECK:     %[[B32:.+]] = tai.load @anchor_b[%[[S]]]
//       CHECK:     %[[A:.+]] = arith.index_cast %[[A32]]
//       CHECK:     %[[B:.+]] = arith.index_cast %[[B32]]
//       CHECK:     %[[GB:.+]] = tai.load @force_grad[%[[TI:.+]], %[[B]]]
//       CHECK:     %[[GA:.+]] = tai.load @force_grad[%[[TI]], %[[A]]]
//       CHECK:     arith.negf %[[GA]]
//       CHECK:     tai.atomic add %{{.+}}, @length_grad[%[[S]]] exclusive
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%{{.+}}, %[[B]]] :
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%{{.+}}, %[[A]]] :
tai.kernel @apply_spring_force(%t: i32) {
  %stiffness = arith.constant 10.0 : f32
  %eps = arith.constant 1.0e-4 : f32
  %c1 = arith.constant 1 : i32
  %before = arith.subi %t, %c1 : i32
  %t0 = arith.index_cast %before : i32 to index
  %t1 = arith.index_cast %t : i32 to index
  tai.parallel_for (%s) in @length {
    %a32 = tai.load @anchor_a[%s] : i32
    %b32 = tai.load @anchor_b[%s] : i32
    %a = arith.index_cast %a32 : i32 to index
    %b = arith.index_cast %b32 : i32 to index
    %xa = tai.load @x[%t0, %a] : vector<2xf32>
    %xb = tai.load @x[%t0, %b] : vector<2xf32>
    %dist = arith.subf %xa, %xb : vector<2xf32>
    %norm = tai.norm %dist : vector<2xf32>
    %length = arith.addf %norm, %eps : f32
    %rest = tai.load @length[%s] : f32
    %stretch = arith.subf %length, %rest : f32
    %scaled = arith.mulf %stiffness, %stretch : f32
    %scale = arith.divf %scaled, %length : f32
    %scales = vector.broadcast %scale : f32 to vector<2xf32>
    %f = arith.mulf %scales, %dist : vector<2xf32>
    %minus = arith.negf %f : vector<2xf32>
    tai.atomic add %minus, @force[%t1, %a] : vector<2xf32>
    tai.atomic add %f, @force[%t1, %b] : vector<2xf32>
  }
  tai.return
}

// Everything is linear here, so the adjoint reads no primal field at all, and
// each particle is its own: no atomic is left.
// CHECK-LABEL: tai.kernel @time_integrate_grad(
//   CHECK-NOT:   tai.load @x[
//   CHECK-NOT:   tai.load @v[
//   CHECK-NOT:   tai.load @force[
//       CHECK:   tai.atomic add %{{.+}}, @x_grad[%{{.+}}] exclusive
tai.kernel @time_integrate(%t: i32) {
  %dt = arith.constant dense<1.0e-3> : vector<2xf32>
  %damping = arith.constant dense<0.98> : vector<2xf32>
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  %c1 = arith.constant 1 : i32
  %before = arith.subi %t, %c1 : i32
  %t0 = arith.index_cast %before : i32 to index
  %t1 = arith.index_cast %t : i32 to index
  tai.parallel_for (%i) = (%c0) to (%c3) {
    %v0 = tai.load @v[%t0, %i] : vector<2xf32>
    %damped = arith.mulf %v0, %damping : vector<2xf32>
    %f = tai.load @force[%t1, %i] : vector<2xf32>
    %dv = arith.mulf %f, %dt : vector<2xf32>
    %v1 = arith.addf %damped, %dv : vector<2xf32>
    tai.store %v1, @v[%t1, %i] : vector<2xf32>
    %x0 = tai.load @x[%t0, %i] : vector<2xf32>
    %vt = tai.load @v[%t1, %i] : vector<2xf32>
    %dx = arith.mulf %vt, %dt : vector<2xf32>
    %x1 = arith.addf %x0, %dx : vector<2xf32>
    tai.store %x1, @x[%t1, %i] : vector<2xf32>
  }
  tai.return
}

// loss = (|0.5 (x01 × x02)| - target)^2, at the top level of the kernel. At a
// triangle of no area the sign of abs is 0.
// CHECK-LABEL: tai.kernel @compute_loss_grad(
//   CHECK-DAG:   %[[G:.+]] = tai.load @loss_grad[] : f32
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   %[[LESS:.+]] = arith.cmpf olt, %[[AREA:.+]], %[[ZERO]]
//       CHECK:   arith.select %[[LESS]], %{{.+}}, %[[ZERO]]
//       CHECK:   tai.atomic add %{{.+}}, @x_grad[%[[T:.+]], %[[C2:.+]]] exclusive : vector<2xf32>
//       CHECK:   tai.atomic add %{{.+}}, @x_grad[%[[T]], %{{.+}}] exclusive : vector<2xf32>
tai.kernel @compute_loss(%t: i32) {
  %half = arith.constant 0.5 : f32
  %target = arith.constant 0.2 : f32
  %p0 = arith.constant 0 : index
  %p1 = arith.constant 1 : index
  %p2 = arith.constant 2 : index
  %ti = arith.index_cast %t : i32 to index
  %x0 = tai.load @x[%ti, %p0] : vector<2xf32>
  %x1 = tai.load @x[%ti, %p1] : vector<2xf32>
  %x2 = tai.load @x[%ti, %p2] : vector<2xf32>
  %x01 = arith.subf %x0, %x1 : vector<2xf32>
  %x02 = arith.subf %x0, %x2 : vector<2xf32>
  %a0 = vector.extract %x01[0] : f32 from vector<2xf32>
  %a1 = vector.extract %x01[1] : f32 from vector<2xf32>
  %b0 = vector.extract %x02[0] : f32 from vector<2xf32>
  %b1 = vector.extract %x02[1] : f32 from vector<2xf32>
  %m0 = arith.mulf %a0, %b1 : f32
  %m1 = arith.mulf %a1, %b0 : f32
  %cross = arith.subf %m0, %m1 : f32
  %signed = arith.mulf %half, %cross : f32
  %area = math.absf %signed : f32
  %miss = arith.subf %area, %target : f32
  %square = arith.mulf %miss, %miss : f32
  tai.store %square, @loss[] : f32
  tai.return
}
