// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-shadow-execution
// RUN: not tai-opt --tai-shadow-execution=f64-shadow=f64 %s --split-input-file 2>&1 | FileCheck %s

// CHECK: error: the shadows of f64 are f80 or f128, not 'f64'
// expected-error @below {{the floats of this module have shadows already}}
llvm.mlir.global external @tai_rt_shadows() : !llvm.ptr

llvm.func @k(%frame: !llvm.ptr, %a: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  llvm.return %a : f32
}
