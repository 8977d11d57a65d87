// Row: memref | `memref.alloca` as an accumulator
func.func @f(%x: memref<5xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %one = arith.constant 1.0 : f64
  %t = memref.alloca() : memref<f64>
  memref.store %one, %t[] : memref<f64>
  scf.for %i = %c0 to %c5 step %c1 {
    %a = memref.load %x[%i] : memref<5xf64>
    %s = memref.load %t[] : memref<f64>
    %b = arith.mulf %a, %s : f64
    memref.store %b, %t[] : memref<f64>
  }
  %r = memref.load %t[] : memref<f64>
  memref.store %r, %y[] : memref<f64>
  return
}
