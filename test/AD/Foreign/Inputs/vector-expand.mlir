// Row: vector | `expandload`, `compressstore`, `maskedload`, `maskedstore`
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  %p = arith.constant dense<0.5> : vector<4xf64>
  %m = vector.create_mask %c3 : vector<4xi1>
  %a = vector.maskedload %x[%c0], %m, %p : memref<8xf64>, vector<4xi1>, vector<4xf64> into vector<4xf64>
  %b = arith.mulf %a, %a : vector<4xf64>
  vector.maskedstore %y[%c3], %m, %b : memref<8xf64>, vector<4xi1>, vector<4xf64>
  %e = vector.expandload %x[%c3], %m, %b : memref<8xf64>, vector<4xi1>, vector<4xf64> into vector<4xf64>
  %s = math.cos %e : vector<4xf64>
  vector.compressstore %y[%c0], %m, %s : memref<8xf64>, vector<4xi1>, vector<4xf64>
  return
}
