// Ops of dialects that nobody has registered are nobody's: passes neither crash
// on them nor change them.
// RUN: tai-opt %s --allow-unregistered-dialect --tai-guard-divisions | FileCheck %s
// RUN: tai-opt %s --allow-unregistered-dialect --tai-fold-angles | FileCheck %s
// RUN: tai-opt %s --allow-unregistered-dialect --tai-to-llvm | FileCheck %s
// RUN: tai-opt %s --allow-unregistered-dialect --tai-vectorize-iterations | FileCheck %s
// RUN: tai-opt %s --allow-unregistered-dialect --tai-vectorize-blocks | FileCheck %s

// CHECK-LABEL: func.func @regions(
//       CHECK:   arith.divsi
//       CHECK:   "foo.op"
//       CHECK:     "foo.end"
func.func @regions(%a: i32, %b: f64) -> f64 {
  %q = arith.divsi %a, %a : i32
  %0 = "foo.op"(%q, %b) ({
  ^bb0(%u: f64):
    "foo.end"(%u) : (f64) -> ()
  }) : (i32, f64) -> f64
  return %0 : f64
}

// CHECK-LABEL: func.func @index(
//       CHECK:   %[[I:.+]] = "foo.index"() : () -> index
//       CHECK:   arith.index_cast %[[I]] : index to i
func.func @index() -> i8 {
  %0 = "foo.index"() : () -> index
  %1 = arith.index_cast %0 : index to i8
  return %1 : i8
}

// CHECK-LABEL: func.func @loop(
//       CHECK:   scf.for
//       CHECK:     "foo.op"
func.func @loop(%n: index, %m: memref<?xf64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    %0 = memref.load %m[%i] : memref<?xf64>
    %1 = "foo.op"(%0) : (f64) -> f64
    memref.store %1, %m[%i] : memref<?xf64>
  }
  return
}
