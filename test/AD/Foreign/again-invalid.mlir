// RUN: tai-opt %s --tai-make-adjoint --split-input-file --verify-diagnostics

memref.global @count : memref<1xi32> = dense<0>

// expected-note @+1 {{it overwrites values that the gradient needs, or keeps them in arrays of its own}}
func.func @counted(%x: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %g = memref.get_global @count : memref<1xi32>
  %n = memref.load %g[%c0] : memref<1xi32>
  %m = arith.addi %n, %one : i32
  // expected-error @+1 {{the gradient has to run this function again, and 'memref.store' would happen twice}}
  memref.store %m, %g[%c0] : memref<1xi32>
  %a = memref.load %x[%c0] : memref<4xf64>
  %b = arith.mulf %a, %a : f64
  memref.store %b, %x[%c0] : memref<4xf64>
  return
}
