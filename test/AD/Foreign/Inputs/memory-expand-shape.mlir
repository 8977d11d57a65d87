// Row: memref | `memref.expand_shape`
func.func @f(%x: memref<6xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant 1.0 : f64
  %e = memref.expand_shape %x [[0, 1]] output_shape [2, 3] : memref<6xf64> into memref<2x3xf64>
  scf.for %i = %c0 to %c2 step %c1 {
    %r = scf.for %j = %c0 to %c3 step %c1 iter_args(%p = %one) -> f64 {
      %a = memref.load %e[%i, %j] : memref<2x3xf64>
      %b = arith.mulf %a, %p : f64
      scf.yield %b : f64
    }
    memref.store %r, %y[%i] : memref<2xf64>
  }
  return
}
