// Row: linalg | `linalg.fill`, `linalg.matmul` on buffers
func.func @f(%a: memref<3x4xf64>, %b: memref<4x2xf64>, %c: memref<3x2xf64>) attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  linalg.fill ins(%zero : f64) outs(%c : memref<3x2xf64>)
  linalg.matmul ins(%a, %b : memref<3x4xf64>, memref<4x2xf64>) outs(%c : memref<3x2xf64>)
  return
}
