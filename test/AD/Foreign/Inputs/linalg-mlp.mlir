// Row: linalg | a perceptron of two layers after one-shot-bufferize
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (j)>
func.func @f(%x: memref<2x3xf32, strided<[?, ?], offset: ?>>, %w: memref<3x4xf32, strided<[?, ?], offset: ?>>, %b: memref<4xf32, strided<[?], offset: ?>>, %v: memref<4x2xf32, strided<[?, ?], offset: ?>>, %y: memref<2x2xf32>) attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f32
  %h = memref.alloc() {alignment = 64 : i64} : memref<2x4xf32>
  linalg.fill ins(%zero : f32) outs(%h : memref<2x4xf32>)
  linalg.matmul ins(%x, %w : memref<2x3xf32, strided<[?, ?], offset: ?>>, memref<3x4xf32, strided<[?, ?], offset: ?>>) outs(%h : memref<2x4xf32>)
  linalg.generic {indexing_maps = [#row, #id], iterator_types = ["parallel", "parallel"]}
    ins(%b : memref<4xf32, strided<[?], offset: ?>>) outs(%h : memref<2x4xf32>) {
  ^bb0(%q: f32, %o: f32):
    %0 = arith.addf %q, %o : f32
    %1 = math.tanh %0 : f32
    linalg.yield %1 : f32
  }
  %o = memref.alloc() {alignment = 64 : i64} : memref<2x2xf32>
  linalg.fill ins(%zero : f32) outs(%o : memref<2x2xf32>)
  linalg.matmul ins(%h, %v : memref<2x4xf32>, memref<4x2xf32, strided<[?, ?], offset: ?>>) outs(%o : memref<2x2xf32>)
  memref.copy %o, %y : memref<2x2xf32> to memref<2x2xf32>
  memref.dealloc %h : memref<2x4xf32>
  memref.dealloc %o : memref<2x2xf32>
  return
}
