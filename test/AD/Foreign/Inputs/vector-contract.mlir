// Row: vector | `vector.contract`
func.func @f(%x: memref<2x3xf64>, %w: memref<3x2xf64>, %y: memref<2x2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %pad = arith.constant 0.0 : f64
  %a = vector.transfer_read %x[%c0, %c0], %pad {in_bounds = [true, true]} : memref<2x3xf64>, vector<2x3xf64>
  %b = vector.transfer_read %w[%c0, %c0], %pad {in_bounds = [true, true]} : memref<3x2xf64>, vector<3x2xf64>
  %c = vector.transfer_read %y[%c0, %c0], %pad {in_bounds = [true, true]} : memref<2x2xf64>, vector<2x2xf64>
  %d = vector.contract {indexing_maps = [affine_map<(i, j, k) -> (i, k)>, affine_map<(i, j, k) -> (k, j)>, affine_map<(i, j, k) -> (i, j)>], iterator_types = ["parallel", "parallel", "reduction"], kind = #vector.kind<add>} %a, %b, %c : vector<2x3xf64>, vector<3x2xf64> into vector<2x2xf64>
  %e = arith.mulf %d, %d : vector<2x2xf64>
  vector.transfer_write %e, %y[%c0, %c0] {in_bounds = [true, true]} : vector<2x2xf64>, memref<2x2xf64>
  return
}
