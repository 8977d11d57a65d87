// RUN: tai-opt %s --tai-fold-angles --canonicalize | FileCheck %s

// By the signs, as at run time: 0, -0, pi, -pi.
// CHECK-LABEL: func.func @origin(
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f64
//   CHECK-DAG:   %[[MINUS:.+]] = arith.constant -0.000000e+00 : f64
//   CHECK-DAG:   %[[PI:.+]] = arith.constant 3.1415926535897931 : f64
//   CHECK-DAG:   %[[DOWN:.+]] = arith.constant -3.1415926535897931 : f64
//       CHECK:   return %[[ZERO]], %[[MINUS]], %[[PI]], %[[DOWN]]
func.func @origin() -> (f64, f64, f64, f64) attributes {passthrough = ["tai.lowered"]} {
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
func.func @computed() -> f32 attributes {passthrough = ["tai.lowered"]} {
  %c = arith.constant 2.0 : f32
  %0 = arith.subf %c, %c : f32
  %1 = arith.mulf %0, %c : f32
  %2 = math.atan2 %0, %1 : f32
  return %2 : f32
}

// CHECK-LABEL: func.func @vector(
//       CHECK:   arith.constant dense<[0.000000e+00, 1.57079637]> : vector<2xf32>
func.func @vector() -> vector<2xf32> attributes {passthrough = ["tai.lowered"]} {
  %y = arith.constant dense<[0.0, 1.0]> : vector<2xf32>
  %x = arith.constant dense<0.0> : vector<2xf32>
  %0 = math.atan2 %y, %x : vector<2xf32>
  return %0 : vector<2xf32>
}

// Values known at run time only stay, and a NaN of the program is one.
// CHECK-LABEL: func.func @other(
//  CHECK-SAME:     %[[X:.+]]: f64)
//       CHECK:   %[[NAN:.+]] = arith.constant 0x7FF8000000000000 : f64
//       CHECK:   %[[ANGLE:.+]] = math.atan2
//       CHECK:   return %[[ANGLE]], %[[NAN]]
func.func @other(%x: f64) -> (f64, f64) attributes {passthrough = ["tai.lowered"]} {
  %zero = arith.constant 0.0 : f64
  %nan = arith.constant 0x7FF8000000000000 : f64
  %0 = math.atan2 %zero, %x : f64
  %1 = math.atan2 %nan, %zero : f64
  return %0, %1 : f64, f64
}

// A cast to a narrow integer and back keeps the low bits alone.
// CHECK-LABEL: func.func @narrow_cast(
//  CHECK-SAME:      %[[I:.+]]: index)
//       CHECK:   %[[WIDE:.+]] = arith.index_cast %[[I]] : index to i64
//       CHECK:   %[[LOW:.+]] = arith.trunci %[[WIDE]] : i64 to i8
//       CHECK:   %[[BACK:.+]] = arith.index_cast %[[LOW]] : i8 to index
//       CHECK:   %[[UWIDE:.+]] = arith.index_castui %[[I]] : index to i64
//       CHECK:   %[[ULOW:.+]] = arith.trunci %[[UWIDE]] : i64 to i32
//       CHECK:   %[[UBACK:.+]] = arith.index_castui %[[ULOW]] : i32 to index
//       CHECK:   return %[[BACK]], %[[UBACK]]
func.func @narrow_cast(%i: index) -> (index, index) attributes {passthrough = ["tai.lowered"]} {
  %0 = arith.index_cast %i : index to i8
  %1 = arith.index_cast %0 : i8 to index
  %2 = arith.index_castui %i : index to i32
  %3 = arith.index_castui %2 : i32 to index
  return %1, %3 : index, index
}

// The index of a loop fits 32 bits: the casts go.
// CHECK-LABEL: func.func @loop_index(
//       CHECK:   scf.for %[[I:[a-z0-9]+]] =
//   CHECK-NOT:     index_cast
//       CHECK:     arith.addi %{{.+}}, %[[I]] : index
func.func @loop_index(%n: index) -> index attributes {passthrough = ["tai.lowered"]} {
  %zero = arith.constant 0 : index
  %one = arith.constant 1 : index
  %sum = scf.for %i = %zero to %n step %one iter_args(%s = %zero) -> index {
    %0 = arith.index_cast %i : index to i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = arith.addi %s, %1 : index
    scf.yield %2 : index
  }
  return %sum : index
}
