// Row: vector | `vector.transfer_read` of two dimensions, transposed
func.func @f(%x: memref<4x4xf64>, %y: memref<4x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %pad = arith.constant 0.0 : f64
  %a = vector.transfer_read %x[%c0, %c1], %pad {in_bounds = [true, true], permutation_map = affine_map<(i, j) -> (j, i)>} : memref<4x4xf64>, vector<2x3xf64>
  %b = arith.mulf %a, %a : vector<2x3xf64>
  vector.transfer_write %b, %y[%c1, %c0] {in_bounds = [true, true]} : vector<2x3xf64>, memref<4x4xf64>
  return
}
