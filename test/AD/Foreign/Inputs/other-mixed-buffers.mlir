// Row: bufferization | `to_tensor` of an argument, tensors inside, `materialize_in_destination` into another
#id = affine_map<(i) -> (i)>
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %t = bufferization.to_tensor %x restrict : memref<4xf64> to tensor<4xf64>
  %e = tensor.empty() : tensor<4xf64>
  %r = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel"]} ins(%t : tensor<4xf64>) outs(%e : tensor<4xf64>) {
  ^bb0(%q: f64, %o: f64):
    %0 = math.sin %q : f64
    %1 = arith.mulf %0, %q : f64
    linalg.yield %1 : f64
  } -> tensor<4xf64>
  bufferization.materialize_in_destination %r in restrict writable %y : (tensor<4xf64>, memref<4xf64>) -> ()
  return
}
