// Row: vector | `scan`, exclusive
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %a = vector.load %x[%c0] : memref<8xf64>, vector<4xf64>
  %i = vector.load %x[%c4] : memref<8xf64>, vector<1xf64>
  %m = vector.shape_cast %a : vector<4xf64> to vector<1x4xf64>
  %s, %l = vector.scan <mul>, %m, %i {inclusive = false, reduction_dim = 1} : vector<1x4xf64>, vector<1xf64>
  %r = vector.shape_cast %s : vector<1x4xf64> to vector<4xf64>
  vector.store %r, %y[%c4] : memref<8xf64>, vector<4xf64>
  vector.store %l, %y[%c0] : memref<8xf64>, vector<1xf64>
  return
}
func.func @plain(%x: memref<8xf64>, %y: memref<8xf64>) {
  %c4 = arith.constant 4 : index
  %c3 = arith.constant 3 : index
  %c0 = arith.constant 0 : index
  %first = memref.load %x[%c4] : memref<8xf64>
  affine.for %i = 0 to 4 iter_args(%p = %first) -> f64 {
    %k = arith.addi %i, %c4 : index
    memref.store %p, %y[%k] : memref<8xf64>
    %u = memref.load %x[%i] : memref<8xf64>
    %n = arith.mulf %p, %u : f64
    affine.yield %n : f64
  }
  %c7 = arith.constant 7 : index
  %e = memref.load %y[%c7] : memref<8xf64>
  memref.store %e, %y[%c0] : memref<8xf64>
  return
}
