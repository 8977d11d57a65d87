// Row: gpu | `gpu.launch` with blocks of a size that is not known, in place
func.func @f(%x: memref<?xf64>, %y: memref<?xf64>, %n: index, %m: index) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  gpu.launch blocks(%bx, %by, %bz) in (%gx = %m, %gy = %c1, %gz = %c1)
             threads(%tx, %ty, %tz) in (%sx = %n, %sy = %c1, %sz = %c1) {
    %o = arith.muli %bx, %sx : index
    %i0 = arith.addi %o, %tx : index
    %c5 = arith.constant 5 : index
    %in = arith.cmpi slt, %i0, %c5 : index
    scf.if %in {
    %i = arith.addi %o, %tx : index
    %a = memref.load %x[%i] : memref<?xf64>
    %b = math.sin %a : f64
    %c = arith.mulf %a, %b : f64
    memref.store %c, %x[%i] : memref<?xf64>
    }
    gpu.terminator
  }
  return
}
func.func @plain(%x: memref<?xf64>, %y: memref<?xf64>, %n: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  scf.for %i = %c0 to %c5 step %c1 {
    %a = memref.load %x[%i] : memref<?xf64>
    %b = math.sin %a : f64
    %c = arith.mulf %a, %b : f64
    memref.store %c, %x[%i] : memref<?xf64>
  }
  return
}
