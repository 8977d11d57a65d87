// RUN: tai-opt %s --tai-choose-writers | FileCheck %s
// RUN: tai-opt %s --tai-choose-writers --tai-make-adjoint=kernel=scatter | \
// RUN:   FileCheck %s --check-prefix=ADJOINT
// RUN: tai-opt %s --tai-choose-writers --tai-choose-writers | FileCheck %s

!t = !tai.root<dense<[i: 64], {x: f32, x_grad: f32, x_dual: f32, z: f32}>,
               dense<[i: 16], {y: f32, y_grad: f32}>,
               dense<[i: 64], {p: i32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f32, rank 1
tai.field @p = @t["p"] : i32, rank 1

// The kernel stays, and its form for tapes has owners.
// CHECK-LABEL: tai.kernel @scatter() {
//   CHECK-NOT:   memref.alloc
// CHECK-LABEL: tai.kernel @scatter.0()
//  CHECK-SAME:   part_of = @scatter
//       CHECK:   %[[OWNERS:.+]] = memref.alloc() {tai.owners} : memref<16xi32>
//       CHECK:   memref.store %c-1_i32, %[[OWNERS]]
//       CHECK:   tai.parallel_for (%{{.+}}) in @x
//   CHECK-NOT:     tai.load @x
//       CHECK:     tai.load @p
//       CHECK:     memref.atomic_rmw maxs %{{.+}}, %[[OWNERS]]
//   CHECK-NOT:     tai.store
//       CHECK:   tai.parallel_for (%{{.+}}) in @x
//       CHECK:     %[[OWNER:.+]] = memref.load %[[OWNERS]]
//       CHECK:     %[[MINE:.+]] = arith.cmpi eq, %[[OWNER]]
//       CHECK:     scf.if
//  CHECK-NEXT:       tai.store
//       CHECK:   memref.dealloc %[[OWNERS]]
//
// ADJOINT-LABEL: tai.kernel @scatter.0_grad(
//       ADJOINT:   %[[OWNERS:.+]] = memref.alloc
//       ADJOINT:   memref.atomic_rmw maxs %{{.+}}, %[[OWNERS]]
//       ADJOINT:   tai.parallel_for
//       ADJOINT:     memref.load %[[OWNERS]]
//       ADJOINT:     scf.if
//       ADJOINT:       tai.load @y_grad
//       ADJOINT:   memref.dealloc %[[OWNERS]]
tai.kernel @scatter() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// Each iteration has its own element; nobody asks for the derivative.
// CHECK-NOT: tai.kernel @own.0
// CHECK-NOT: tai.kernel @constant.0
tai.kernel @own() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
tai.kernel @constant() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @z[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// A read must not find what another iteration writes.
// CHECK-LABEL: tai.kernel @recurrence.0(
//       CHECK:   memref.atomic_rmw maxs
//       CHECK:   tai.parallel_for
//       CHECK:     tai.assert %{{.+}}, "an iteration of a parallel loop uses an element of field 'x' here that another iteration writes
//       CHECK:     tai.load @x
//   CHECK-NOT:     scf.if
//       CHECK:     tai.store %{{.+}}, @x
tai.kernel @recurrence(%n: index) {
  %c1 = arith.constant 1 : index
  %half = arith.constant 0.5 : f32
  tai.parallel_for (%i) = (%c1) to (%n) {
    %j = arith.subi %i, %c1 : index
    %0 = tai.load @x[%j] : f32
    %1 = arith.mulf %0, %half : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// What decides is changed by the loop: in order on one thread.
// CHECK-LABEL: tai.kernel @changes.0(
//       CHECK:   tai.parallel_for {{.*}} serialize
tai.kernel @changes() {
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @x {
    %half = arith.divsi %i, %c2 : index
    %n = arith.index_cast %i : index to i32
    tai.store %n, @p[%half] : i32
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}
