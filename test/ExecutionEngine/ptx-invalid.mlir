// RUN: split-file %s %t
// RUN: not tai-translate --tai-to-ptx %t/none.mlir 2>&1 | FileCheck %s --check-prefix=NONE
// RUN: not tai-translate --tai-to-ptx %t/two.mlir 2>&1 | FileCheck %s --check-prefix=TWO
// RUN: not tai-translate --tai-to-ptx %t/missing.mlir 2>&1 | FileCheck %s --check-prefix=MISSING
// RUN: env TAI_LIBDEVICE=/nowhere/libdevice.10.bc not tai-translate --tai-to-ptx %t/math.mlir 2>&1 | FileCheck %s --check-prefix=MATH
// RUN: not tai-translate --tai-to-ptx %t/wide.mlir 2>&1 | FileCheck %s --check-prefix=WIDE
// RUN: not tai-translate --tai-to-ptx %t/result.mlir 2>&1 | FileCheck %s --check-prefix=RESULT
// RUN: not tai-translate --tai-to-ptx %t/foreign.mlir 2>&1 | FileCheck %s --check-prefix=FOREIGN
// RUN: not tai-translate --tai-to-ptx %t/fatal.mlir 2>&1 | FileCheck %s --check-prefix=FATAL
// RUN: not tai-translate --tai-to-ptx --device-target=sm_60 %t/good.mlir 2>&1 | FileCheck %s --check-prefix=OLD
// RUN: not tai-translate --tai-to-ptx --device-target=gfx90a %t/good.mlir 2>&1 | FileCheck %s --check-prefix=OTHER
// RUN: not tai-translate --tai-to-ptx --device-target=emulated %t/good.mlir 2>&1 | FileCheck %s --check-prefix=EMULATED

// A processor that came after this compiler runs code for the one before it.
// RUN: tai-translate --tai-to-ptx --device-target=sm_999 %t/good.mlir | FileCheck %s --check-prefix=FUTURE

// NONE: error: there is no device code in this module
// TWO: error: device code is in several modules, 'a' and 'b'
// MISSING: error: device code calls what a GPU does not have: 'sinf', called by 'k'; 'tai_rt_parts', called by 'k'
// MATH: error: 'k' calls '__nv_sinf' of CUDA's math library, but there is no libdevice.10.bc: set CUDA_HOME to where CUDA is; searched: /nowhere/libdevice.10.bc
// WIDE: error: parameter 1 of kernel 'k' does not fit into eight bytes
// RESULT: error: kernel 'k' returns a value
// FOREIGN: foreign.mlir:3:5: error: unsupported GPU operation: gpu.barrier
// Code that ends LLVM's own tools is an error here.
// FATAL: error: {{.*}}cos
// OLD: error: unknown GPU 'sm_60': code is made for sm_70 and later
// OTHER: error: unknown GPU 'gfx90a': code is made for sm_70 and later
// EMULATED: error: the emulated device has no PTX
// FUTURE: .target sm_{{[0-9]+}}

//--- none.mlir
llvm.func @host() {
  llvm.return
}

//--- two.mlir
gpu.module @a {
}
gpu.module @b {
}

//--- missing.mlir
gpu.module @kernels {
  llvm.func @sinf(f32) -> f32
  llvm.func @tai_rt_parts(!llvm.ptr, i64, i64, i32) -> i64
  llvm.func @k(%p: !llvm.ptr, %x: f32, %n: i64, %r: i32) attributes {gpu.kernel} {
    %0 = llvm.call @sinf(%x) : (f32) -> f32
    %1 = llvm.call @tai_rt_parts(%p, %n, %n, %r) : (!llvm.ptr, i64, i64, i32) -> i64
    llvm.store %0, %p : f32, !llvm.ptr
    llvm.return
  }
}

//--- math.mlir
gpu.module @kernels {
  llvm.func @__nv_sinf(f32) -> f32
  llvm.func @k(%p: !llvm.ptr, %x: f32) attributes {gpu.kernel} {
    %0 = llvm.call @__nv_sinf(%x) : (f32) -> f32
    llvm.store %0, %p : f32, !llvm.ptr
    llvm.return
  }
}

//--- wide.mlir
gpu.module @kernels {
  llvm.func @k(%p: !llvm.ptr, %x: i128) attributes {gpu.kernel} {
    llvm.return
  }
}

//--- result.mlir
gpu.module @kernels {
  llvm.func @k(%x: i32) -> i32 attributes {gpu.kernel} {
    llvm.return %x : i32
  }
}

//--- foreign.mlir
gpu.module @kernels {
  llvm.func @k() attributes {gpu.kernel} {
    gpu.barrier
    llvm.return
  }
}

//--- fatal.mlir
gpu.module @kernels {
  llvm.func @k(%p: !llvm.ptr, %x: f64) attributes {gpu.kernel} {
    %0 = llvm.intr.cos(%x) : (f64) -> f64
    llvm.store %0, %p : f64, !llvm.ptr
    llvm.return
  }
}

//--- good.mlir
gpu.module @kernels {
  llvm.func @k() attributes {gpu.kernel} {
    llvm.return
  }
}
