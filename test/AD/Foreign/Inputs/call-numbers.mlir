// Row: func | `func.call` of a function of numbers in a loop
func.func private @g(%a: f64, %b: f64) -> f64 {
  %0 = arith.mulf %a, %b : f64
  %1 = math.sin %0 : f64
  return %1 : f64
}
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = func.call @g(%a, %a) : (f64, f64) -> f64
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
