// Row: torch | rows of a table by an index tensor: `tensor.extract` in `linalg.generic`
#id = affine_map<(i, j) -> (i, j)>
#row = affine_map<(i, j) -> (i)>
func.func @f(%table: tensor<5x3xf32>, %which: tensor<4xi64>) -> tensor<4x3xf32> attributes {tai.differentiate} {
  %e = tensor.empty() : tensor<4x3xf32>
  %r = linalg.generic {indexing_maps = [#row, #id], iterator_types = ["parallel", "parallel"]} ins(%which : tensor<4xi64>) outs(%e : tensor<4x3xf32>) {
  ^bb0(%w: i64, %o: f32):
    %i = linalg.index 0 : index
    %j = linalg.index 1 : index
    %wi = arith.index_cast %w : i64 to index
    %k = arith.subi %wi, %i : index
    %a = tensor.extract %table[%k, %j] : tensor<5x3xf32>
    %b = tensor.extract %table[%i, %j] : tensor<5x3xf32>
    %c = arith.mulf %a, %b : f32
    linalg.yield %c : f32
  } -> tensor<4x3xf32>
  return %r : tensor<4x3xf32>
}
