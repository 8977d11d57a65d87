// Row: memref | `memref.alloc`, `memref.dealloc` of a temporary
func.func @f(%x: memref<5xf64>, %y: memref<5xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %t = memref.alloc() : memref<5xf64>
  scf.for %i = %c0 to %c5 step %c1 {
    %a = memref.load %x[%i] : memref<5xf64>
    %b = math.sin %a : f64
    memref.store %b, %t[%i] : memref<5xf64>
  }
  scf.for %i = %c0 to %c5 step %c1 {
    %a = memref.load %t[%i] : memref<5xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<5xf64>
  }
  memref.dealloc %t : memref<5xf64>
  return
}
