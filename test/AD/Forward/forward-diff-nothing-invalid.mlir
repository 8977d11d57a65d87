// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-forward-diff

// expected-error @+2 {{there is nothing to differentiate: '@f' writes no array of floats}}
// expected-note @+1 {{name arguments and results}}
func.func @f(%x: f64) -> f64 attributes {tai.differentiate} {
  %0 = arith.mulf %x, %x : f64
  return %0 : f64
}

// -----

// expected-error @+1 {{forward mode has no tangents of arguments and results by position, as 'tai.gradients' asks for}}
func.func @f(%x: f64, %y: memref<f64>)
    attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  memref.store %x, %y[] : memref<f64>
  return
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
