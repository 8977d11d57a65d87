// Row: memref | a function that returns an array that it allocates
func.func @f(%x: memref<4xf64>) -> memref<4xf64> attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %r = memref.alloc() : memref<4xf64>
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = math.exp %a : f64
    memref.store %b, %r[%i] : memref<4xf64>
  }
  return %r : memref<4xf64>
}
