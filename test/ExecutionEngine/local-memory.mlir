// A thread that is given no memory frees its memory and goes to where the sums
// of the block are added up, or to the end of its function.
//
// RUN: tai-translate --tai-to-device-llvmir --device-target=sm_90 %s | FileCheck %s

// CHECK-LABEL: define ptx_kernel void @summed(
//       CHECK:   %[[A:.+]] = tail call fastcc ptr @tai_rt_local_alloc(
//       CHECK:   %[[NO_A:.+]] = icmp eq ptr %[[A]], null
//       CHECK:   br i1 %[[NO_A]], label %[[END_A:.+]], label %
//       CHECK:   %[[B:.+]] = tail call fastcc ptr @tai_rt_local_alloc(
//       CHECK:   %[[NO_B:.+]] = icmp eq ptr %[[B]], null
//       CHECK:   br i1 %[[NO_B]], label %[[END_B:.+]], label %
//       CHECK:   store double 0.000000e+00, ptr %[[B]]
//       CHECK: [[MEETING:\..*exit]]:
//       CHECK:   call {{.*}} @llvm.nvvm.shfl.sync
//       CHECK:   ret void
//       CHECK:   call fastcc void @tai_rt_local_free(ptr nonnull %[[A]])
//       CHECK:   br label %[[MEETING]]

// Memory of an earlier function is there or not.
// CHECK-LABEL: define ptx_kernel void @given(
//       CHECK:   %[[P:.+]] = load ptr, ptr %0
//       CHECK:   %[[NONE:.+]] = icmp eq ptr %[[P]], null
//       CHECK:   br i1 %[[NONE]],
//       CHECK:   store i32 0, ptr %[[P]]
//   CHECK-NOT:   tai_rt_local_given

module attributes {gpu.container_module} {
  gpu.module @kernels {
    llvm.mlir.global internal constant @text("none for {}\00")
    llvm.func @tai_rt_local_alloc(!llvm.ptr, i64, !llvm.ptr, !llvm.ptr) -> !llvm.ptr
    llvm.func @tai_rt_local_free(!llvm.ptr)
    llvm.func @tai_rt_local_given(!llvm.ptr) -> !llvm.ptr
    llvm.func @tai_dev_reduce_add_f64(!llvm.ptr, f64)
    llvm.func @summed(%state: !llvm.ptr, %n: i64, %target: !llvm.ptr) attributes {gpu.kernel} {
      %text = llvm.mlir.addressof @text : !llvm.ptr
      %zero = llvm.mlir.constant(0 : i64) : i64
      %one = llvm.mlir.constant(1 : i64) : i64
      %none = llvm.mlir.constant(0.0 : f64) : f64
      %slot = llvm.alloca %one x f64 : (i64) -> !llvm.ptr
      llvm.store %none, %slot : f64, !llvm.ptr
      llvm.br ^head(%zero : i64)
    ^head(%i: i64):
      %more = llvm.icmp "slt" %i, %n : i64
      llvm.cond_br %more, ^body, ^sum
    ^body:
      %a = llvm.call @tai_rt_local_alloc(%state, %n, %text, %text) : (!llvm.ptr, i64, !llvm.ptr, !llvm.ptr) -> !llvm.ptr
      %b = llvm.call @tai_rt_local_alloc(%state, %i, %text, %text) : (!llvm.ptr, i64, !llvm.ptr, !llvm.ptr) -> !llvm.ptr
      llvm.store %none, %b : f64, !llvm.ptr
      %v = llvm.load %a : !llvm.ptr -> f64
      llvm.store %v, %slot : f64, !llvm.ptr
      llvm.call @tai_rt_local_free(%b) : (!llvm.ptr) -> ()
      llvm.call @tai_rt_local_free(%a) : (!llvm.ptr) -> ()
      %next = llvm.add %i, %one : i64
      llvm.br ^head(%next : i64)
    ^sum:
      %sum = llvm.load %slot : !llvm.ptr -> f64
      llvm.call @tai_dev_reduce_add_f64(%target, %sum) : (!llvm.ptr, f64) -> ()
      llvm.return
    }
    llvm.func @given(%slot: !llvm.ptr) attributes {gpu.kernel} {
      %zero = llvm.mlir.constant(0 : i32) : i32
      %loaded = llvm.load %slot : !llvm.ptr -> !llvm.ptr
      %p = llvm.call @tai_rt_local_given(%loaded) : (!llvm.ptr) -> !llvm.ptr
      llvm.store %zero, %p : i32, !llvm.ptr
      llvm.return
    }
  }
}
