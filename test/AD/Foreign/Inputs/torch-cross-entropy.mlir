// Row: torch | cross entropy with integer labels: `linalg.generic` over labels, a mean as a number
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (i)>
#lin = affine_map<(i) -> (i)>
#none = affine_map<(i) -> ()>
func.func @f(%x: tensor<3x4xf64>, %labels: tensor<3xi64>) -> f64 attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %three = arith.constant 3.0 : f64
  %e = tensor.empty() : tensor<3xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<3xf64>) -> tensor<3xf64>
  %s = linalg.generic {indexing_maps = [#id, #row], iterator_types = ["parallel", "reduction"]} ins(%x : tensor<3x4xf64>) outs(%z : tensor<3xf64>) {
  ^bb0(%in: f64, %o: f64):
    %t = math.exp %in : f64
    %u = arith.addf %t, %o : f64
    linalg.yield %u : f64
  } -> tensor<3xf64>
  %e0 = tensor.empty() : tensor<f64>
  %z0 = linalg.fill ins(%zero : f64) outs(%e0 : tensor<f64>) -> tensor<f64>
  %l = linalg.generic {indexing_maps = [#lin, #lin, #none], iterator_types = ["reduction"]} ins(%labels, %s : tensor<3xi64>, tensor<3xf64>) outs(%z0 : tensor<f64>) {
  ^bb0(%y: i64, %sum: f64, %o: f64):
    %i = linalg.index 0 : index
    %k = arith.index_cast %y : i64 to index
    %v = tensor.extract %x[%i, %k] : tensor<3x4xf64>
    %lg = math.log %sum : f64
    %d = arith.subf %lg, %v : f64
    %m = arith.divf %d, %three : f64
    %t = arith.addf %o, %m : f64
    linalg.yield %t : f64
  } -> tensor<f64>
  %r = tensor.extract %l[] : tensor<f64>
  return %r : f64
}
