// Row: linalg | `linalg.batch_matmul`, `linalg.dot` of sizes known at run time
func.func @f(%a: memref<?x?x?xf32>, %b: memref<?x?x?xf32>, %c: memref<?x?x?xf32>, %u: memref<?xf32>, %d: memref<f32>) attributes {tai.differentiate} {
  linalg.batch_matmul ins(%a, %b : memref<?x?x?xf32>, memref<?x?x?xf32>) outs(%c : memref<?x?x?xf32>)
  linalg.dot ins(%u, %u : memref<?xf32>, memref<?xf32>) outs(%d : memref<f32>)
  return
}
