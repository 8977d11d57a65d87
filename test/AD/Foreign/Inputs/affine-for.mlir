// Row: affine | `affine.for`, `affine.load`, `affine.store`, `affine.apply`
func.func @f(%x: memref<6xf64>, %y: memref<6xf64>) attributes {tai.differentiate} {
  affine.for %i = 1 to 5 {
    %j = affine.apply affine_map<(d0) -> (d0 - 1)>(%i)
    %a = affine.load %x[%j] : memref<6xf64>
    %b = affine.load %x[%i + 1] : memref<6xf64>
    %c = arith.mulf %a, %b : f64
    affine.store %c, %y[%i] : memref<6xf64>
  }
  return
}
