// Row: torch | layer normalisation with weights, then `math.erf` (GELU)
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (i)>
#col = affine_map<(i, j) -> (j)>
func.func @f(%x: tensor<3x4xf64>, %g: tensor<4xf64>, %b: tensor<4xf64>) -> tensor<3x4xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %quarter = arith.constant 0.25 : f64
  %eps = arith.constant 1.0e-5 : f64
  %half = arith.constant 0.5 : f64
  %one = arith.constant 1.0 : f64
  %root = arith.constant 0.70710678118654757 : f64
  %e = tensor.empty() : tensor<3xf64>
  %z = linalg.fill ins(%zero : f64) outs(%e : tensor<3xf64>) -> tensor<3xf64>
  %m = linalg.generic {indexing_maps = [#id, #row], iterator_types = ["parallel", "reduction"]} ins(%x : tensor<3x4xf64>) outs(%z : tensor<3xf64>) {
  ^bb0(%in: f64, %o: f64):
    %s = arith.mulf %in, %quarter : f64
    %t = arith.addf %s, %o : f64
    linalg.yield %t : f64
  } -> tensor<3xf64>
  %v = linalg.generic {indexing_maps = [#id, #row, #row], iterator_types = ["parallel", "reduction"]} ins(%x, %m : tensor<3x4xf64>, tensor<3xf64>) outs(%z : tensor<3xf64>) {
  ^bb0(%in: f64, %mm: f64, %o: f64):
    %d = arith.subf %in, %mm : f64
    %q = arith.mulf %d, %d : f64
    %s = arith.mulf %q, %quarter : f64
    %t = arith.addf %s, %o : f64
    linalg.yield %t : f64
  } -> tensor<3xf64>
  %e2 = tensor.empty() : tensor<3x4xf64>
  %r = linalg.generic {indexing_maps = [#id, #row, #row, #col, #col, #id], iterator_types = ["parallel", "parallel"]} ins(%x, %m, %v, %g, %b : tensor<3x4xf64>, tensor<3xf64>, tensor<3xf64>, tensor<4xf64>, tensor<4xf64>) outs(%e2 : tensor<3x4xf64>) {
  ^bb0(%in: f64, %mm: f64, %vv: f64, %gg: f64, %bb: f64, %o: f64):
    %d = arith.subf %in, %mm : f64
    %ve = arith.addf %vv, %eps : f64
    %i = math.rsqrt %ve : f64
    %t = arith.mulf %d, %i : f64
    %u = math.fma %t, %gg, %bb : f64
    %w = arith.mulf %u, %root : f64
    %er = math.erf %w : f64
    %p = arith.addf %er, %one : f64
    %h = arith.mulf %u, %half : f64
    %y = arith.mulf %h, %p : f64
    linalg.yield %y : f64
  } -> tensor<3x4xf64>
  return %r : tensor<3x4xf64>
}
