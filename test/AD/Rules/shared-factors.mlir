// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-forward-diff --canonicalize --cse | FileCheck %s --check-prefix=FORWARD

// A function of a quotient does not depend on a factor of both operands: it
// gets nothing, in the place of two numbers that cancel.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, z: f32, z_grad: f32, r: f32, r_grad: f32, x_dual: f32, r_dual: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @z_grad = @t["z_grad"] : f32, rank 1
tai.field @r_grad = @t["r_grad"] : f32, rank 1
tai.field @x_dual = @t["x_dual"] : f32, rank 1
tai.field @r_dual = @t["r_dual"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad, dual @x_dual
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f32, rank 1, adjoint @z_grad
tai.field @r = @t["r"] : f32, rank 1, adjoint @r_grad, dual @r_dual

// x / (x y) is 1 / y.
// CHECK-LABEL: tai.kernel @quotient_grad(
//       CHECK:   %[[G:.+]] = tai.load @r_grad
//       CHECK:   arith.divf %[[G]], %{{.+}}
//       CHECK:   tai.atomic add %{{.+}}, @y_grad
//   CHECK-NOT:   @x_grad
// FORWARD-LABEL: tai.kernel @quotient_fwd(
//       FORWARD:   tai.store %{{.+}}, @r[
//       FORWARD:   tai.store %[[ZERO:.+]], @r_dual
tai.kernel @quotient() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = arith.mulf %0, %1 : f32
    %3 = arith.divf %0, %2 : f32
    tai.store %3, @r[%i] : f32
  }
  tai.return
}

// m v / m is v: its adjoint is passed on as it is, with no guard.
// CHECK-LABEL: tai.kernel @velocity_grad(
//   CHECK-NOT:   arith.select
//       CHECK:   %[[G:.+]] = tai.load @r_grad
//       CHECK:   tai.atomic add %[[G]], @y_grad
//   CHECK-NOT:   @x_grad
//       CHECK:   tai.return
tai.kernel @velocity() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = arith.mulf %0, %1 : f32
    %3 = arith.divf %2, %0 : f32
    tai.store %3, @r[%i] : f32
  }
  tai.return
}

// In (x y) / (x z), y and z get the same as in y / z.
// CHECK-LABEL: tai.kernel @both_grad(
//       CHECK:   %[[Z:.+]] = tai.load @z[
//       CHECK:   %[[G:.+]] = tai.load @r_grad
//       CHECK:   %[[D:.+]] = arith.divf %[[G]], %[[Z]]
//       CHECK:   @y_grad
//   CHECK-NOT:   @x_grad
tai.kernel @both() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = tai.load @z[%i] : f32
    %3 = arith.mulf %0, %1 : f32
    %4 = arith.mulf %0, %2 : f32
    %5 = arith.divf %3, %4 : f32
    tai.store %5, @r[%i] : f32
  }
  tai.return
}

// An angle of x and x does not change.
// CHECK-LABEL: tai.kernel @angle_grad(
//   CHECK-NOT:   @x_grad
//       CHECK:   tai.return
tai.kernel @angle() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.atan2 %0, %0 : f32
    tai.store %1, @r[%i] : f32
  }
  tai.return
}

// Where nothing is shared, both operands have a derivative.
// CHECK-LABEL: tai.kernel @apart_grad(
//       CHECK:   arith.divf
//       CHECK:   @z_grad
//       CHECK:   @x_grad
tai.kernel @apart() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = tai.load @z[%i] : f32
    %3 = arith.mulf %1, %2 : f32
    %4 = arith.divf %0, %3 : f32
    tai.store %4, @r[%i] : f32
  }
  tai.return
}

// The tangent of a - a c, where that of a may be infinite, is the one of a
// times 1 - c, and zero where this is.
// FORWARD-LABEL: tai.kernel @remainder_fwd(
//       FORWARD:   %[[C:.+]] = math.floor
//       FORWARD:   %[[SLOPE:.+]] = arith.subf %{{.+}}, %[[C]]
//       FORWARD:   arith.mulf %{{.+}}, %[[SLOPE]]
//       FORWARD:   arith.cmpf oeq, %[[SLOPE]],
//       FORWARD:   tai.store %{{.+}}, @r_dual
tai.kernel @remainder() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @z[%i] : f32
    %2 = math.acos %0 : f32
    %3 = math.floor %1 : f32
    %4 = arith.mulf %2, %3 : f32
    %5 = arith.subf %2, %4 : f32
    tai.store %5, @r[%i] : f32
  }
  tai.return
}

// The same of one operation.
// FORWARD-LABEL: tai.kernel @rest_fwd(
//       FORWARD:   %[[C:.+]] = math.floor
//       FORWARD:   %[[SLOPE:.+]] = arith.addf %[[C]],
//       FORWARD:   arith.mulf %{{.+}}, %[[SLOPE]]
//       FORWARD:   arith.cmpf oeq, %[[SLOPE]],
//       FORWARD:   tai.store %{{.+}}, @r_dual
tai.kernel @rest() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @z[%i] : f32
    %2 = math.acos %0 : f32
    %3 = math.floor %1 : f32
    %4 = math.fma %3, %2, %2 : f32
    tai.store %4, @r[%i] : f32
  }
  tai.return
}
