// Row: tensor | `scf.if` that yields tensors, chosen by a value; a dense constant of weights
#id = affine_map<(i) -> (i)>
func.func @f(%x: tensor<4xf64>, %y: tensor<4xf64>) -> tensor<4xf64> attributes {tai.differentiate} {
  %w = arith.constant dense<[0.5, -1.0, 2.0, 0.25]> : tensor<4xf64>
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %a = tensor.extract %x[%c0] : tensor<4xf64>
  %p = arith.cmpf ogt, %a, %zero : f64
  %r = scf.if %p -> tensor<4xf64> {
    %e = tensor.empty() : tensor<4xf64>
    %t = linalg.generic {indexing_maps = [#id, #id, #id], iterator_types = ["parallel"]} ins(%x, %w : tensor<4xf64>, tensor<4xf64>) outs(%e : tensor<4xf64>) {
    ^bb0(%q: f64, %s: f64, %o: f64):
      %0 = arith.mulf %q, %s : f64
      %1 = math.sin %0 : f64
      linalg.yield %1 : f64
    } -> tensor<4xf64>
    scf.yield %t : tensor<4xf64>
  } else {
    scf.yield %y : tensor<4xf64>
  }
  return %r : tensor<4xf64>
}
