// Row: memref | `memref.collapse_shape`
func.func @f(%x: memref<2x3xf64>, %y: memref<6xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c6 = arith.constant 6 : index
  %e = memref.collapse_shape %x [[0, 1]] : memref<2x3xf64> into memref<6xf64>
  scf.for %i = %c0 to %c6 step %c1 {
    %a = memref.load %e[%i] : memref<6xf64>
    %b = math.exp %a : f64
    memref.store %b, %y[%i] : memref<6xf64>
  }
  return
}
