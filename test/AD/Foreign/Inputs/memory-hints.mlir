// Row: memref | `memref.prefetch`, `memref.assume_alignment`, `memref.load` non-temporal
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %xa = memref.assume_alignment %x, 8 : memref<4xf64>
  scf.for %i = %c0 to %c4 step %c1 {
    memref.prefetch %xa[%i], read, locality<3>, data : memref<4xf64>
    %a = memref.load %xa[%i] {nontemporal = true} : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
