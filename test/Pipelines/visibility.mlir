// RUN: tai-opt %s --tai-autodiff | FileCheck %s
// RUN: tai-opt %s --tai-autodiff-forward | FileCheck %s --check-prefix=FORWARD

// A derivative has the visibility of its function; one that is there already
// keeps its own.

//   CHECK-DAG: func.func private @hidden(
//   CHECK-DAG: func.func private @hidden_grad(
// FORWARD-DAG: func.func private @hidden_fwd(
func.func private @hidden(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %a = memref.load %x[%c0] : memref<4xf64>
  %b = math.sin %a : f64
  memref.store %b, %y[%c0] : memref<4xf64>
  return
}

//   CHECK-DAG: func.func private @prepared_grad(
// FORWARD-DAG: func.func private @prepared_fwd(
func.func private @prepared(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  linalg.map { math.exp } ins(%x : memref<4xf64>) outs(%y : memref<4xf64>)
  return
}

//   CHECK-DAG: func.func private @hidden_split_augmented(
//   CHECK-DAG: func.func private @hidden_split_reverse(
func.func private @hidden_split(%x: memref<4xf64>) attributes {tai.differentiate, tai.split} {
  linalg.map { math.exp } ins(%x : memref<4xf64>) outs(%x : memref<4xf64>)
  return
}

//   CHECK-DAG: func.func nested @nested_grad(
// FORWARD-DAG: func.func nested @nested_fwd(
func.func nested @nested(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  linalg.map { math.exp } ins(%x : memref<4xf64>) outs(%y : memref<4xf64>)
  return
}

//   CHECK-DAG: func.func @by_hand(
func.func private @own(%x: memref<4xf64>) attributes {tai.differentiate, tai.adjoint = @by_hand} {
  linalg.map { math.exp } ins(%x : memref<4xf64>) outs(%x : memref<4xf64>)
  return
}
func.func @by_hand(%x: memref<4xf64>, %gx: memref<4xf64>) {
  return
}
