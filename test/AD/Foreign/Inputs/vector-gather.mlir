// Row: vector | `vector.gather`, `vector.scatter`, `vector.maskedload`
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %i = arith.constant dense<[5, 0, 3, 5]> : vector<4xi32>
  %o = arith.constant dense<[1, 0, 3, 2]> : vector<4xi32>
  %m = arith.constant dense<[true, true, false, true]> : vector<4xi1>
  %p = arith.constant dense<2.0> : vector<4xf64>
  %a = vector.gather %x[%c0][%i], %m, %p : memref<8xf64>, vector<4xi32>, vector<4xi1>, vector<4xf64> into vector<4xf64>
  %b = vector.maskedload %x[%c4], %m, %p : memref<8xf64>, vector<4xi1>, vector<4xf64> into vector<4xf64>
  %c = arith.mulf %a, %b : vector<4xf64>
  vector.scatter %y[%c0][%o], %m, %c : memref<8xf64>, vector<4xi32>, vector<4xi1>, vector<4xf64>
  return
}
