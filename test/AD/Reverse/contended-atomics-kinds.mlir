// RUN: tai-opt %s --tai-expand-atomics --tai-make-adjoint | FileCheck %s

// Values that iterations combine: of serial loops, of draws, in narrow floats, and
// beside other accesses.

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, n: i32}>, dense<[i: 4, j: 4], {z: f64, z_grad: f64}>, dense<[i: 65536, j: 16384], {h: f64, h_grad: f64}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 2
tai.field @h_grad = @t["h_grad"] : f64, rank 2
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 2, adjoint @z_grad
tai.field @h = @t["h"] : f64, rank 2, adjoint @h_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @n = @t["n"] : i32, rank 1

// The runs of a serial loop are numbered by its steps, in indices.
// CHECK-LABEL: tai.kernel @serial_steps_grad(
//       CHECK:   %[[FROM:.+]] = arith.index_cast %arg0 : i32 to index
//       CHECK:   %[[COUNT:.+]] = arith.ceildivui
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x
//       CHECK:     scf.for %[[K:.+]] = %arg0 to %arg1 step
//       CHECK:       %[[AT:.+]] = arith.index_cast %[[K]] : i32 to index
//       CHECK:       %[[D:.+]] = arith.subi %[[AT]], %[[FROM]]
//       CHECK:       %[[R:.+]] = arith.divui %[[D]]
//       CHECK:       %[[ROW:.+]] = arith.muli %[[I]], %[[COUNT]]
//       CHECK:       %[[NUMBER:.+]] = arith.addi %[[ROW]], %[[R]]
//       CHECK:       memref.store %{{.+}}, %{{.+}}[%[[NUMBER]]]
tai.kernel @serial_steps(%from: i32, %to: i32) {
  %c0 = arith.constant 0 : index
  %two = arith.constant 2 : i32
  tai.parallel_for (%i) in @x {
    scf.for %k = %from to %to step %two : i32 {
      %0 = tai.load @x[%i] : f64
      %f = arith.sitofp %k : i32 to f64
      %1 = arith.mulf %0, %f : f64
      tai.atomic max %1, @y[%c0] : f64
    }
  }
  tai.return
}

// Draws are drawn again.
// CHECK-LABEL: tai.kernel @random_grad(
//       CHECK:   tai.parallel_for
//       CHECK:     tai.random
//       CHECK:     memref.atomic_rmw maximumf
tai.kernel @random() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %u = tai.random stream 0 : f64
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %u : f64
    tai.atomic max %1, @y[%c0] : f64
  }
  tai.return
}

// Narrow floats are combined in wider ones, and so is the adjoint of what stood
// there.
// CHECK-LABEL: tai.kernel @half_grad(
//       CHECK:   tai.load @q
//       CHECK:   arith.extf %{{.+}} : f16 to f32
//       CHECK:   memref.atomic_rmw mulf %{{.+}}, %{{.+}} : (f32, memref<?xf32>) -> f32
//       CHECK:   tai.store %{{.+}}, @p_grad[%{{.+}}] : f32
//       CHECK:   tai.atomic add %{{.+}}, @q_grad[%{{.+}}] exclusive : f32
tai.kernel @half() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @q {
    %0 = tai.load @q[%i] : f16
    tai.atomic mul %0, @p[%c0] : f16
  }
  tai.return
}

// The element may be read before the loop. Integers that are combined are no
// matter.
// CHECK-LABEL: tai.kernel @read_before_grad(
//  CHECK-SAME:   reads_before = [@y]
// CHECK-LABEL: tai.kernel @inactive_grad(
//   CHECK-NOT:   memref
//       CHECK:   tai.return
tai.kernel @read_before() {
  %c0 = arith.constant 0 : index
  %b = tai.load @y[%c0] : f64
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.mulf %0, %b : f64
    tai.atomic max %1, @y[%c0] : f64
  }
  tai.return
}
tai.kernel @inactive() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %k = tai.load @n[%i] : i32
    tai.atomic max %k, @n[%c0] : i32
    %0 = tai.load @x[%i] : f64
    tai.store %0, @y[%i] : f64
  }
  tai.return
}
