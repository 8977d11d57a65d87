// Row: gpu | `gpu.launch` without barriers and shared memory
func.func @f(%x: memref<12xf64>, %y: memref<12xf64>) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  gpu.launch blocks(%bx, %by, %bz) in (%gx = %c3, %gy = %c1, %gz = %c1)
             threads(%tx, %ty, %tz) in (%sx = %c4, %sy = %c1, %sz = %c1) {
    %o = arith.muli %bx, %sx : index
    %i = arith.addi %o, %tx : index
    %a = memref.load %x[%i] : memref<12xf64>
    %b = math.sin %a : f64
    %c = arith.mulf %a, %b : f64
    memref.store %c, %y[%i] : memref<12xf64>
    gpu.terminator
  }
  return
}
func.func @plain(%x: memref<12xf64>, %y: memref<12xf64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c12 = arith.constant 12 : index
  scf.for %i = %c0 to %c12 step %c1 {
    %a = memref.load %x[%i] : memref<12xf64>
    %b = math.sin %a : f64
    %c = arith.mulf %a, %b : f64
    memref.store %c, %y[%i] : memref<12xf64>
  }
  return
}
