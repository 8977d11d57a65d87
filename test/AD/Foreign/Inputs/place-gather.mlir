// Row: scf | a prefix product by indices loaded from an integer array
func.func @f(%x: memref<4xf64>, %p: memref<4xi32>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f64
  %r = scf.for %i = %c0 to %c4 step %c1 iter_args(%acc = %one) -> f64 {
    %q = memref.load %p[%i] : memref<4xi32>
    %qi = arith.index_cast %q : i32 to index
    %m = arith.remui %qi, %c4 : index
    %a = memref.load %x[%m] : memref<4xf64>
    %n = arith.mulf %acc, %a : f64
    %old = memref.load %y[%i] : memref<4xf64>
    %s = arith.addf %n, %old : f64
    memref.store %s, %y[%i] : memref<4xf64>
    scf.yield %n : f64
  }
  return
}
