// REQUIRES: plugin
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(convert-to-llvm)' --split-input-file --verify-diagnostics
// RUN: tai-opt %s --convert-to-llvm --split-input-file --verify-diagnostics

// A kernel is not converted in part.
// expected-error @+3 {{'tai.kernel' op has no conversion to the LLVM dialect by itself}}
// expected-note @+2 {{run '--tai-to-llvm' before}}
// expected-error @+1 {{failed to legalize operation 'tai.kernel' that was explicitly marked illegal}}
tai.kernel @square(%a: f32) -> f32 {
  %0 = arith.mulf %a, %a : f32
  tai.return %0 : f32
}

// -----

func.func @matrix(%a: vector<3xf32>) -> f32 {
  // expected-error @+3 {{'tai.dot' op has no conversion to the LLVM dialect by itself}}
  // expected-note @+2 {{run '--tai-scalarize' before}}
  // expected-error @+1 {{failed to legalize operation 'tai.dot' that was explicitly marked illegal}}
  %0 = tai.dot %a, %a : vector<3xf32>
  return %0 : f32
}

// -----

func.func @local() -> f32 {
  // expected-error @+3 {{'tai.alloca' op has no conversion to the LLVM dialect by itself}}
  // expected-note @+2 {{run '--tai-eliminate-locals' before}}
  // expected-error @+1 {{failed to legalize operation 'tai.alloca' that was explicitly marked illegal}}
  %0 = tai.alloca : !tai.local<f32>
  %1 = tai.local_load %0 : f32
  return %1 : f32
}

// -----

func.func @energy(%x: f64) -> f64 {
  %0 = arith.mulf %x, %x : f64
  return %0 : f64
}
func.func @slope(%x: f64) -> f64 {
  %seed = arith.constant 1.0 : f64
  // expected-error @+3 {{'tai.grad' op has no conversion to the LLVM dialect by itself}}
  // expected-note @+2 {{run '--tai-expand-gradients' before}}
  // expected-error @+1 {{failed to legalize operation 'tai.grad' that was explicitly marked illegal}}
  %0 = tai.grad @energy(%x, %seed) : (f64, f64) -> f64
  return %0 : f64
}

// -----

func.func @number(%a: f64) {
  // expected-error @+3 {{'tai_check.close' op has no conversion to the LLVM dialect by itself}}
  // expected-note @+2 {{run '--tai-to-llvm' before}}
  // expected-error @+1 {{failed to legalize operation 'tai_check.close' that was explicitly marked illegal}}
  tai_check.close %a, %a tolerance 0.0 : f64
  return
}
