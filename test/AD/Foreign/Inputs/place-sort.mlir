// Row: in place | one pass of a bubble sort: data-dependent swaps in place
func.func @f(%x: memref<5xf64>, %y: memref<5xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %k = %c0 to %c4 step %c1 {
    scf.for %i = %c0 to %c4 step %c1 {
      %j = arith.addi %i, %c1 : index
      %a = memref.load %x[%i] : memref<5xf64>
      %b = memref.load %x[%j] : memref<5xf64>
      %p = arith.cmpf ogt, %a, %b : f64
      scf.if %p {
        memref.store %b, %x[%i] : memref<5xf64>
        memref.store %a, %x[%j] : memref<5xf64>
      }
    }
  }
  %c5 = arith.constant 5 : index
  scf.for %i = %c0 to %c5 step %c1 {
    %a = memref.load %x[%i] : memref<5xf64>
    %b = memref.load %y[%i] : memref<5xf64>
    %m = arith.mulf %a, %b : f64
    memref.store %m, %y[%i] : memref<5xf64>
  }
  return
}
