// Row: tensor | a function of tensors: `tensor.empty`, `linalg.fill`, `linalg.matmul`
func.func @f(%a: tensor<3x4xf64>, %b: tensor<4x2xf64>) -> tensor<3x2xf64> attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f64
  %e = tensor.empty() : tensor<3x2xf64>
  %c = linalg.fill ins(%zero : f64) outs(%e : tensor<3x2xf64>) -> tensor<3x2xf64>
  %d = linalg.matmul ins(%a, %b : tensor<3x4xf64>, tensor<4x2xf64>) outs(%c : tensor<3x2xf64>) -> tensor<3x2xf64>
  return %d : tensor<3x2xf64>
}
