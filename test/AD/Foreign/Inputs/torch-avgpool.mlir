// Row: torch | `linalg.pooling_nhwc_sum` of strides, a mean; `linalg.pooling_nchw_max` in rows
#id = affine_map<(a, b, c, d) -> (a, b, c, d)>
func.func @f(%x: tensor<1x4x4x2xf64>, %y: tensor<1x2x4x4xf64>) -> (tensor<1x2x2x2xf64>, tensor<1x2x3x3xf64>) attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %low = arith.constant 0xFFF0000000000000 : f64
  %quarter = arith.constant 0.25 : f64
  %k = tensor.empty() : tensor<2x2xf64>
  %e = tensor.empty() : tensor<1x2x2x2xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<1x2x2x2xf64>) -> tensor<1x2x2x2xf64>
  %s = linalg.pooling_nhwc_sum {dilations = dense<1> : vector<2xi64>, strides = dense<2> : vector<2xi64>} ins(%x, %k : tensor<1x4x4x2xf64>, tensor<2x2xf64>) outs(%z : tensor<1x2x2x2xf64>) -> tensor<1x2x2x2xf64>
  %m = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel", "parallel", "parallel", "parallel"]} ins(%s : tensor<1x2x2x2xf64>) outs(%e : tensor<1x2x2x2xf64>) {
  ^bb0(%in: f64, %o: f64):
    %t = arith.mulf %in, %quarter : f64
    linalg.yield %t : f64
  } -> tensor<1x2x2x2xf64>
  %e2 = tensor.empty() : tensor<1x2x3x3xf64>
  %l = linalg.fill ins(%low : f64) outs(%e2 : tensor<1x2x3x3xf64>) -> tensor<1x2x3x3xf64>
  %p = linalg.pooling_nchw_max {dilations = dense<1> : vector<2xi64>, strides = dense<1> : vector<2xi64>} ins(%y, %k : tensor<1x2x4x4xf64>, tensor<2x2xf64>) outs(%l : tensor<1x2x3x3xf64>) -> tensor<1x2x3x3xf64>
  return %m, %p : tensor<1x2x2x2xf64>, tensor<1x2x3x3xf64>
}
