// Row: linalg | `linalg.conv_2d_nhwc_hwcf`, `linalg.pooling_nhwc_max` on tensors
func.func @f(%x: tensor<1x4x4x1xf64>, %w: tensor<2x2x1x2xf64>) -> tensor<1x2x2x2xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %low = arith.constant 0xFFF0000000000000 : f64
  %e = tensor.empty() : tensor<1x3x3x2xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<1x3x3x2xf64>) -> tensor<1x3x3x2xf64>
  %c = linalg.conv_2d_nhwc_hwcf {dilations = dense<1> : vector<2xi64>, strides = dense<1> : vector<2xi64>} ins(%x, %w : tensor<1x4x4x1xf64>, tensor<2x2x1x2xf64>) outs(%z : tensor<1x3x3x2xf64>) -> tensor<1x3x3x2xf64>
  %k = tensor.empty() : tensor<2x2xf64>
  %e2 = tensor.empty() : tensor<1x2x2x2xf64>
  %m = linalg.fill ins(%low : f64) outs(%e2 : tensor<1x2x2x2xf64>) -> tensor<1x2x2x2xf64>
  %r = linalg.pooling_nhwc_max {dilations = dense<1> : vector<2xi64>, strides = dense<1> : vector<2xi64>} ins(%c, %k : tensor<1x3x3x2xf64>, tensor<2x2xf64>) outs(%m : tensor<1x2x2x2xf64>) -> tensor<1x2x2x2xf64>
  return %r : tensor<1x2x2x2xf64>
}
