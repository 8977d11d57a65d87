// Row: func | `func.call` of a function of memrefs
func.func private @square(%x: memref<4xf64>, %y: memref<4xf64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %t = memref.alloc() : memref<4xf64>
  func.call @square(%x, %t) : (memref<4xf64>, memref<4xf64>) -> ()
  func.call @square(%t, %y) : (memref<4xf64>, memref<4xf64>) -> ()
  memref.dealloc %t : memref<4xf64>
  return
}
