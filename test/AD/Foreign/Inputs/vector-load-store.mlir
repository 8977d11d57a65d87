// Row: vector | `vector.load`, `vector.store`
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %c8 = arith.constant 8 : index
  scf.for %i = %c0 to %c8 step %c4 {
    %a = vector.load %x[%i] : memref<8xf64>, vector<4xf64>
    %b = arith.mulf %a, %a : vector<4xf64>
    %c = math.sin %b : vector<4xf64>
    vector.store %c, %y[%i] : memref<8xf64>, vector<4xf64>
  }
  return
}
