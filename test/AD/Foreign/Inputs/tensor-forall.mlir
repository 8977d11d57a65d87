// Row: tensor | `scf.forall` with `tensor.parallel_insert_slice`
func.func @f(%x: tensor<8xf64>) -> tensor<8xf64> attributes {tai.differentiate} {
  %e = tensor.empty() : tensor<8xf64>
  %r = scf.forall (%i) = (0) to (8) step (2) shared_outs(%o = %e) -> tensor<8xf64> {
    %s = tensor.extract_slice %x[%i] [2] [1] : tensor<8xf64> to tensor<2xf64>
    %d = tensor.empty() : tensor<2xf64>
    %m = linalg.exp ins(%s : tensor<2xf64>) outs(%d : tensor<2xf64>) -> tensor<2xf64>
    scf.forall.in_parallel {
      tensor.parallel_insert_slice %m into %o[%i] [2] [1] : tensor<2xf64> into tensor<8xf64>
    }
  }
  return %r : tensor<8xf64>
}
