// Row: torch | attention: `linalg.batch_matmul`, `linalg.transpose`, softmax with a causal mask by `linalg.index`
#id = affine_map<(b, i, j) -> (b, i, j)>
#row = affine_map<(b, i, j) -> (b, i)>
func.func @f(%q: tensor<2x3x4xf64>, %k: tensor<2x3x4xf64>, %v: tensor<2x3x4xf64>) -> tensor<2x3x4xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %low = arith.constant 0xFFF0000000000000 : f64
  %scale = arith.constant 0.5 : f64
  %et = tensor.empty() : tensor<2x4x3xf64>
  %kt = linalg.transpose ins(%k : tensor<2x3x4xf64>) outs(%et : tensor<2x4x3xf64>) permutation = [0, 2, 1]
  %es = tensor.empty() : tensor<2x3x3xf64>
  %zs = linalg.fill ins(%zero : f64) outs(%es : tensor<2x3x3xf64>) -> tensor<2x3x3xf64>
  %s = linalg.batch_matmul ins(%q, %kt : tensor<2x3x4xf64>, tensor<2x4x3xf64>) outs(%zs : tensor<2x3x3xf64>) -> tensor<2x3x3xf64>
  %m = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel", "parallel", "parallel"]} ins(%s : tensor<2x3x3xf64>) outs(%es : tensor<2x3x3xf64>) {
  ^bb0(%in: f64, %o: f64):
    %i = linalg.index 1 : index
    %j = linalg.index 2 : index
    %seen = arith.cmpi sle, %j, %i : index
    %t = arith.mulf %in, %scale : f64
    %u = arith.select %seen, %t, %low : f64
    linalg.yield %u : f64
  } -> tensor<2x3x3xf64>
  %er = tensor.empty() : tensor<2x3xf64>
  %lr = linalg.fill ins(%low : f64) outs(%er : tensor<2x3xf64>) -> tensor<2x3xf64>
  %top = linalg.generic {indexing_maps = [#id, #row], iterator_types = ["parallel", "parallel", "reduction"]} ins(%m : tensor<2x3x3xf64>) outs(%lr : tensor<2x3xf64>) {
  ^bb0(%in: f64, %o: f64):
    %t = arith.maximumf %in, %o : f64
    linalg.yield %t : f64
  } -> tensor<2x3xf64>
  %ex = linalg.generic {indexing_maps = [#id, #row, #id], iterator_types = ["parallel", "parallel", "parallel"]} ins(%m, %top : tensor<2x3x3xf64>, tensor<2x3xf64>) outs(%es : tensor<2x3x3xf64>) {
  ^bb0(%in: f64, %h: f64, %o: f64):
    %t = arith.subf %in, %h : f64
    %u = math.exp %t : f64
    linalg.yield %u : f64
  } -> tensor<2x3x3xf64>
  %zr = linalg.fill ins(%zero : f64) outs(%er : tensor<2x3xf64>) -> tensor<2x3xf64>
  %sum = linalg.generic {indexing_maps = [#id, #row], iterator_types = ["parallel", "parallel", "reduction"]} ins(%ex : tensor<2x3x3xf64>) outs(%zr : tensor<2x3xf64>) {
  ^bb0(%in: f64, %o: f64):
    %t = arith.addf %in, %o : f64
    linalg.yield %t : f64
  } -> tensor<2x3xf64>
  %p = linalg.generic {indexing_maps = [#id, #row, #id], iterator_types = ["parallel", "parallel", "parallel"]} ins(%ex, %sum : tensor<2x3x3xf64>, tensor<2x3xf64>) outs(%es : tensor<2x3x3xf64>) {
  ^bb0(%in: f64, %h: f64, %o: f64):
    %t = arith.divf %in, %h : f64
    linalg.yield %t : f64
  } -> tensor<2x3x3xf64>
  %eo = tensor.empty() : tensor<2x3x4xf64>
  %zo = linalg.fill ins(%zero : f64) outs(%eo : tensor<2x3x4xf64>) -> tensor<2x3x4xf64>
  %r = linalg.batch_matmul ins(%p, %v : tensor<2x3x3xf64>, tensor<2x3x4xf64>) outs(%zo : tensor<2x3x4xf64>) -> tensor<2x3x4xf64>
  return %r : tensor<2x3x4xf64>
}
