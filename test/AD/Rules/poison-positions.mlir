// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-forward-diff --canonicalize --cse | FileCheck %s --check-prefix=FWD

// At the position -1 of a vector is poison, which depends on nothing. Values
// beside it keep their gradient.
// CHECK-LABEL: func.func @extract_grad(
//  CHECK-SAME:     %{{[^:]+}}: memref<2xf64>, %{{[^:]+}}: memref<2xf64>, %[[XG:[^:]+]]: memref<2xf64>, %[[YG:[^:]+]]: memref<2xf64>)
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//       CHECK:   %[[G:.+]] = memref.load %[[YG]][%[[C1]]]
//       CHECK:   %[[OLD:.+]] = memref.load %[[XG]][%[[C0]]]
//       CHECK:   %[[NEW:.+]] = arith.addf %[[OLD]], %[[G]]
//       CHECK:   memref.store %[[NEW]], %[[XG]][%[[C0]]]
// FWD-LABEL: func.func @extract_fwd(
func.func @extract(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %0 = memref.load %x[%c0] : memref<2xf64>
  %1 = vector.broadcast %0 : f64 to vector<3x2xf64>
  %2 = vector.extract %1[-1] : vector<2xf64> from vector<3x2xf64>
  %3 = vector.extract %2[%c1] : f64 from vector<2xf64>
  %4 = vector.extract %1[%c0, -1] : f64 from vector<3x2xf64>
  %5 = arith.addf %3, %4 : f64
  memref.store %5, %y[%c0] : memref<2xf64>
  memref.store %0, %y[%c1] : memref<2xf64>
  return
}

// CHECK-LABEL: func.func @insert_grad(
//   CHECK-NOT:   math.cos
//       CHECK:   return
// FWD-LABEL: func.func @insert_fwd(
func.func @insert(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<2xf64>
  %1 = math.sin %0 : f64
  %2 = vector.broadcast %1 : f64 to vector<2x2xf64>
  %3 = vector.insert %1, %2 [%c0, -1] : f64 into vector<2x2xf64>
  %4 = vector.extract %3[0, 1] : f64 from vector<2x2xf64>
  memref.store %4, %y[%c0] : memref<2xf64>
  return
}
