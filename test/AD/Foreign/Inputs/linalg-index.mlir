// Row: linalg | `linalg.index`
func.func @f(%x: memref<3x4xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  %z = arith.constant 0.0 : f64
  linalg.fill ins(%z : f64) outs(%y : memref<3xf64>)
  linalg.generic {indexing_maps = [affine_map<(i, j) -> (i, j)>, affine_map<(i, j) -> (i)>], iterator_types = ["parallel", "reduction"]} ins(%x : memref<3x4xf64>) outs(%y : memref<3xf64>) {
  ^bb0(%a: f64, %b: f64):
    %j = linalg.index 1 : index
    %i = linalg.index 0 : index
    %k = arith.muli %i, %j : index
    %n = arith.index_cast %k : index to i64
    %w = arith.sitofp %n : i64 to f64
    %p = arith.mulf %a, %w : f64
    %q = math.sin %p : f64
    %r = arith.addf %b, %q : f64
    linalg.yield %r : f64
  }
  return
}
