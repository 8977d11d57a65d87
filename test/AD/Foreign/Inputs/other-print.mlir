// Row: func | a print, and a call of a function defined elsewhere
func.func private @printF64(f64)
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    func.call @printF64(%b) : (f64) -> ()
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
