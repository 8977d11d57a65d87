// Row: scf | `scf.forall`
func.func @f(%x: memref<4x3xf64>, %y: memref<4x3xf64>) attributes {tai.differentiate} {
  scf.forall (%i, %j) in (4, 3) {
    %a = memref.load %x[%i, %j] : memref<4x3xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i, %j] : memref<4x3xf64>
  }
  return
}
