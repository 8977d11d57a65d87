// RUN: tai-opt %s --pass-pipeline='builtin.module(tai.kernel(tai-store-first{min-bytes=16}))' | FileCheck %s
// RUN: tai-opt %s --pass-pipeline='builtin.module(tai.kernel(tai-store-first))' | FileCheck %s --check-prefix=SMALL

// SMALL-NOT: starts_at_zero

tai.tree @t : !tai.root<dense<[i: 64, j: 8], {x: f32, x_grad: f32}>,
                        dense<[i: 64], {v: vector<2xf32>, v_grad: vector<2xf32>}>,
                        {l: f32, l_grad: f32}>
tai.field @x = @t["x"] : f32, rank 2, adjoint @x_grad
tai.field @x_grad = @t["x_grad"] : f32, rank 2
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @l = @t["l"] : f32, rank 0, adjoint @l_grad
tai.field @l_grad = @t["l_grad"] : f32, rank 0

// Each element gets one addition: it starts at zero if the launch says so. The
// second addition finds the sum of the first one.
// CHECK-LABEL: tai.kernel @whole
//  CHECK-SAME:     tai.stores_first = ["x_grad"]
//       CHECK:   %[[KNOWN:.+]] = tai_rt.starts_at_zero 0
//       CHECK:   %[[OLD:.+]] = tai.load @x_grad[%[[I:.+]], %[[J:.+]]] : f32
//       CHECK:   %[[START:.+]] = arith.select %[[KNOWN]], %{{.+}}, %[[OLD]] : f32
//       CHECK:   %[[SUM:.+]] = arith.addf %[[START]], %{{.+}} : f32
//       CHECK:   tai.store %[[SUM]], @x_grad[%[[I]], %[[J]]] : f32
//       CHECK:   tai.atomic add %{{.+}}, @x_grad[%[[I]], %[[J]]] exclusive
tai.kernel @whole() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%j, %i) = (%c0, %c0) to (%c8, %c64) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
    %1 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
  }
  tai.return
}

// All components count, in both arms of a branch.
// CHECK-LABEL: tai.kernel @components
//  CHECK-SAME:     tai.stores_first = ["v_grad"]
// CHECK-COUNT-4: tai_rt.starts_at_zero 0
//   CHECK-NOT:   starts_at_zero
tai.kernel @components(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %g = tai.load @l_grad[] : f32
    %inner = arith.cmpi slt, %i, %n : index
    scf.if %inner {
      %0 = tai.atomic add %g, @v_grad[%i] component[%c0] exclusive : f32
      %1 = tai.atomic add %g, @v_grad[%i] component[%c1] exclusive : f32
    } else {
      %0 = tai.atomic add %g, @v_grad[%i] component[%c1] exclusive : f32
      %1 = tai.atomic add %g, @v_grad[%i] component[%c0] exclusive : f32
    }
  }
  tai.return
}

// A part of the field, an element under a condition, one of two components, an
// element that is read before, and an addition whose result is used.
// CHECK-LABEL: tai.kernel @part
//   CHECK-NOT:   starts_at_zero
tai.kernel @part(%n: index) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c63, %c8) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
  }
  tai.return
}
// CHECK-LABEL: tai.kernel @condition
//   CHECK-NOT:   starts_at_zero
tai.kernel @condition(%n: index) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c8) {
    %g = tai.load @l_grad[] : f32
    %inner = arith.cmpi slt, %i, %n : index
    scf.if %inner {
      %0 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
    }
  }
  tai.return
}
// CHECK-LABEL: tai.kernel @one_component
//   CHECK-NOT:   starts_at_zero
tai.kernel @one_component() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @v_grad[%i] component[%c0] exclusive : f32
  }
  tai.return
}
// CHECK-LABEL: tai.kernel @read_before
//   CHECK-NOT:   starts_at_zero
tai.kernel @read_before() -> f32 {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  %first = tai.load @x_grad[%c0, %c0] : f32
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c8) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
  }
  tai.return %first : f32
}
// CHECK-LABEL: tai.kernel @uses_old
//   CHECK-NOT:   starts_at_zero
tai.kernel @uses_old() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c8) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
    %1 = tai.atomic add %0, @x_grad[%i, %j] exclusive : f32
  }
  tai.return
}

// The diagonal leaves elements out, and a shared addition is no store.
// CHECK-LABEL: tai.kernel @diagonal
//   CHECK-NOT:   starts_at_zero
tai.kernel @diagonal() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c8) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %i] exclusive : f32
  }
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c8) {
    %g = tai.load @l_grad[] : f32
    %w = vector.broadcast %g : f32 to vector<2xf32>
    %0 = tai.atomic add %w, @v_grad[%i] : vector<2xf32>
  }
  tai.return
}

// Later loops find what the first one has stored.
// CHECK-LABEL: tai.kernel @later
//       CHECK:   tai_rt.starts_at_zero 0
//       CHECK:   tai.atomic add %{{.+}}, @x_grad
tai.kernel @later() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c64, %c8) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %j] exclusive : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %g = tai.load @l_grad[] : f32
    %0 = tai.atomic add %g, @x_grad[%i, %c1] exclusive : f32
  }
  tai.return
}
