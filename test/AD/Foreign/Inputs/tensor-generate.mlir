// Row: tensor | `tensor.generate`, tensors carried by `scf.for`
func.func @f(%x: tensor<4xf64>) -> tensor<4xf64> attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %g = tensor.generate {
  ^bb0(%i: index):
    %a = tensor.extract %x[%i] : tensor<4xf64>
    %b = math.sin %a : f64
    tensor.yield %b : f64
  } : tensor<4xf64>
  %r = scf.for %i = %c1 to %c4 step %c1 iter_args(%t = %g) -> tensor<4xf64> {
    %j = arith.subi %i, %c1 : index
    %a = tensor.extract %t[%j] : tensor<4xf64>
    %b = tensor.extract %t[%i] : tensor<4xf64>
    %c = arith.mulf %a, %b : f64
    %u = tensor.insert %c into %t[%i] : tensor<4xf64>
    scf.yield %u : tensor<4xf64>
  }
  return %r : tensor<4xf64>
}
