// Functions of CUDA's math library are linked in, and follow the float mode:
// libdevice by itself would take the approximate square root.
//
// REQUIRES: libdevice
// RUN: tai-translate --tai-to-ptx %s | FileCheck %s --check-prefixes=CHECK,DEFAULT
// RUN: tai-translate --tai-to-ptx --device-floats=strict %s | FileCheck %s --check-prefixes=CHECK,STRICT
// RUN: tai-translate --tai-to-ptx --device-floats=fast %s | FileCheck %s --check-prefixes=CHECK,FAST

// CHECK-NOT: .extern
// CHECK: .entry math
// DEFAULT: sqrt.rn.f32
// STRICT: sqrt.rn.f32
// FAST: sqrt.approx.f32
// DEFAULT: ex2.approx.ftz.f32
// DEFAULT-NOT: .f32.ftz
// DEFAULT-NOT: mul.ftz
// STRICT: mul.rn.f32
// FAST: mul.f32
gpu.module @kernels {
  llvm.func @__nv_sqrtf(f32) -> f32
  llvm.func @__nv_expf(f32) -> f32
  llvm.func @math(%x: !llvm.ptr) attributes {gpu.kernel, nvvm.kernel} {
    %0 = llvm.load %x : !llvm.ptr -> f32
    %1 = llvm.call @__nv_sqrtf(%0) : (f32) -> f32
    %2 = llvm.call @__nv_expf(%1) : (f32) -> f32
    llvm.store %2, %x : f32, !llvm.ptr
    llvm.return
  }
}
