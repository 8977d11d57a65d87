// RUN: tai-opt %s --tai-scatter-to-gather --canonicalize | FileCheck %s

// The reverse of a stencil over active cells: each element adds up the terms of
// the iterations around it, as far as there are such iterations.
tai.tree @t : !tai.root<pointer<[i: 8], dense<[i: 8], {x: f32, x_grad: f32, y_grad: f32}>>, pointer<[i: 8], dense<[i: 8], {z_grad: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @z_grad = @t["z_grad"] : f32, rank 1

// CHECK-LABEL: tai.kernel @reverse
//       CHECK:   %[[ALL:.+]] = tai.visits_all @x
//       CHECK:   scf.if %[[ALL]] {
//       CHECK:     tai.parallel_for (%[[I:.+]]) in @x {
//       CHECK:       %[[LEFT:.+]] = arith.addi %[[I]], %{{.+}} : index
//       CHECK:       %[[INSIDE:.+]] = arith.cmpi
//       CHECK:       scf.if %[[INSIDE]] -> (f32) {
//       CHECK:         %[[ACTIVE:.+]] = tai.is_active @x[%[[LEFT]]] level 2
//       CHECK:         scf.if %[[ACTIVE]] -> (f32) {
//       CHECK:           tai.load @y_grad[%[[LEFT]]]
//       CHECK:       tai.atomic add %{{.+}}, @x_grad[%[[I]]] exclusive
//   CHECK-NOT:       tai.atomic
//       CHECK:   } else {
//       CHECK:     tai.parallel_for
//       CHECK:       tai.atomic add
//       CHECK:       tai.atomic add
tai.kernel @reverse() attributes {keeps_activity} {
  %one = arith.constant 1 : index
  %two = arith.constant 2.0 : f32
  tai.parallel_for (%i) in @x {
    %g = tai.load @y_grad[%i] : f32
    %h = arith.mulf %g, %two : f32
    %right = arith.addi %i, %one : index
    %0 = tai.atomic add %h, @x_grad[%right] : f32
    %1 = tai.atomic add %g, @x_grad[%i] : f32
  }
  tai.return
}

// A kernel that makes cells active adds to more cells than it visits.
// CHECK-LABEL: tai.kernel @forward
//   CHECK-NOT:   tai.visits_all
//       CHECK:   tai.atomic add %{{.+}}, @x_grad[%{{.+}}] : f32
tai.kernel @forward() {
  %one = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %g = tai.load @y_grad[%i] : f32
    %right = arith.addi %i, %one : index
    %0 = tai.atomic add %g, @x_grad[%right] : f32
  }
  tai.return
}

// The elements added to may be active elsewhere.
// CHECK-LABEL: tai.kernel @apart
//   CHECK-NOT:   tai.visits_all
//       CHECK:   tai.atomic add %{{.+}}, @z_grad[%{{.+}}] : f32
tai.kernel @apart() attributes {keeps_activity} {
  %one = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %g = tai.load @y_grad[%i] : f32
    %right = arith.addi %i, %one : index
    %0 = tai.atomic add %g, @z_grad[%right] : f32
  }
  tai.return
}
