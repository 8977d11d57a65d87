// Row: torch | `linalg.conv_2d_nchw_fchw` of a `tensor.pad`, batch normalisation by given moments, a ramp
#id = affine_map<(n, c, h, w) -> (n, c, h, w)>
#ch = affine_map<(n, c, h, w) -> (c)>
func.func @f(%x: tensor<1x2x3x3xf64>, %w: tensor<2x2x3x3xf64>, %gamma: tensor<2xf64>, %beta: tensor<2xf64>, %mean: tensor<2xf64>, %var: tensor<2xf64>) -> tensor<1x2x3x3xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %eps = arith.constant 1.0e-5 : f64
  %p = tensor.pad %x low[0, 0, 1, 1] high[0, 0, 1, 1] {
  ^bb0(%a: index, %b: index, %c: index, %d: index):
    tensor.yield %zero : f64
  } : tensor<1x2x3x3xf64> to tensor<1x2x5x5xf64>
  %e = tensor.empty() : tensor<1x2x3x3xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<1x2x3x3xf64>) -> tensor<1x2x3x3xf64>
  %c = linalg.conv_2d_nchw_fchw {dilations = dense<1> : vector<2xi64>, strides = dense<1> : vector<2xi64>} ins(%p, %w : tensor<1x2x5x5xf64>, tensor<2x2x3x3xf64>) outs(%z : tensor<1x2x3x3xf64>) -> tensor<1x2x3x3xf64>
  %n = linalg.generic {indexing_maps = [#id, #ch, #ch, #ch, #ch, #id], iterator_types = ["parallel", "parallel", "parallel", "parallel"]} ins(%c, %gamma, %beta, %mean, %var : tensor<1x2x3x3xf64>, tensor<2xf64>, tensor<2xf64>, tensor<2xf64>, tensor<2xf64>) outs(%c : tensor<1x2x3x3xf64>) {
  ^bb0(%in: f64, %g: f64, %b: f64, %m: f64, %v: f64, %o: f64):
    %sq = arith.mulf %v, %v : f64
    %t0 = arith.addf %sq, %eps : f64
    %t1 = math.rsqrt %t0 : f64
    %t2 = arith.subf %in, %m : f64
    %t3 = arith.mulf %t2, %t1 : f64
    %t4 = arith.mulf %t3, %g : f64
    %t5 = arith.addf %t4, %b : f64
    linalg.yield %t5 : f64
  } -> tensor<1x2x3x3xf64>
  %r = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel", "parallel", "parallel", "parallel"]} ins(%n : tensor<1x2x3x3xf64>) outs(%e : tensor<1x2x3x3xf64>) {
  ^bb0(%in: f64, %o: f64):
    %q = arith.cmpf ugt, %in, %zero : f64
    %s = arith.select %q, %in, %zero : f64
    linalg.yield %s : f64
  } -> tensor<1x2x3x3xf64>
  return %r : tensor<1x2x3x3xf64>
}
