// Row: memref | `memref.transpose`
func.func @f(%x: memref<2x3xf64>, %y: memref<3x2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %t = memref.transpose %x (i, j) -> (j, i) : memref<2x3xf64> to memref<3x2xf64, strided<[1, 3]>>
  scf.for %i = %c0 to %c3 step %c1 {
    scf.for %j = %c0 to %c2 step %c1 {
      %a = memref.load %t[%i, %j] : memref<3x2xf64, strided<[1, 3]>>
      %b = arith.mulf %a, %a : f64
      memref.store %b, %y[%i, %j] : memref<3x2xf64>
    }
  }
  return
}
