// Row: vector | `vector.multi_reduction`, `vector.reduction`
func.func @f(%x: memref<2x3xf64>, %y: memref<2xf64>, %z: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %one = arith.constant dense<1.0> : vector<2xf64>
  %pad = arith.constant 0.0 : f64
  %a = vector.transfer_read %x[%c0, %c0], %pad {in_bounds = [true, true]} : memref<2x3xf64>, vector<2x3xf64>
  %b = vector.multi_reduction <mul>, %a, %one [1] : vector<2x3xf64> to vector<2xf64>
  vector.store %b, %y[%c0] : memref<2xf64>, vector<2xf64>
  %c = vector.reduction <maximumf>, %b : vector<2xf64> into f64
  memref.store %c, %z[] : memref<f64>
  return
}
