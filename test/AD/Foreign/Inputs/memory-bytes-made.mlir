// Row: memref | `memref.view` of bytes that the function allocates, two arrays in them
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c64 = arith.constant 64 : index
  %b = memref.alloc() {alignment = 64 : i64} : memref<96xi8>
  %u = memref.view %b[%c0][] : memref<96xi8> to memref<4xf64>
  %v = memref.view %b[%c64][] : memref<96xi8> to memref<4xf64>
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %s = math.sin %a : f64
    memref.store %s, %u[%i] : memref<4xf64>
    %q = arith.mulf %a, %s : f64
    memref.store %q, %v[%i] : memref<4xf64>
  }
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %u[%i] : memref<4xf64>
    %s = memref.load %v[%i] : memref<4xf64>
    %q = arith.mulf %a, %s : f64
    memref.store %q, %y[%i] : memref<4xf64>
  }
  memref.dealloc %b : memref<96xi8>
  return
}
