// Row: memref | `memref.reinterpret_cast`
func.func @f(%x: memref<12xf64>, %y: memref<2x2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %e = memref.reinterpret_cast %x to offset: [3], sizes: [2, 2], strides: [4, 1] : memref<12xf64> to memref<2x2xf64, strided<[4, 1], offset: 3>>
  scf.for %i = %c0 to %c2 step %c1 {
    scf.for %j = %c0 to %c2 step %c1 {
      %a = memref.load %e[%i, %j] : memref<2x2xf64, strided<[4, 1], offset: 3>>
      %b = arith.mulf %a, %a : f64
      memref.store %b, %y[%i, %j] : memref<2x2xf64>
    }
  }
  return
}
