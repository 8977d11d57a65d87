// Row: memref | `memref.cast`
func.func @f(%x: memref<5xf64>, %y: memref<5xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %d = memref.cast %x : memref<5xf64> to memref<?xf64>
  %n = memref.dim %d, %c0 : memref<?xf64>
  scf.for %i = %c0 to %n step %c1 {
    %a = memref.load %d[%i] : memref<?xf64>
    %b = math.tanh %a : f64
    memref.store %b, %y[%i] : memref<5xf64>
  }
  return
}
