// Row: tensor | tensors of a size known at run time, `tensor.dim`, slices
#id = affine_map<(i) -> (i)>
func.func @f(%x: tensor<?xf64>, %w: tensor<?xf64>) -> tensor<?xf64> attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = tensor.dim %x, %c0 : tensor<?xf64>
  %m = arith.subi %n, %c1 : index
  %a = tensor.extract_slice %x[1] [%m] [1] : tensor<?xf64> to tensor<?xf64>
  %b = tensor.extract_slice %w[0] [%m] [1] : tensor<?xf64> to tensor<?xf64>
  %r = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel"]} ins(%a : tensor<?xf64>) outs(%b : tensor<?xf64>) {
  ^bb0(%p: f64, %q: f64):
    %0 = arith.mulf %p, %q : f64
    %1 = math.exp %0 : f64
    linalg.yield %1 : f64
  } -> tensor<?xf64>
  %s = tensor.insert_slice %r into %x[0] [%m] [1] : tensor<?xf64> into tensor<?xf64>
  return %s : tensor<?xf64>
}
