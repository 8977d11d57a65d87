// Row: linalg | `linalg.contract`, `matvec`, `vecmat`, `batch_matvec`, `mmt4d`
func.func @f(%a: tensor<3x4xf64>, %b: tensor<5x4xf64>, %v: tensor<4xf64>, %p: tensor<1x1x2x2xf64>) -> (tensor<3x5xf64>, tensor<4xf64>, tensor<1x1x2x2xf64>) attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %e = tensor.empty() : tensor<3x5xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<3x5xf64>) -> tensor<3x5xf64>
  %c = linalg.contract indexing_maps = [affine_map<(i, j, k) -> (i, k)>, affine_map<(i, j, k) -> (j, k)>, affine_map<(i, j, k) -> (i, j)>] ins(%a, %b : tensor<3x4xf64>, tensor<5x4xf64>) outs(%z : tensor<3x5xf64>) -> tensor<3x5xf64>
  %e3 = tensor.empty() : tensor<3xf64>
  %z3 = linalg.fill ins(%zero : f64) outs(%e3 : tensor<3xf64>) -> tensor<3xf64>
  %m = linalg.matvec ins(%a, %v : tensor<3x4xf64>, tensor<4xf64>) outs(%z3 : tensor<3xf64>) -> tensor<3xf64>
  %e4 = tensor.empty() : tensor<4xf64>
  %z4 = linalg.fill ins(%zero : f64) outs(%e4 : tensor<4xf64>) -> tensor<4xf64>
  %w = linalg.vecmat ins(%m, %a : tensor<3xf64>, tensor<3x4xf64>) outs(%z4 : tensor<4xf64>) -> tensor<4xf64>
  %e5 = tensor.empty() : tensor<1x1x2x2xf64>
  %z5 = linalg.fill ins(%zero : f64) outs(%e5 : tensor<1x1x2x2xf64>) -> tensor<1x1x2x2xf64>
  %q = linalg.mmt4d ins(%p, %p : tensor<1x1x2x2xf64>, tensor<1x1x2x2xf64>) outs(%z5 : tensor<1x1x2x2xf64>) -> tensor<1x1x2x2xf64>
  return %c, %w, %q : tensor<3x5xf64>, tensor<4xf64>, tensor<1x1x2x2xf64>
}
