// Row: linalg | `linalg.generic` with transposed and shifted maps and an index
#a = affine_map<(i, j, k) -> (k, i)>
#b = affine_map<(i, j, k) -> (j + k)>
#c = affine_map<(i, j, k) -> (j, i)>
func.func @f(%x: memref<3x2xf64>, %w: memref<6xf64>, %y: memref<4x2xf64>) attributes {tai.differentiate} {
  linalg.generic {indexing_maps = [#a, #b, #c], iterator_types = ["parallel", "parallel", "reduction"]}
    ins(%x, %w : memref<3x2xf64>, memref<6xf64>) outs(%y : memref<4x2xf64>) {
  ^bb0(%p: f64, %q: f64, %o: f64):
    %k = linalg.index 2 : index
    %ki = arith.index_cast %k : index to i64
    %kf = arith.sitofp %ki : i64 to f64
    %0 = arith.mulf %p, %q : f64
    %1 = arith.mulf %0, %kf : f64
    %2 = math.sin %1 : f64
    %3 = arith.addf %2, %o : f64
    linalg.yield %3 : f64
  }
  return
}
