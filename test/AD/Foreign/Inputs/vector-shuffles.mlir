// Row: vector | `vector.shuffle`, `shape_cast`, `transpose`, `extract_strided_slice`, `insert_strided_slice`
func.func @f(%x: memref<2x3xf64>, %y: memref<6xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %pad = arith.constant 0.0 : f64
  %a = vector.transfer_read %x[%c0, %c0], %pad {in_bounds = [true, true]} : memref<2x3xf64>, vector<2x3xf64>
  %t = vector.transpose %a, [1, 0] : vector<2x3xf64> to vector<3x2xf64>
  %s = vector.shape_cast %t : vector<3x2xf64> to vector<6xf64>
  %e = vector.extract_strided_slice %s {offsets = [1], sizes = [3], strides = [1]} : vector<6xf64> to vector<3xf64>
  %m = arith.mulf %e, %e : vector<3xf64>
  %i = vector.insert_strided_slice %m, %s {offsets = [2], strides = [1]} : vector<3xf64> into vector<6xf64>
  %h = vector.shuffle %i, %s [0, 7, 2, 9, 4, 4] : vector<6xf64>, vector<6xf64>
  vector.store %h, %y[%c0] : memref<6xf64>, vector<6xf64>
  return
}
