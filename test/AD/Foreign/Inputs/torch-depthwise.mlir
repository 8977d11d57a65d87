// Row: torch | `linalg.depthwise_conv_2d_nhwc_hwc`, dilated, then a global mean by `linalg.reduce`
func.func @f(%x: tensor<1x5x5x2xf64>, %w: tensor<2x2x2xf64>) -> tensor<1x2xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %e = tensor.empty() : tensor<1x3x3x2xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<1x3x3x2xf64>) -> tensor<1x3x3x2xf64>
  %c = linalg.depthwise_conv_2d_nhwc_hwc {dilations = dense<2> : vector<2xi64>, strides = dense<1> : vector<2xi64>} ins(%x, %w : tensor<1x5x5x2xf64>, tensor<2x2x2xf64>) outs(%z : tensor<1x3x3x2xf64>) -> tensor<1x3x3x2xf64>
  %e2 = tensor.empty() : tensor<1x2xf64>
  %z2 = linalg.fill ins(%zero : f64) outs(%e2 : tensor<1x2xf64>) -> tensor<1x2xf64>
  %r = linalg.reduce ins(%c : tensor<1x3x3x2xf64>) outs(%z2 : tensor<1x2xf64>) dimensions = [1, 2] (%a: f64, %b: f64) {
    %q = arith.mulf %a, %a : f64
    %s = arith.addf %q, %b : f64
    linalg.yield %s : f64
  }
  return %r : tensor<1x2xf64>
}
