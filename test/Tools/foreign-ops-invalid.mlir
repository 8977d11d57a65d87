// REQUIRES: plugin
// RUN: mlir-opt-22 %s --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:   --pass-pipeline='builtin.module(tai-make-adjoint)' --split-input-file --verify-diagnostics
// RUN: sed -e 's/no derivative rule, but a gradient/no tangent rule, but a tangent/' \
// RUN:   -e 's/what the gradient/what the derivative/' %s \
// RUN:   | mlir-opt-22 --load-dialect-plugin=%tai_plugin --load-pass-plugin=%tai_plugin \
// RUN:     --pass-pipeline='builtin.module(tai-forward-diff)' --split-input-file --verify-diagnostics

// Dialects that tai has no rules for, in a stock mlir-opt: a value that has a
// derivative does not lose it there in silence.

func.func @complex(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'complex.create' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %1 = complex.create %0, %0 : complex<f64>
  %2 = complex.mul %1, %1 : complex<f64>
  %3 = complex.im %2 : complex<f64>
  memref.store %3, %y[] : memref<f64>
  return
}

// -----

func.func @tensor(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'tensor.from_elements' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{run '--one-shot-bufferize' before}}
  %1 = tensor.from_elements %0, %0 : tensor<2xf64>
  %2 = tensor.extract %1[%c0] : tensor<2xf64>
  memref.store %2, %y[] : memref<f64>
  return
}

// -----

// A region that captures the value.
func.func @generate(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'tensor.generate' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{run '--one-shot-bufferize' before}}
  %1 = tensor.generate {
  ^bb0(%i: index):
    tensor.yield %0 : f64
  } : tensor<2xf64>
  %2 = tensor.extract %1[%c0] : tensor<2xf64>
  memref.store %2, %y[] : memref<f64>
  return
}

// -----

// An array of complex numbers has no second one for its derivative.
func.func @complex_array(%x: memref<4xcomplex<f64>>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{'memref.load' reads floats from memory that derivatives are not followed through}}
  // expected-note @+1 {{load it from a field}}
  %0 = memref.load %x[%c0] : memref<4xcomplex<f64>>
  %1 = complex.re %0 : complex<f64>
  memref.store %1, %y[] : memref<f64>
  return
}
