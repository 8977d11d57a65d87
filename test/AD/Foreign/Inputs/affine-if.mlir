// Row: affine | `affine.if`, `affine.for` with `iter_args`
func.func @f(%x: memref<6xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %one = arith.constant 1.0 : f64
  %r = affine.for %i = 0 to 6 iter_args(%s = %one) -> f64 {
    %a = affine.load %x[%i] : memref<6xf64>
    %b = affine.if affine_set<(d0) : (d0 - 3 >= 0)>(%i) -> f64 {
      %0 = math.exp %a : f64
      affine.yield %0 : f64
    } else {
      affine.yield %a : f64
    }
    %c = arith.mulf %b, %s : f64
    affine.yield %c : f64
  }
  affine.store %r, %y[] : memref<f64>
  return
}
