// Row: vector | `vector.transfer_read`, `vector.transfer_write` beyond the end
func.func @f(%x: memref<?xf64>, %y: memref<?xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %pad = arith.constant 1.0 : f64
  %n = memref.dim %x, %c0 : memref<?xf64>
  scf.for %i = %c0 to %n step %c4 {
    %a = vector.transfer_read %x[%i], %pad : memref<?xf64>, vector<4xf64>
    %b = arith.mulf %a, %a : vector<4xf64>
    vector.transfer_write %b, %y[%i] : vector<4xf64>, memref<?xf64>
  }
  return
}
