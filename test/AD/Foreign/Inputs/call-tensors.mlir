// Row: func | `func.call` of private functions of tensors, called twice and in a chain
#id = affine_map<(i, j) -> (i, j)>
func.func private @relu(%x: tensor<3x3xf64>) -> tensor<3x3xf64> {
  %zero = arith.constant 0.0 : f64
  %r = linalg.generic {indexing_maps = [#id], iterator_types = ["parallel", "parallel"]} outs(%x : tensor<3x3xf64>) {
  ^bb0(%o: f64):
    %m = arith.maximumf %o, %zero : f64
    linalg.yield %m : f64
  } -> tensor<3x3xf64>
  return %r : tensor<3x3xf64>
}
func.func private @layer(%x: tensor<3x3xf64>, %w: tensor<3x3xf64>) -> tensor<3x3xf64> {
  %zero = arith.constant 0.0 : f64
  %e = tensor.empty() : tensor<3x3xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<3x3xf64>) -> tensor<3x3xf64>
  %p = linalg.matmul ins(%x, %w : tensor<3x3xf64>, tensor<3x3xf64>) outs(%z : tensor<3x3xf64>) -> tensor<3x3xf64>
  %r = func.call @relu(%p) : (tensor<3x3xf64>) -> tensor<3x3xf64>
  return %r : tensor<3x3xf64>
}
func.func @f(%x: tensor<3x3xf64>, %w: tensor<3x3xf64>, %v: tensor<3x3xf64>) -> tensor<3x3xf64> attributes {tai.differentiate} {
  %a = func.call @layer(%x, %w) : (tensor<3x3xf64>, tensor<3x3xf64>) -> tensor<3x3xf64>
  %b = func.call @layer(%a, %v) : (tensor<3x3xf64>, tensor<3x3xf64>) -> tensor<3x3xf64>
  return %b : tensor<3x3xf64>
}
