// Row: tensor | `tensor.concat`, `expand_shape`, `reshape` by a shape, `cast`, `splat`
#id = affine_map<(i, j) -> (i, j)>
func.func @f(%x: tensor<4xf64>, %y: tensor<4xf64>) -> tensor<4x2xf64> attributes {tai.differentiate} {
  %h = arith.constant 0.5 : f64
  %shape = arith.constant dense<[4, 2]> : tensor<2xi32>
  %c = tensor.concat dim(0) %x, %y : (tensor<4xf64>, tensor<4xf64>) -> tensor<8xf64>
  %e = tensor.expand_shape %c [[0, 1]] output_shape [2, 4] : tensor<8xf64> into tensor<2x4xf64>
  %s = tensor.splat %h : tensor<2x4xf64>
  %p = linalg.generic {indexing_maps = [#id, #id, #id], iterator_types = ["parallel", "parallel"]} ins(%e, %s : tensor<2x4xf64>, tensor<2x4xf64>) outs(%s : tensor<2x4xf64>) {
  ^bb0(%a: f64, %b: f64, %o: f64):
    %0 = math.powf %b, %a : f64
    linalg.yield %0 : f64
  } -> tensor<2x4xf64>
  %r = tensor.reshape %p(%shape) : (tensor<2x4xf64>, tensor<2xi32>) -> tensor<4x2xf64>
  %k = tensor.cast %r : tensor<4x2xf64> to tensor<?x2xf64>
  %l = tensor.cast %k : tensor<?x2xf64> to tensor<4x2xf64>
  return %l : tensor<4x2xf64>
}
