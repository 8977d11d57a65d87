// Row: tensor | `tensor.extract`, `tensor.insert`, `tensor.from_elements`
func.func @f(%x: tensor<4xf64>) -> tensor<4xf64> attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %a = tensor.extract %x[%c0] : tensor<4xf64>
  %b = tensor.extract %x[%c1] : tensor<4xf64>
  %c = arith.mulf %a, %b : f64
  %y = tensor.insert %c into %x[%c2] : tensor<4xf64>
  %e = tensor.extract %y[%c2] : tensor<4xf64>
  %g = arith.mulf %e, %e : f64
  %z = tensor.from_elements %a, %g, %c, %e : tensor<4xf64>
  return %z : tensor<4xf64>
}
