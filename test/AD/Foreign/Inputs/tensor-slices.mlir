// Row: tensor | `tensor.extract_slice`, `insert_slice`, `pad`, `collapse_shape`
func.func @f(%x: tensor<3x4xf64>) -> tensor<3x4xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %s = tensor.extract_slice %x[0, 1] [2, 2] [1, 1] : tensor<3x4xf64> to tensor<2x2xf64>
  %e = tensor.empty() : tensor<2x2xf64>
  %m = linalg.map { math.exp } ins(%s : tensor<2x2xf64>) outs(%e : tensor<2x2xf64>)
  %y = tensor.insert_slice %m into %x[1, 0] [2, 2] [1, 1] : tensor<2x2xf64> into tensor<3x4xf64>
  %p = tensor.pad %s low[1, 0] high[0, 2] {
  ^bb0(%i: index, %j: index):
    tensor.yield %zero : f64
  } : tensor<2x2xf64> to tensor<3x4xf64>
  %z = linalg.add ins(%y, %p : tensor<3x4xf64>, tensor<3x4xf64>) outs(%x : tensor<3x4xf64>) -> tensor<3x4xf64>
  return %z : tensor<3x4xf64>
}
