// Row: vector | `vector.interleave`, `vector.deinterleave`
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %a = vector.load %x[%c0] : memref<8xf64>, vector<4xf64>
  %b = vector.load %x[%c4] : memref<8xf64>, vector<4xf64>
  %s = math.sin %a : vector<4xf64>
  %v = vector.interleave %s, %b : vector<4xf64> -> vector<8xf64>
  %w = arith.mulf %v, %v : vector<8xf64>
  %even, %odd = vector.deinterleave %w : vector<8xf64> -> vector<4xf64>
  %p = arith.mulf %even, %odd : vector<4xf64>
  vector.store %w, %y[%c0] : memref<8xf64>, vector<8xf64>
  vector.store %p, %y[%c0] : memref<8xf64>, vector<4xf64>
  return
}
