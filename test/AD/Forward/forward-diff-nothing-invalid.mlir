// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-forward-diff

// expected-error @+2 {{there is nothing to differentiate: '@f' writes no array of floats}}
// expected-note @+1 {{name arguments and results}}
func.func @f(%x: f64) -> f64 attributes {tai.differentiate} {
  %0 = arith.mulf %x, %x : f64
  return %0 : f64
}

// -----

// expected-error @+2 {{there is nothing to differentiate: '@f' writes no array of floats}}
// expected-note @+1 {{name arguments and results}}
func.func @f(%x: f64, %y: memref<f64>)
    attributes {tai.differentiate, tai.gradients = array<i64: 0>} {
  memref.store %x, %y[] : memref<f64>
  return
}

// -----

// expected-error @+1 {{cannot differentiate by position 2: there are 2 arguments and 0 results}}
func.func @f(%x: f64, %y: memref<f64>)
    attributes {tai.differentiate, tai.gradients = array<i64: 0, 2>} {
  memref.store %x, %y[] : memref<f64>
  return
}

// -----

// expected-error @+1 {{cannot differentiate a function that returns an array}}
func.func @f(%x: f64, %y: memref<f64>) -> memref<f64>
    attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  memref.store %x, %y[] : memref<f64>
  return %y : memref<f64>
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
