// Row: memref | `memref.view` of bytes
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %t = memref.alloc() : memref<32xi8>
  %v = memref.view %t[%c0][] : memref<32xi8> to memref<4xf64>
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %v[%i] : memref<4xf64>
    %c = memref.load %v[%i] : memref<4xf64>
    memref.store %c, %y[%i] : memref<4xf64>
  }
  return
}
