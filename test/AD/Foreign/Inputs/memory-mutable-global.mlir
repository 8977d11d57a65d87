// Row: memref | a private mutable `memref.global` as scratch memory
memref.global "private" @scratch : memref<4xf64>
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %t = memref.get_global @scratch : memref<4xf64>
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %t[%i] : memref<4xf64>
  }
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %t[%i] : memref<4xf64>
    memref.store %a, %y[%i] : memref<4xf64>
  }
  return
}
