func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %a = memref.load %x[%i] : memref<4xf64>
    %v = vector.from_elements %a, %a : vector<2xf64>
    %w = vector.interleave %v, %v : vector<2xf64> -> vector<4xf64>
    %b = vector.extract %w[3] : f64 from vector<4xf64>
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
