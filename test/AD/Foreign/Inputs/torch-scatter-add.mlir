// Row: torch | rows added to those named by an index tensor: `scf.for` over a tensor, `extract`, `insert`
func.func @f(%x: tensor<4xf64>, %bins: tensor<3xf64>, %which: tensor<4xi32>) -> tensor<3xf64> attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %r = scf.for %i = %c0 to %c4 step %c1 iter_args(%t = %bins) -> tensor<3xf64> {
    %w = tensor.extract %which[%i] : tensor<4xi32>
    %wi = arith.index_cast %w : i32 to index
    %s = arith.addi %wi, %i : index
    %k = arith.remui %s, %c3 : index
    %a = tensor.extract %x[%i] : tensor<4xf64>
    %o = tensor.extract %t[%k] : tensor<3xf64>
    %m = math.sin %o : f64
    %q = arith.mulf %m, %a : f64
    %n = arith.addf %o, %q : f64
    %u = tensor.insert %n into %t[%k] : tensor<3xf64>
    scf.yield %u : tensor<3xf64>
  }
  return %r : tensor<3xf64>
}
