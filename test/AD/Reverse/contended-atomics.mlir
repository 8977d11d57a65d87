// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

!t = !tai.root<dense<[i: 8], {x: f32, x_grad: f32}>, dense<[i: 3], {y: f32, y_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad

// The values are computed once and kept; who is equal to the greatest gets an
// equal share. The former value is read as it was, and keeps its adjoint if no
// value reaches it.
// CHECK-LABEL: tai.kernel @extreme_grad(
//  CHECK-SAME:   reads_before = [@y]
//   CHECK-DAG:   %[[BEST:.+]] = memref.alloc() : memref<3xf32>
//   CHECK-DAG:   %[[VALUES:.+]] = memref.alloc() : memref<8xf32>
//   CHECK-DAG:   %[[ELEMENTS:.+]] = memref.alloc() : memref<8xindex>
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x
//       CHECK:     %[[V:.+]] = math.sin
//       CHECK:     memref.store %[[V]], %[[VALUES]][%[[I]]]
//       CHECK:     memref.atomic_rmw maximumf %[[V]], %{{.+}}
//   CHECK-NOT:     tai.atomic
//       CHECK:   tai.parallel_for
//       CHECK:     memref.atomic_rmw addi
//       CHECK:   tai.parallel_for (%[[E:.+]]) =
//       CHECK:     %[[G:.+]] = tai.load @y_grad[%[[E]]] : f32
//       CHECK:     %[[BEFORE:.+]] = tai.load @y[%[[E]]] : f32
//       CHECK:     arith.cmpf oge, %{{.+}}, %[[BEFORE]] : f32
//       CHECK:     arith.divf %[[G]]
//       CHECK:     tai.store %{{.+}}, @y_grad[%[[E]]] : f32
//       CHECK:   tai.parallel_for
//       CHECK:   tai.parallel_for (%[[J:.+]]) in @x
//       CHECK:     %[[SHARE:.+]] = memref.load %[[VALUES]][%[[J]]]
//       CHECK:     %[[GX:.+]] = arith.mulf %[[SHARE]]
//       CHECK:     tai.atomic add %[[GX]], @x_grad[%[[J]]]
//       CHECK:   memref.dealloc %[[VALUES]]
tai.kernel @extreme() {
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    %k = arith.remsi %i, %c3 : index
    tai.atomic max %1, @y[%k] : f32
  }
  tai.return
}

// One element for all needs one number; what stood there is a factor, apart from
// the product of the others.
// CHECK-LABEL: tai.kernel @product_grad(
//  CHECK-SAME:   reads_before = [@y]
//       CHECK:   %[[PRODUCT:.+]] = memref.alloc() : memref<1xf32>
//       CHECK:   memref.atomic_rmw mulf
//       CHECK:   tai.load @y[%[[T:.+]]] : f32
//       CHECK:   tai.store %{{.+}}, @y_grad[%[[T]]] : f32
tai.kernel @product(%t: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.atomic mul %0, @y[%t] : f32
  }
  tai.return
}
