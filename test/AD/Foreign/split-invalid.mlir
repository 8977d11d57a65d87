// RUN: tai-opt %s --tai-prepare-foreign --tai-make-adjoint --split-input-file --verify-diagnostics

// expected-error @+1 {{cannot split the derivative of this function; 'tai.split' is for a 'func.func' of memrefs, numbers and vectors}}
func.func @tensors(%x: tensor<4xf32>) -> tensor<4xf32> attributes {tai.differentiate, tai.split} {
  %0 = linalg.map { math.sin } ins(%x : tensor<4xf32>) outs(%x : tensor<4xf32>)
  return %0 : tensor<4xf32>
}

// -----

// expected-error @+1 {{cannot make the adjoint '@f_augmented': the name is taken}}
func.func @f(%x: memref<4xf32>) attributes {tai.differentiate, tai.split} {
  %c1 = arith.constant 1 : index
  %0 = memref.load %x[%c1] : memref<4xf32>
  memref.store %0, %x[%c1] : memref<4xf32>
  return
}
// expected-note @+1 {{by this}}
func.func @f_augmented() {
  return
}

// -----

// expected-error @+1 {{'tai.split' stands beside 'tai.differentiate', and is a unit attribute until the functions are made}}
func.func @alone(%x: memref<4xf32>) attributes {tai.split} {
  return
}

// -----

// expected-error @+1 {{'tai.split' stands beside 'tai.differentiate', and is a unit attribute until the functions are made}}
func.func @number(%x: memref<4xf32>) attributes {tai.differentiate, tai.split = 2 : i64} {
  return
}
