// Row: linalg | `linalg.generic` with a broadcast
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (j)>
func.func @f(%x: memref<3x4xf64>, %b: memref<4xf64>, %y: memref<3x4xf64>) attributes {tai.differentiate} {
  linalg.generic {indexing_maps = [#id, #row, #id], iterator_types = ["parallel", "parallel"]}
    ins(%x, %b : memref<3x4xf64>, memref<4xf64>) outs(%y : memref<3x4xf64>) {
  ^bb0(%p: f64, %q: f64, %o: f64):
    %0 = arith.addf %p, %q : f64
    %1 = math.tanh %0 : f64
    linalg.yield %1 : f64
  }
  return
}
