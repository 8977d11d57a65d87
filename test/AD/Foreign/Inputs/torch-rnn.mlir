// Row: torch | a recurrent net: `scf.for` carries a state and outputs, rows by `extract_slice` and `insert_slice`
#id = affine_map<(i, j) -> (i, j)>
func.func @f(%xs: tensor<4x1x3xf64>, %w: tensor<3x3xf64>, %h0: tensor<1x3xf64>) -> (tensor<4x1x3xf64>, tensor<1x3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %out = tensor.empty() : tensor<4x1x3xf64>
  %r:2 = scf.for %t = %c0 to %c4 step %c1 iter_args(%h = %h0, %ys = %out) -> (tensor<1x3xf64>, tensor<4x1x3xf64>) {
    %x = tensor.extract_slice %xs[%t, 0, 0] [1, 1, 3] [1, 1, 1] : tensor<4x1x3xf64> to tensor<1x3xf64>
    %m = linalg.matmul ins(%h, %w : tensor<1x3xf64>, tensor<3x3xf64>) outs(%x : tensor<1x3xf64>) -> tensor<1x3xf64>
    %e = tensor.empty() : tensor<1x3xf64>
    %n = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel", "parallel"]} ins(%m : tensor<1x3xf64>) outs(%e : tensor<1x3xf64>) {
    ^bb0(%in: f64, %o: f64):
      %v = math.tanh %in : f64
      linalg.yield %v : f64
    } -> tensor<1x3xf64>
    %ys2 = tensor.insert_slice %n into %ys[%t, 0, 0] [1, 1, 3] [1, 1, 1] : tensor<1x3xf64> into tensor<4x1x3xf64>
    scf.yield %n, %ys2 : tensor<1x3xf64>, tensor<4x1x3xf64>
  }
  return %r#1, %r#0 : tensor<4x1x3xf64>, tensor<1x3xf64>
}
