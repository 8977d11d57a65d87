// A cell is zeroed by those threads of a warp that come with one each, together,
// and the cells below it are cleared when all have zeroed their parts.

// RUN: tai-translate --tai-to-ptx --device-target=sm_75 %s | FileCheck %s

// CHECK: .func {{.*}}tai_rt_deactivate
// CHECK: activemask.b32 [[MASK:%r[0-9]+]]
// CHECK: shfl.sync.idx.b32 {{.*}}, [[MASK]];
// CHECK: bar.warp.sync [[MASK]];
module {
  gpu.module @deactivate {
    llvm.func @tai_rt_deactivate(!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr)
    llvm.func @drop(%frame: !llvm.ptr, %tree: !llvm.ptr, %cell: i64) attributes {gpu.kernel, nvvm.kernel} {
      %node = llvm.mlir.constant(0 : i32) : i32
      llvm.call @tai_rt_deactivate(%frame, %tree, %node, %cell, %frame) : (!llvm.ptr, !llvm.ptr, i32, i64, !llvm.ptr) -> ()
      llvm.return
    }
  }
}
