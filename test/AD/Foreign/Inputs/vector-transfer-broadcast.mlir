// Row: vector | `vector.transfer_read` that broadcasts, `vector.fma`, a product by `vector.reduction`
func.func @f(%x: memref<4x8xf64>, %y: memref<4x8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c8 = arith.constant 8 : index
  %pad = arith.constant 0.5 : f64
  scf.for %i = %c0 to %c4 step %c1 {
    scf.for %j = %c0 to %c8 step %c4 {
      %a = vector.transfer_read %x[%i, %j], %pad : memref<4x8xf64>, vector<4xf64>
      %b = vector.transfer_read %x[%i, %j], %pad {permutation_map = affine_map<(d0, d1) -> (0)>, in_bounds = [true]} : memref<4x8xf64>, vector<4xf64>
      %c = vector.fma %a, %b, %a : vector<4xf64>
      %s = vector.reduction <mul>, %c : vector<4xf64> into f64
      %v = vector.broadcast %s : f64 to vector<4xf64>
      %d = arith.addf %v, %c : vector<4xf64>
      vector.transfer_write %d, %y[%i, %j] : vector<4xf64>, memref<4x8xf64>
    }
  }
  return
}
