// Row: scf | a memref chosen by `scf.if` and by `arith.select`
func.func @f(%x: memref<3xf64>, %z: memref<3xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  scf.for %i = %c0 to %c3 step %c1 {
    %c = arith.cmpi eq, %i, %c1 : index
    %m = arith.select %c, %x, %z : memref<3xf64>
    %d = arith.cmpi eq, %i, %c2 : index
    %n = scf.if %d -> memref<3xf64> {
      scf.yield %x : memref<3xf64>
    } else {
      scf.yield %m : memref<3xf64>
    }
    %a = memref.load %n[%i] : memref<3xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<3xf64>
  }
  return
}
