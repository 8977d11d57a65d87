// Row: torch | a maximum with its place: `linalg.generic` with two reductions
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (i)>
func.func @f(%x: tensor<3x4xf64>, %v: tensor<3x4xf64>) -> (tensor<3xf64>, tensor<3xf64>) attributes {tai.differentiate} {
  %low = arith.constant -1.0e30 : f64
  %zero = arith.constant 0 : i64
  %e = tensor.empty() : tensor<3xf64>
  %ei = tensor.empty() : tensor<3xi64>
  %l = linalg.fill ins(%low : f64) outs(%e : tensor<3xf64>) -> tensor<3xf64>
  %z = linalg.fill ins(%zero : i64) outs(%ei : tensor<3xi64>) -> tensor<3xi64>
  %r:2 = linalg.generic {indexing_maps = [#id, #row, #row], iterator_types = ["parallel", "reduction"]} ins(%x : tensor<3x4xf64>) outs(%l, %z : tensor<3xf64>, tensor<3xi64>) {
  ^bb0(%in: f64, %o: f64, %oi: i64):
    %j = linalg.index 1 : index
    %k = arith.index_cast %j : index to i64
    %m = arith.maximumf %in, %o : f64
    %p = arith.cmpf ogt, %in, %o : f64
    %s = arith.select %p, %k, %oi : i64
    linalg.yield %m, %s : f64, i64
  } -> (tensor<3xf64>, tensor<3xi64>)
  %g = linalg.generic {indexing_maps = [affine_map<(i) -> (i)>, affine_map<(i) -> (i)>], iterator_types = ["parallel"]} ins(%r#1 : tensor<3xi64>) outs(%e : tensor<3xf64>) {
  ^bb0(%in: i64, %o: f64):
    %i = linalg.index 0 : index
    %k = arith.index_cast %in : i64 to index
    %t = tensor.extract %v[%i, %k] : tensor<3x4xf64>
    %u = arith.mulf %t, %t : f64
    linalg.yield %u : f64
  } -> tensor<3xf64>
  return %r#0, %g : tensor<3xf64>, tensor<3xf64>
}
