// Row: scf | `scf.parallel` of two dimensions with a local array and a serial loop inside
func.func @f(%x: memref<3x4xf64>, %y: memref<3x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i, %j) = (%c0, %c0) to (%c3, %c4) step (%c1, %c1) {
    %t = memref.alloca() : memref<3xf64>
    %a = memref.load %x[%i, %j] : memref<3x4xf64>
    memref.store %a, %t[%c0] : memref<3xf64>
    scf.for %k = %c1 to %c3 step %c1 {
      %m = arith.subi %k, %c1 : index
      %b = memref.load %t[%m] : memref<3xf64>
      %c = math.cos %b : f64
      %d = arith.mulf %c, %a : f64
      memref.store %d, %t[%k] : memref<3xf64>
    }
    %c2 = arith.constant 2 : index
    %e = memref.load %t[%c2] : memref<3xf64>
    memref.store %e, %y[%i, %j] : memref<3x4xf64>
    scf.reduce
  }
  return
}
