// Row: tensor | several results: a number, a tensor, an integer tensor, and an argument itself
#id = affine_map<(i) -> (i)>
func.func @f(%x: tensor<4xf64>, %y: tensor<4xf64>) -> (f64, tensor<4xf64>, tensor<4xi32>, tensor<4xf64>) attributes {tai.differentiate} {
  %c2 = arith.constant 2 : index
  %e = tensor.empty() : tensor<4xf64>
  %ei = tensor.empty() : tensor<4xi32>
  %r:2 = linalg.generic {indexing_maps = [#id, #id, #id, #id], iterator_types = ["parallel"]} ins(%x, %y : tensor<4xf64>, tensor<4xf64>) outs(%e, %ei : tensor<4xf64>, tensor<4xi32>) {
  ^bb0(%a: f64, %b: f64, %o: f64, %oi: i32):
    %p = arith.cmpf ogt, %a, %b : f64
    %i = arith.extui %p : i1 to i32
    %q = arith.select %p, %a, %b : f64
    %s = math.exp %q : f64
    linalg.yield %s, %i : f64, i32
  } -> (tensor<4xf64>, tensor<4xi32>)
  %n = tensor.extract %r#0[%c2] : tensor<4xf64>
  return %n, %r#0, %r#1, %x : f64, tensor<4xf64>, tensor<4xi32>, tensor<4xf64>
}
