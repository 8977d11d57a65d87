// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics
// RUN: sed -e 's/no derivative rule, but a gradient/no tangent rule, but a tangent/' %s \
// RUN:   | tai-opt --tai-forward-diff --split-input-file --verify-diagnostics

// Each refusal of an op that a pass lowers names the pass: on a path between
// values, on an array with a derivative, behind a region.

func.func @value(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  // expected-error @+2 {{'complex.create' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %1 = complex.create %0, %0 : complex<f64>
  %2 = complex.abs %1 : complex<f64>
  memref.store %2, %y[%c0] : memref<4xf64>
  return
}

// -----

func.func @llvm(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  // expected-error @+2 {{'llvm.fmul' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %1 = llvm.fmul %0, %0 : f64
  memref.store %1, %y[%c0] : memref<4xf64>
  return
}

// -----

func.func @structured(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  // expected-error @+2 {{cannot differentiate 'linalg.copy' on an array with a derivative}}
  // expected-note @+1 {{run '--convert-linalg-to-loops' before}}
  linalg.copy ins(%x : memref<4xf64>) outs(%y : memref<4xf64>)
  return
}

// -----

func.func @view(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{cannot differentiate 'memref.subview' on an array with a derivative}}
  // expected-note @+1 {{run '--fold-memref-alias-ops' before}}
  %v = memref.subview %x[1] [2] [1] : memref<4xf64> to memref<2xf64, strided<[1], offset: 1>>
  %0 = memref.load %x[%c0] : memref<4xf64>
  memref.store %0, %y[%c0] : memref<4xf64>
  return
}

// -----

func.func @affine(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{cannot differentiate 'affine.load' on an array with a derivative}}
  // expected-note @+1 {{run '--lower-affine' before}}
  %0 = affine.load %x[%c0] : memref<4xf64>
  memref.store %0, %y[%c0] : memref<4xf64>
  return
}

// -----

func.func @vector(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  // expected-error @+2 {{cannot differentiate 'vector.load' on an array with a derivative}}
  // expected-note @+1 {{run '--tai-prepare-foreign' before}}
  %0 = vector.load %x[%c0] : memref<4xf64>, vector<4xf64>
  %1 = vector.reduction <add>, %0 : vector<4xf64> into f64
  memref.store %1, %y[%c0] : memref<4xf64>
  return
}

// -----

// expected-error @+2 {{cannot differentiate a function of several blocks; structured control flow is expected}}
// expected-note @+1 {{run '--lift-cf-to-scf' before}}
func.func @blocks(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  cf.br ^next
^next:
  return
}

// -----

// An op that nothing lowers.
func.func @bits(%x: memref<f64>, %y: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f64>
  // expected-error @+2 {{'arith.bitcast' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops, or keep it out of what the}}
  %1 = arith.bitcast %0 : f64 to i64
  %2 = arith.bitcast %1 : i64 to f64
  memref.store %2, %y[] : memref<f64>
  return
}
