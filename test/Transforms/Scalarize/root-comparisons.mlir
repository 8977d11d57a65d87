// RUN: tai-opt %s --tai-scalarize | FileCheck %s

// sqrt(s) < 0.4 exactly if s < 0.160000011 in f32, which is not 0.4 * 0.4.
// CHECK-LABEL: tai.kernel @below(
//   CHECK-NOT:   math.sqrt
//       CHECK:   arith.cmpf olt, %{{.+}}, %{{.+}} : f32
//   CHECK-NOT:   math.sqrt
//       CHECK:   tai.return
tai.kernel @below(%a: vector<2xf32>) -> i1 {
  %h = arith.constant 4.0e-1 : f32
  %0 = tai.norm %a : vector<2xf32>
  %1 = arith.cmpf olt, %0, %h : f32
  tai.return %1 : i1
}

// CHECK-LABEL: tai.kernel @above(
//   CHECK-NOT:   math.sqrt
//       CHECK:   arith.cmpf uge, %{{.+}}, %{{.+}} : f64
tai.kernel @above(%a: vector<3xf64>) -> i1 {
  %h = arith.constant 2.0 : f64
  %0 = tai.norm %a : vector<3xf64>
  %1 = arith.cmpf ult, %h, %0 : f64
  tai.return %1 : i1
}

// The norm of one component is exact, and its square is not.
// CHECK-LABEL: tai.kernel @one(
//       CHECK:   math.absf
tai.kernel @one(%a: vector<1xf32>) -> i1 {
  %h = arith.constant 4.0e-1 : f32
  %0 = tai.norm %a : vector<1xf32>
  %1 = arith.cmpf olt, %0, %h : f32
  tai.return %1 : i1
}

// Near this limit, squares leave the range in which a norm has no scale.
// CHECK-LABEL: tai.kernel @tiny(
//       CHECK:   math.sqrt
tai.kernel @tiny(%a: vector<2xf32>) -> i1 {
  %h = arith.constant 1.0e-30 : f32
  %0 = tai.norm %a : vector<2xf32>
  %1 = arith.cmpf olt, %0, %h : f32
  tai.return %1 : i1
}

// The root of a number that may be negative is NaN.
// CHECK-LABEL: tai.kernel @any(
//       CHECK:   math.sqrt
tai.kernel @any(%s: f32) -> i1 {
  %h = arith.constant 4.0e-1 : f32
  %0 = math.sqrt %s : f32
  %1 = arith.cmpf olt, %0, %h : f32
  tai.return %1 : i1
}
