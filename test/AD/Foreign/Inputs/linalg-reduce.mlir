// Row: linalg | `linalg.reduce`, a product
func.func @f(%x: memref<3x4xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  linalg.reduce ins(%x : memref<3x4xf64>) outs(%y : memref<3xf64>) dimensions = [1]
    (%in: f64, %out: f64) {
      %0 = arith.mulf %in, %out : f64
      linalg.yield %0 : f64
    }
  return
}
