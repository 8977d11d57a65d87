// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse --split-input-file --verify-diagnostics | FileCheck %s

// Choices of a kernel at kinks, by its attribute 'tai.conventions'.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, z: f32, z_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @z_grad = @t["z_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f32, rank 1, adjoint @z_grad

// A tie gives each operand half.
// CHECK-LABEL: tai.kernel @split_grad(
//   CHECK-DAG:   %[[HALF:.+]] = arith.constant 5.000000e-01 : f32
//       CHECK:   %[[G:.+]] = tai.load @z_grad
//       CHECK:   %[[TIE:.+]] = arith.cmpf oeq, %{{.+}}, %{{.+}}
//       CHECK:   %[[SHARE:.+]] = arith.mulf %[[G]], %[[HALF]]
//       CHECK:   arith.select %[[TIE]], %[[SHARE]], %{{.+}}
//       CHECK:   arith.select %[[TIE]], %[[SHARE]], %[[G]]
//       CHECK:   tai.return
tai.kernel @split() attributes {tai.conventions = {ties = "split"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = arith.maximumf %0, %1 : f32
    tai.store %2, @z[%i] : f32
  }
  tai.return
}

// Without it, the second operand gets all.
// CHECK-LABEL: tai.kernel @second_grad(
//   CHECK-NOT:   arith.constant 5.000000e-01
//   CHECK-NOT:   arith.cmpf oeq
//       CHECK:   tai.return
tai.kernel @second() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @y[%i] : f32
    %2 = arith.maximumf %0, %1 : f32
    tai.store %2, @z[%i] : f32
  }
  tai.return
}

// 1 - x² is at least 2⁻²³: its value at the next number below 1.
// CHECK-LABEL: tai.kernel @clamped_grad(
//   CHECK-DAG:   %[[LEAST:.+]] = arith.constant 1.1920929E-7 : f32
//       CHECK:   %[[OUTSIDE:.+]] = arith.cmpf olt, %[[SQUARE:.+]], %[[LEAST]]
//       CHECK:   %[[CLAMPED:.+]] = arith.select %[[OUTSIDE]], %[[LEAST]], %[[SQUARE]]
//       CHECK:   math.sqrt %[[CLAMPED]]
tai.kernel @clamped() attributes {tai.conventions = {arcs = "clamp"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.acos %0 : f32
    tai.store %1, @z[%i] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @unguarded_grad(
//   CHECK-NOT:   arith.select
//       CHECK:   tai.return
tai.kernel @unguarded() attributes {tai.conventions = {guards = false}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sqrt %0 : f32
    tai.store %1, @z[%i] : f32
  }
  tai.return
}

// -----

// expected-error @below {{'conventions' has no choice 'ties = "half"'; there are 'ties = "split"', 'arcs = "clamp"' and 'guards = false'}}
tai.kernel @unknown() attributes {tai.conventions = {ties = "half"}} {
  tai.return
}

// -----

// expected-error @below {{'conventions' has no choice 'tie = "split"'}}
tai.kernel @misspelt() attributes {tai.conventions = {tie = "split"}} {
  tai.return
}

// -----

// expected-error @below {{'tai.kernel' op attribute 'conventions' failed to satisfy constraint: dictionary of named attribute values}}
tai.kernel @no_dictionary() attributes {tai.conventions = "split"} {
  tai.return
}
