// Row: vector | `scan`, inclusive
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %a = vector.load %x[%c0] : memref<8xf64>, vector<4xf64>
  %i = vector.extract %a[0] : f64 from vector<4xf64>
  %m = vector.shape_cast %a : vector<4xf64> to vector<2x2xf64>
  %z = vector.broadcast %i : f64 to vector<2xf64>
  %s, %l = vector.scan <add>, %m, %z {inclusive = true, reduction_dim = 0} : vector<2x2xf64>, vector<2xf64>
  %q = arith.mulf %s, %m : vector<2x2xf64>
  %r = vector.shape_cast %q : vector<2x2xf64> to vector<4xf64>
  vector.store %r, %y[%c4] : memref<8xf64>, vector<4xf64>
  return
}
func.func @plain(%x: memref<8xf64>, %y: memref<8xf64>) {
  affine.for %i = 0 to 2 {
    %a = memref.load %x[%i] : memref<8xf64>
    %c2 = arith.constant 2 : index
    %c4 = arith.constant 4 : index
    %j = arith.addi %i, %c2 : index
    %k = arith.addi %i, %c4 : index
    %l = arith.addi %j, %c4 : index
    %b = memref.load %x[%j] : memref<8xf64>
    %p = arith.mulf %a, %a : f64
    %s = arith.addf %a, %b : f64
    %q = arith.mulf %s, %b : f64
    memref.store %p, %y[%k] : memref<8xf64>
    memref.store %q, %y[%l] : memref<8xf64>
  }
  return
}
