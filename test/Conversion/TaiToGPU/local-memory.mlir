// Short memory that an iteration allocates is in the thread, longer memory
// comes from the heap of the device, which says who has asked where it is used
// up.
//
// RUN: tai-opt %s --convert-tai-to-gpu --tai-hoist-allocations --split-input-file | FileCheck %s

// CHECK-DAG: "out of memory on the device: an iteration of kernel 'records' records {} of values
// CHECK-DAG: local-memory.mlir:
// CHECK-LABEL: llvm.func @records_0(
//  CHECK-SAME:   %[[STATE:.+]]: !llvm.ptr
//       CHECK:   %[[OWN:.+]] = llvm.alloca
//       CHECK:   %[[SHORT:.+]] = llvm.icmp "ule" %[[N:.+]], %
//       CHECK:   %[[WANTED:.+]] = llvm.select %[[SHORT]], %{{.+}}, %[[N]]
// Once for all iterations of a thread.
//       CHECK:   %[[P:.+]] = llvm.call @tai_rt_local_alloc(%[[STATE]], %[[WANTED]],
//       CHECK:   scf.for
//   CHECK-NOT:     llvm.call @malloc
//       CHECK:     %[[ADDRESS:.+]] = llvm.select %[[SHORT]], %[[OWN]], %[[P]]
//       CHECK:     llvm.store %{{.+}}, %[[ADDRESS]]
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

// -----

// CHECK-LABEL: llvm.func @short_0(
//       CHECK:   %[[OWN:.+]] = llvm.alloca
//       CHECK:   scf.for
//   CHECK-NOT:     llvm.call @tai_rt_local_alloc
//       CHECK:     llvm.store %{{.+}}, %[[OWN]]
//   CHECK-NOT:     llvm.call @tai_rt_local_free

llvm.func @malloc(i64) -> !llvm.ptr
llvm.func @free(!llvm.ptr)

tai.kernel @short(%count: index, %x: f64) {
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%zero) to (%count) {
    %n = llvm.mlir.constant(4096 : i64) : i64
    %p = llvm.call @malloc(%n) : (i64) -> !llvm.ptr
    llvm.store %x, %p : f64, !llvm.ptr
    llvm.call @free(%p) : (!llvm.ptr) -> ()
  }
  tai.return
}

// -----

// Longer than a thread's memory, or with an address that is stored.
//
// CHECK-LABEL: llvm.func @long_0(
//   CHECK-NOT:   llvm.alloca
//       CHECK:   llvm.call @tai_rt_local_alloc
//       CHECK:   llvm.call @tai_rt_local_alloc

llvm.func @malloc(i64) -> !llvm.ptr
llvm.func @free(!llvm.ptr)

tai.kernel @long(%count: index, %x: f64) {
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) = (%zero) to (%count) {
    %n = llvm.mlir.constant(4097 : i64) : i64
    %p = llvm.call @malloc(%n) : (i64) -> !llvm.ptr
    llvm.store %x, %p : f64, !llvm.ptr
    %m = llvm.mlir.constant(8 : i64) : i64
    %q = llvm.call @malloc(%m) : (i64) -> !llvm.ptr
    llvm.store %q, %p : !llvm.ptr, !llvm.ptr
    llvm.call @free(%q) : (!llvm.ptr) -> ()
    llvm.call @free(%p) : (!llvm.ptr) -> ()
  }
  tai.return
}
