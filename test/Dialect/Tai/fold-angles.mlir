// RUN: tai-opt %s --tai-fold-angles --canonicalize | FileCheck %s

// By the signs, as at run time: 0, -0, pi, -pi.
// CHECK-LABEL: func.func @origin(
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f64
//   CHECK-DAG:   %[[MINUS:.+]] = arith.constant -0.000000e+00 : f64
//   CHECK-DAG:   %[[PI:.+]] = arith.constant 3.1415926535897931 : f64
//   CHECK-DAG:   %[[DOWN:.+]] = arith.constant -3.1415926535897931 : f64
//       CHECK:   return %[[ZERO]], %[[MINUS]], %[[PI]], %[[DOWN]]
func.func @origin() -> (f64, f64, f64, f64) {
  %p = arith.constant 0.0 : f64
  %m = arith.constant -0.0 : f64
  %0 = math.atan2 %p, %p : f64
  %1 = math.atan2 %m, %p : f64
  %2 = math.atan2 %p, %m : f64
  %3 = math.atan2 %m, %m : f64
  return %0, %1, %2, %3 : f64, f64, f64, f64
}

// Zeros that are computed.
// CHECK-LABEL: func.func @computed(
//       CHECK:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   return %[[ZERO]]
func.func @computed() -> f32 {
  %c = arith.constant 2.0 : f32
  %0 = arith.subf %c, %c : f32
  %1 = arith.mulf %0, %c : f32
  %2 = math.atan2 %0, %1 : f32
  return %2 : f32
}

// CHECK-LABEL: func.func @vector(
//       CHECK:   arith.constant dense<[0.000000e+00, 1.57079637]> : vector<2xf32>
func.func @vector() -> vector<2xf32> {
  %y = arith.constant dense<[0.0, 1.0]> : vector<2xf32>
  %x = arith.constant dense<0.0> : vector<2xf32>
  %0 = math.atan2 %y, %x : vector<2xf32>
  return %0 : vector<2xf32>
}

// What is known at run time only stays, and a NaN of the program is one.
// CHECK-LABEL: func.func @other(
//  CHECK-SAME:     %[[X:.+]]: f64)
//       CHECK:   %[[NAN:.+]] = arith.constant 0x7FF8000000000000 : f64
//       CHECK:   %[[ANGLE:.+]] = math.atan2
//       CHECK:   return %[[ANGLE]], %[[NAN]]
func.func @other(%x: f64) -> (f64, f64) {
  %zero = arith.constant 0.0 : f64
  %nan = arith.constant 0x7FF8000000000000 : f64
  %0 = math.atan2 %zero, %x : f64
  %1 = math.atan2 %nan, %zero : f64
  return %0, %1 : f64, f64
}
