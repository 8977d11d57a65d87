// Memory that an iteration allocates comes from the heap of the device, which
// says who has asked where it is used up.
//
// RUN: tai-opt %s --convert-tai-to-gpu --tai-hoist-allocations | FileCheck %s

// CHECK-DAG: "out of memory on the device: an iteration of kernel 'records' records {} of values
// CHECK-DAG: local-memory.mlir:
// CHECK-LABEL: llvm.func @records_0(
//  CHECK-SAME:   %[[STATE:.+]]: !llvm.ptr
// Once for all iterations of a thread.
//       CHECK:   %[[P:.+]] = llvm.call @tai_rt_local_alloc(%[[STATE]], %
//       CHECK:   scf.for
//   CHECK-NOT:     llvm.call @malloc
//       CHECK:   llvm.call @tai_rt_local_free(%[[P]])

llvm.func @malloc(i64) -> !llvm.ptr
llvm.func @free(!llvm.ptr)

tai.kernel @records(%n: i64, %count: index, %x: f64) {
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%zero) to (%count) {
    %p = llvm.call @malloc(%n) : (i64) -> !llvm.ptr
    llvm.store %x, %p : f64, !llvm.ptr
    llvm.call @free(%p) : (!llvm.ptr) -> ()
  }
  tai.return
}
