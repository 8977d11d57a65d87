// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s --check-prefixes=CHECK,REV
// RUN: tai-opt %s --tai-forward-diff --canonicalize --cse | FileCheck %s --check-prefixes=CHECK,FWD

// A value known to be discrete cuts the path: comparisons, conversions to
// integers, sizes, and choices of an index or a branch by them, the bits of a
// float included.
// REV-LABEL: func.func @discrete_grad(
//       REV:   memref.store %{{.+}}, %{{.+}}[%{{.+}}] : memref<8xf64>
// FWD-LABEL: func.func @discrete_fwd(
//       FWD:   memref.load
func.func @discrete(%x: memref<8xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : i64
  %zero = arith.constant 0.0 : f64
  %n = memref.dim %x, %c0 : memref<8xf64>
  %0 = memref.load %x[%c0] : memref<8xf64>
  %i = arith.fptosi %0 : f64 to i64
  %f = arith.sitofp %i : i64 to f64
  %bits = arith.bitcast %0 : f64 to i64
  %low = arith.andi %bits, %c7 : i64
  %at = arith.index_cast %low : i64 to index
  %1 = memref.load %x[%at] : memref<8xf64>
  %less = arith.cmpi slt, %bits, %c7 : i64
  %2 = arith.select %less, %1, %zero : f64
  %3 = arith.mulf %2, %f : f64
  memref.store %3, %y[] : memref<f64>
  return
}

// A constant by the program's own word, of memory that is not followed, or of
// bits that are stored.
// REV-LABEL: func.func @stopped_grad(
// FWD-LABEL: func.func @stopped_fwd(
//   CHECK-DAG:   llvm.load
func.func @stopped(%p: !llvm.ptr, %x: memref<f64>, %b: memref<i64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = llvm.load %p : !llvm.ptr -> f64
  %1 = tai.stop_gradient %0 : f64
  %2 = memref.load %x[] : memref<f64>
  %3 = arith.mulf %1, %2 : f64
  %4 = tai.stop_gradient %2 : f64
  %5 = arith.bitcast %4 : f64 to i64
  memref.store %5, %b[] : memref<i64>
  memref.store %3, %y[] : memref<f64>
  return
}

// Bits that no array of floats stands behind: a generator of random numbers.
// REV-LABEL: func.func @random_grad(
// FWD-LABEL: func.func @random_fwd(
func.func @random(%state: memref<i64>, %x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %one = arith.constant 0x3FF0000000000000 : i64
  %c12 = arith.constant 12 : i64
  %0 = memref.load %state[] : memref<i64>
  %1 = arith.shrui %0, %c12 : i64
  %2 = arith.ori %1, %one : i64
  %3 = arith.bitcast %2 : i64 to f64
  %4 = memref.load %x[] : memref<f64>
  %5 = arith.mulf %3, %4 : f64
  memref.store %5, %y[] : memref<f64>
  return
}

// A table that is constant, and memory of the function's own.
// REV-LABEL: func.func @tables_grad(
// FWD-LABEL: func.func @tables_fwd(
memref.global constant @table : memref<2xf64> = dense<[1.0, 2.0]>
llvm.mlir.global internal constant @number(3.0 : f64) : f64
func.func @tables(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : index
  %t = memref.get_global @table : memref<2xf64>
  %0 = memref.load %t[%c1] : memref<2xf64>
  %p = llvm.mlir.addressof @number : !llvm.ptr
  %1 = llvm.load %p : !llvm.ptr -> f64
  %2 = memref.load %x[] : memref<f64>
  %3 = arith.mulf %0, %2 : f64
  %4 = arith.mulf %1, %3 : f64
  memref.store %4, %y[] : memref<f64>
  return
}
