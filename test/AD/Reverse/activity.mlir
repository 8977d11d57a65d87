// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, plain: f32, n: i32, v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @plain = @t["plain"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1

// Values that do not reach a field with an adjoint, or do not come from one,
// have no adjoint code; neither have comparisons, conversions and index
// arithmetic. Output and checks are not repeated.
// CHECK-LABEL: tai.kernel @mixed_grad(
//   CHECK-NOT:   tai.print
//   CHECK-NOT:   tai.assert
//   CHECK-NOT:   math.exp
//   CHECK-NOT:   math.log
//   CHECK-NOT:   tai.store
//       CHECK:   %[[P:.+]] = tai.load @plain
//       CHECK:   %[[G:.+]] = tai.load @y_grad
//       CHECK:   %[[GX:.+]] = arith.mulf %[[G]], %[[P]]
//       CHECK:   tai.atomic add %[[GX]], @x_grad
//   CHECK-NOT:   tai.atomic
//       CHECK:   tai.return
tai.kernel @mixed() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %p = tai.load @plain[%i] : f32
    %e = math.exp %x : f32
    tai.store %e, @plain[%i] : f32
    %l = math.log %p : f32
    tai.atomic add %l, @y[%i] : f32
    %c = arith.cmpf ogt, %x, %zero : f32
    tai.assert %c, "negative {}"(%x) : f32
    tai.print "{}"(%x) : f32
    %k = arith.fptosi %x : f32 to i32
    tai.store %k, @n[%i] : i32
    %q = tai.load @plain[%i] : f32
    %r = arith.mulf %x, %q : f32
    tai.atomic add %r, @y[%i] : f32
  }
  tai.return
}

// A kernel without derivatives has an empty adjoint.
// CHECK-LABEL: tai.kernel @nothing_grad() {
//  CHECK-NEXT:   tai.return
tai.kernel @nothing() {
  tai.parallel_for (%i) in @plain {
    %p = tai.load @plain[%i] : f32
    %l = math.exp %p : f32
    tai.store %l, @plain[%i] : f32
  }
  tai.return
}

// Subtraction, components, and a vector of which one component is used.
// CHECK-LABEL: tai.kernel @components_grad(
//       CHECK:   %[[G:.+]] = tai.load @y_grad
//       CHECK:   %[[NEG:.+]] = arith.negf %[[G]]
//       CHECK:   %[[V:.+]] = vector.from_elements %[[ZERO:.+]], %[[NEG]] : vector<2xf32>
//       CHECK:   tai.atomic add %[[V]], @v_grad[%[[I:.+]]] exclusive : vector<2xf32>
//       CHECK:   %[[H:.+]] = tai.load @v_grad[%[[I]]] component[%[[C0:.+]]] : f32
//       CHECK:   tai.atomic add %[[H]], @x_grad[%[[I]]] exclusive : f32
tai.kernel @components() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    tai.atomic add %x, @v[%i] component [%c0] : f32
    %v = tai.load @v[%i] : vector<2xf32>
    %e = vector.extract %v[1] : f32 from vector<2xf32>
    tai.atomic sub %e, @y[%i] : f32
  }
  tai.return
}

// A random number that the gradient needs is drawn again from its stream.
// CHECK-LABEL: tai.kernel @random_grad(
//       CHECK:   %[[U:.+]] = tai.random stream 3 : f32
//       CHECK:   arith.mulf %{{.+}}, %[[U]]
tai.kernel @random() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %u = tai.random stream 3 : f32
    %r = arith.mulf %x, %u : f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}
