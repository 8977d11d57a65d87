// Row: complex | a tensor of complex numbers inside: `linalg.generic` over `tensor<complex<f64>>`
#id = affine_map<(i) -> (i)>
func.func @f(%x: tensor<4xf64>, %y: tensor<4xf64>) -> tensor<4xf64> attributes {tai.differentiate} {
  %e = tensor.empty() : tensor<4xcomplex<f64>>
  %c = linalg.generic {indexing_maps = [#id, #id, #id], iterator_types = ["parallel"]} ins(%x, %y : tensor<4xf64>, tensor<4xf64>) outs(%e : tensor<4xcomplex<f64>>) {
  ^bb0(%a: f64, %b: f64, %o: complex<f64>):
    %0 = complex.create %a, %b : complex<f64>
    %1 = complex.mul %0, %0 : complex<f64>
    linalg.yield %1 : complex<f64>
  } -> tensor<4xcomplex<f64>>
  %e2 = tensor.empty() : tensor<4xf64>
  %r = linalg.generic {indexing_maps = [#id, #id], iterator_types = ["parallel"]} ins(%c : tensor<4xcomplex<f64>>) outs(%e2 : tensor<4xf64>) {
  ^bb0(%a: complex<f64>, %o: f64):
    %0 = complex.abs %a : complex<f64>
    linalg.yield %0 : f64
  } -> tensor<4xf64>
  return %r : tensor<4xf64>
}
