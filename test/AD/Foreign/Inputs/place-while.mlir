// Row: in place | an array overwritten in `scf.while`
func.func @f(%x: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %limit = arith.constant 3.0 : f64
  %k = arith.constant 1.3 : f64
  scf.for %i = %c0 to %c4 step %c1 {
    scf.while : () -> () {
      %a = memref.load %x[%i] : memref<4xf64>
      %b = math.absf %a : f64
      %c = arith.cmpf olt, %b, %limit : f64
      scf.condition(%c)
    } do {
      %a = memref.load %x[%i] : memref<4xf64>
      %b = arith.mulf %a, %a : f64
      %c = arith.addf %b, %k : f64
      memref.store %c, %x[%i] : memref<4xf64>
      scf.yield
    }
  }
  return
}
