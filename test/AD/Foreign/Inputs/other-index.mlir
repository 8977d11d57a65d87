// Row: index | arithmetic of the index dialect, `affine.delinearize_index`, `affine.linearize_index`
func.func @f(%x: memref<12xf64>, %y: memref<3x4xf64>) attributes {tai.differentiate} {
  %c0 = index.constant 0
  %c1 = index.constant 1
  %c12 = index.constant 12
  scf.for %i = %c0 to %c12 step %c1 {
    %a = memref.load %x[%i] : memref<12xf64>
    %k:2 = affine.delinearize_index %i into (3, 4) : index, index
    %l = affine.linearize_index [%k#1, %k#0] by (4, 3) : index
    %b = memref.load %x[%l] : memref<12xf64>
    %p = arith.mulf %a, %b : f64
    memref.store %p, %y[%k#0, %k#1] : memref<3x4xf64>
  }
  return
}
