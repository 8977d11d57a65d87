// Row: tensor | a function of a tensor that returns a number (a loss)
#id = affine_map<(i) -> (i)>
#none = affine_map<(i) -> ()>
func.func @f(%x: tensor<4xf64>, %w: tensor<4xf64>) -> f64 attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %e = tensor.empty() : tensor<f64>
  %i = linalg.fill ins(%zero : f64) outs(%e : tensor<f64>) -> tensor<f64>
  %s = linalg.generic {indexing_maps = [#id, #id, #none], iterator_types = ["reduction"]}
    ins(%x, %w : tensor<4xf64>, tensor<4xf64>) outs(%i : tensor<f64>) {
  ^bb0(%a: f64, %b: f64, %o: f64):
    %0 = arith.mulf %a, %b : f64
    %1 = math.sin %0 : f64
    %2 = arith.addf %o, %1 : f64
    linalg.yield %2 : f64
  } -> tensor<f64>
  %r = tensor.extract %s[] : tensor<f64>
  return %r : f64
}
