// Row: scf | `scf.execute_region`
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = scf.execute_region -> f64 {
      %c = arith.cmpf ogt, %a, %zero : f64
      cf.cond_br %c, ^bb1, ^bb2
    ^bb1:
      %0 = arith.mulf %a, %a : f64
      scf.yield %0 : f64
    ^bb2:
      %1 = math.sin %a : f64
      scf.yield %1 : f64
    }
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
