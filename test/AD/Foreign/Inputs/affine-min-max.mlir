// Row: affine | bounds by `min`, `affine.max`, `iter_args`
func.func @f(%x: memref<6xf64>, %y: memref<6xf64>) attributes {tai.differentiate} {
  affine.for %i = 0 to 6 step 2 {
    %z = arith.constant 0.0 : f64
    %s = affine.for %j = affine_map<(d0) -> (d0)>(%i) to min affine_map<(d0) -> (d0 + 2, 6)>(%i) iter_args(%a = %z) -> f64 {
      %u = memref.load %x[%j] : memref<6xf64>
      %v = math.exp %u : f64
      %b = arith.addf %a, %v : f64
      affine.yield %b : f64
    }
    %k = affine.max affine_map<(d0) -> (d0 - 1, 0)>(%i)
    %w = memref.load %x[%k] : memref<6xf64>
    %p = arith.mulf %s, %w : f64
    affine.store %p, %y[%i + 1] : memref<6xf64>
  }
  return
}
