// Row: memref | `memref.subview`
func.func @f(%x: memref<6x4xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %s = memref.subview %x[1, 2] [2, 1] [2, 1] : memref<6x4xf64> to memref<2xf64, strided<[8], offset: 6>>
  scf.for %i = %c0 to %c2 step %c1 {
    %a = memref.load %s[%i] : memref<2xf64, strided<[8], offset: 6>>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<2xf64>
  }
  return
}
