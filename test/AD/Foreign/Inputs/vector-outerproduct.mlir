// Row: vector | `vector.outerproduct`
func.func @f(%x: memref<2xf64>, %w: memref<3xf64>, %y: memref<2x3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %a = vector.load %x[%c0] : memref<2xf64>, vector<2xf64>
  %b = vector.load %w[%c0] : memref<3xf64>, vector<3xf64>
  %c = vector.outerproduct %a, %b : vector<2xf64>, vector<3xf64>
  %d = math.sin %c : vector<2x3xf64>
  vector.transfer_write %d, %y[%c0, %c0] {in_bounds = [true, true]} : vector<2x3xf64>, memref<2x3xf64>
  return
}
