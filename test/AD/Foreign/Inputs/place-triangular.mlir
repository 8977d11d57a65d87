// Row: in place | loops whose bounds depend on outer loops (Cholesky)
func.func @f(%x: memref<4x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %k = %c0 to %c4 step %c1 {
    %d = memref.load %x[%k, %k] : memref<4x4xf64>
    %d2 = arith.mulf %d, %d : f64
    %ten = arith.constant 10.0 : f64
    %d3 = arith.addf %d2, %ten : f64
    %r = math.sqrt %d3 : f64
    memref.store %r, %x[%k, %k] : memref<4x4xf64>
    %k1 = arith.addi %k, %c1 : index
    scf.for %i = %k1 to %c4 step %c1 {
      %a = memref.load %x[%i, %k] : memref<4x4xf64>
      %p = memref.load %x[%k, %k] : memref<4x4xf64>
      %q = arith.divf %a, %p : f64
      memref.store %q, %x[%i, %k] : memref<4x4xf64>
    }
    scf.for %i = %k1 to %c4 step %c1 {
      scf.for %j = %k1 to %c4 step %c1 {
        %a = memref.load %x[%i, %j] : memref<4x4xf64>
        %l = memref.load %x[%i, %k] : memref<4x4xf64>
        %m = memref.load %x[%j, %k] : memref<4x4xf64>
        %lm = arith.mulf %l, %m : f64
        %n = arith.subf %a, %lm : f64
        memref.store %n, %x[%i, %j] : memref<4x4xf64>
      }
    }
  }
  return
}
