// Row: scf | a fixed point: `scf.while` carries a tensor and its residual
#id = affine_map<(i) -> (i)>
#none = affine_map<(i) -> ()>
func.func @f(%b: tensor<3xf64>) -> tensor<3xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  %small = arith.constant 1.0e-13 : f64
  %half = arith.constant 0.4 : f64
  %r:2 = scf.while (%x = %b, %e = %one) : (tensor<3xf64>, f64) -> (tensor<3xf64>, f64) {
    %go = arith.cmpf ogt, %e, %small : f64
    scf.condition(%go) %x, %e : tensor<3xf64>, f64
  } do {
  ^bb0(%x: tensor<3xf64>, %e: f64):
    %t = tensor.empty() : tensor<3xf64>
    %n = linalg.generic {indexing_maps = [#id, #id, #id], iterator_types = ["parallel"]} ins(%x, %b : tensor<3xf64>, tensor<3xf64>) outs(%t : tensor<3xf64>) {
    ^bb0(%p: f64, %q: f64, %o: f64):
      %0 = math.cos %p : f64
      %1 = arith.mulf %0, %half : f64
      %2 = arith.addf %1, %q : f64
      linalg.yield %2 : f64
    } -> tensor<3xf64>
    %t0 = tensor.empty() : tensor<f64>
    %z0 = linalg.fill ins(%zero : f64) outs(%t0 : tensor<f64>) -> tensor<f64>
    %d = linalg.generic {indexing_maps = [#id, #id, #none], iterator_types = ["reduction"]} ins(%x, %n : tensor<3xf64>, tensor<3xf64>) outs(%z0 : tensor<f64>) {
    ^bb0(%p: f64, %q: f64, %o: f64):
      %0 = arith.subf %p, %q : f64
      %1 = math.absf %0 : f64
      %2 = arith.maximumf %1, %o : f64
      linalg.yield %2 : f64
    } -> tensor<f64>
    %v = tensor.extract %d[] : tensor<f64>
    scf.yield %n, %v : tensor<3xf64>, f64
  }
  return %r#0 : tensor<3xf64>
}
