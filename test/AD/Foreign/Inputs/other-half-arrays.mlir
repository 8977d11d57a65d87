// Row: linalg | `linalg.matmul` of bf16 arrays that sums in f32
// Tolerance: 3e-2
func.func @f(%x: memref<3x4xf32>, %w: memref<4x2xf32>, %y: memref<3x2xf32>) attributes {tai.differentiate} {
  %a = memref.alloc() : memref<3x4xbf16>
  %b = memref.alloc() : memref<4x2xbf16>
  linalg.generic {indexing_maps = [affine_map<(i, j) -> (i, j)>, affine_map<(i, j) -> (i, j)>], iterator_types = ["parallel", "parallel"]} ins(%x : memref<3x4xf32>) outs(%a : memref<3x4xbf16>) {
  ^bb0(%in: f32, %o: bf16):
    %t = arith.truncf %in : f32 to bf16
    linalg.yield %t : bf16
  }
  linalg.generic {indexing_maps = [affine_map<(i, j) -> (i, j)>, affine_map<(i, j) -> (i, j)>], iterator_types = ["parallel", "parallel"]} ins(%w : memref<4x2xf32>) outs(%b : memref<4x2xbf16>) {
  ^bb0(%in: f32, %o: bf16):
    %t = arith.truncf %in : f32 to bf16
    linalg.yield %t : bf16
  }
  linalg.matmul ins(%a, %b : memref<3x4xbf16>, memref<4x2xbf16>) outs(%y : memref<3x2xf32>)
  memref.dealloc %a : memref<3x4xbf16>
  memref.dealloc %b : memref<4x2xbf16>
  return
}
func.func @plain(%x: memref<3x4xf32>, %w: memref<4x2xf32>, %y: memref<3x2xf32>) {
  linalg.matmul ins(%x, %w : memref<3x4xf32>, memref<4x2xf32>) outs(%y : memref<3x2xf32>)
  return
}
