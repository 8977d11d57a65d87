// Row: memref | `memref.subview` at an offset that a loop computes, written in place
func.func @f(%x: memref<6x4xf64>, %y: memref<6xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c6 = arith.constant 6 : index
  scf.for %i = %c0 to %c6 step %c1 {
    %s = memref.subview %x[%i, 0] [1, 4] [1, 1] : memref<6x4xf64> to memref<4xf64, strided<[1], offset: ?>>
    %z = memref.load %s[%c0] : memref<4xf64, strided<[1], offset: ?>>
    %r = scf.for %j = %c1 to %c4 step %c1 iter_args(%p = %z) -> f64 {
      %a = memref.load %s[%j] : memref<4xf64, strided<[1], offset: ?>>
      %b = arith.mulf %a, %p : f64
      memref.store %b, %s[%j] : memref<4xf64, strided<[1], offset: ?>>
      scf.yield %b : f64
    }
    memref.store %r, %y[%i] : memref<6xf64>
  }
  return
}
