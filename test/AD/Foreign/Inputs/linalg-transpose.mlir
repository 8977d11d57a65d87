// Row: linalg | `linalg.transpose`, `linalg.broadcast`, `linalg.map`
func.func @f(%x: memref<3x4xf64>, %y: memref<4x3x2xf64>) attributes {tai.differentiate} {
  %t = memref.alloc() : memref<4x3xf64>
  %u = memref.alloc() : memref<4x3xf64>
  linalg.transpose ins(%x : memref<3x4xf64>) outs(%t : memref<4x3xf64>) permutation = [1, 0]
  linalg.map { math.sin } ins(%t : memref<4x3xf64>) outs(%u : memref<4x3xf64>)
  linalg.broadcast ins(%u : memref<4x3xf64>) outs(%y : memref<4x3x2xf64>) dimensions = [2]
  memref.dealloc %t : memref<4x3xf64>
  memref.dealloc %u : memref<4x3xf64>
  return
}
