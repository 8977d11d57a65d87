// Row: arith | `fastmath` flags
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %s = arith.mulf %a, %a fastmath<nnan,ninf> : f64
    %b = math.sqrt %s fastmath<nnan,ninf> : f64
    %c = arith.divf %b, %a fastmath<fast> : f64
    %d = arith.addf %b, %c fastmath<fast> : f64
    memref.store %d, %y[%i] : memref<4xf64>
  }
  return
}
