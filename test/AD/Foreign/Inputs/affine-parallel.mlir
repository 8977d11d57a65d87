// Row: affine | `affine.parallel` with a reduction
func.func @f(%x: memref<4x3xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %r = affine.parallel (%i, %j) = (0, 0) to (4, 3) reduce ("addf") -> f64 {
    %a = affine.load %x[%i, %j] : memref<4x3xf64>
    %b = arith.mulf %a, %a : f64
    affine.yield %b : f64
  }
  affine.store %r, %y[] : memref<f64>
  return
}
