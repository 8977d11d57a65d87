// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-make-adjoint

// A gradient that is asked for and would be empty is an error.
// expected-error @+2 {{there is nothing to differentiate: '@f' writes no array of floats that a derivative is wanted of}}
// expected-note @+1 {{name arguments and results by their positions, as in 'tai.gradients = array<i64: 0, 1>'}}
func.func @f(%x: f64) -> f64 attributes {tai.differentiate} {
  %0 = arith.mulf %x, %x : f64
  return %0 : f64
}

// -----

// A derivative of the result is wanted, but not named.
// expected-error @+2 {{'@f' writes no array of floats}}
// expected-note @+1 {{array<i64: 0, 1>}}
func.func @f(%x: memref<f64>) -> f64 attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  %1 = arith.mulf %0, %0 : f64
  return %1 : f64
}

// -----

// expected-error @+2 {{'@f' writes no array of floats}}
// expected-note @+1 {{array<i64: 0, 2>}}
func.func @f(%x: tensor<4xf64>, %n: index) -> tensor<4xf64> attributes {tai.differentiate} {
  return %x : tensor<4xf64>
}

// -----

// No argument is read.
// expected-error @+2 {{'@f' reads no array of floats that a derivative is wanted of}}
// expected-note @+1 {{array<i64: 0, 1>}}
func.func @f(%x: memref<f64>) -> f64
    attributes {tai.differentiate, tai.gradients = array<i64: 1>} {
  %0 = memref.load %x[] : memref<f64>
  return %0 : f64
}

// -----

func.func private @beside()
// expected-note @+1 {{run the pass on this module}}
module @inner {
  // expected-error @+1 {{cannot differentiate '@f': it stands in a nested module}}
  func.func @f(%x: memref<f64>) attributes {tai.differentiate} {
    %0 = memref.load %x[] : memref<f64>
    memref.store %0, %x[] : memref<f64>
    return
  }
}
