// Row: linalg | `linalg.softmax`
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (i)>
func.func @f(%x: tensor<3x4xf64>) -> tensor<3x4xf64> attributes {tai.differentiate} {
  %e = tensor.empty() : tensor<3x4xf64>
  %r = linalg.softmax dimension(1) ins(%x : tensor<3x4xf64>) outs(%e : tensor<3x4xf64>) -> tensor<3x4xf64>
  return %r : tensor<3x4xf64>
}

func.func @plain(%x: tensor<3x4xf64>) -> tensor<3x4xf64> {
  %low = arith.constant 0xFFF0000000000000 : f64
  %zero = arith.constant 0.0 : f64
  %e = tensor.empty() : tensor<3xf64>
  %e2 = tensor.empty() : tensor<3x4xf64>
  %m0 = linalg.fill ins(%low : f64) outs(%e : tensor<3xf64>) -> tensor<3xf64>
  %m = linalg.generic {indexing_maps = [#id, #row], iterator_types = ["parallel", "reduction"]} ins(%x : tensor<3x4xf64>) outs(%m0 : tensor<3xf64>) {
  ^bb0(%p: f64, %q: f64):
    %0 = arith.maximumf %p, %q : f64
    linalg.yield %0 : f64
  } -> tensor<3xf64>
  %ex = linalg.generic {indexing_maps = [#id, #row, #id], iterator_types = ["parallel", "parallel"]} ins(%x, %m : tensor<3x4xf64>, tensor<3xf64>) outs(%e2 : tensor<3x4xf64>) {
  ^bb0(%p: f64, %q: f64, %o: f64):
    %0 = arith.subf %p, %q : f64
    %1 = math.exp %0 : f64
    linalg.yield %1 : f64
  } -> tensor<3x4xf64>
  %s0 = linalg.fill ins(%zero : f64) outs(%e : tensor<3xf64>) -> tensor<3xf64>
  %s = linalg.reduce ins(%ex : tensor<3x4xf64>) outs(%s0 : tensor<3xf64>) dimensions = [1] (%p: f64, %q: f64) {
    %0 = arith.addf %p, %q : f64
    linalg.yield %0 : f64
  }
  %r = linalg.generic {indexing_maps = [#id, #row, #id], iterator_types = ["parallel", "parallel"]} ins(%ex, %s : tensor<3x4xf64>, tensor<3xf64>) outs(%e2 : tensor<3x4xf64>) {
  ^bb0(%p: f64, %q: f64, %o: f64):
    %0 = arith.divf %p, %q : f64
    linalg.yield %0 : f64
  } -> tensor<3x4xf64>
  return %r : tensor<3x4xf64>
}
