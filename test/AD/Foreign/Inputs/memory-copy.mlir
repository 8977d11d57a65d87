// Row: memref | `memref.copy`
func.func @f(%x: memref<2x3xf64>, %y: memref<2x3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %t = memref.alloc() : memref<2x3xf64>
  memref.copy %x, %t : memref<2x3xf64> to memref<2x3xf64>
  scf.for %i = %c0 to %c2 step %c1 {
    scf.for %j = %c0 to %c3 step %c1 {
      %a = memref.load %t[%i, %j] : memref<2x3xf64>
      %b = arith.mulf %a, %a : f64
      memref.store %b, %t[%i, %j] : memref<2x3xf64>
    }
  }
  memref.copy %t, %y : memref<2x3xf64> to memref<2x3xf64>
  memref.dealloc %t : memref<2x3xf64>
  return
}
