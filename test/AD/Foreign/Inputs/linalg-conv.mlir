// Row: linalg | `linalg.conv_2d`
func.func @f(%x: memref<5x5xf64>, %w: memref<2x3xf64>, %y: memref<4x3xf64>) attributes {tai.differentiate} {
  linalg.conv_2d ins(%x, %w : memref<5x5xf64>, memref<2x3xf64>) outs(%y : memref<4x3xf64>)
  return
}
