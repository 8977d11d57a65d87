// Row: in place | LU factors of a matrix in place, then a solution by substitution, with `affine.if`
#s = affine_set<(d0, d1) : (d0 - d1 - 1 >= 0)>
func.func @f(%a: memref<3x3xf64>, %b: memref<3xf64>) attributes {tai.differentiate} {
  %ten = arith.constant 6.0 : f64
  affine.for %i = 0 to 3 {
    %d = affine.load %a[%i, %i] : memref<3x3xf64>
    %e = arith.addf %d, %ten : f64
    affine.store %e, %a[%i, %i] : memref<3x3xf64>
  }
  affine.for %k = 0 to 3 {
    affine.for %i = 0 to 3 {
      affine.if #s(%i, %k) {
        %p = affine.load %a[%i, %k] : memref<3x3xf64>
        %q = affine.load %a[%k, %k] : memref<3x3xf64>
        %l = arith.divf %p, %q : f64
        affine.store %l, %a[%i, %k] : memref<3x3xf64>
        affine.for %j = affine_map<(d0) -> (d0 + 1)>(%k) to 3 {
          %u = affine.load %a[%k, %j] : memref<3x3xf64>
          %o = affine.load %a[%i, %j] : memref<3x3xf64>
          %m = arith.mulf %l, %u : f64
          %n = arith.subf %o, %m : f64
          affine.store %n, %a[%i, %j] : memref<3x3xf64>
        }
        %bk = affine.load %b[%k] : memref<3xf64>
        %bi = affine.load %b[%i] : memref<3xf64>
        %m = arith.mulf %l, %bk : f64
        %n = arith.subf %bi, %m : f64
        affine.store %n, %b[%i] : memref<3xf64>
      }
    }
  }
  affine.for %r = 0 to 3 {
    %i = affine.apply affine_map<(d0) -> (2 - d0)>(%r)
    %s = affine.load %b[2 - %r] : memref<3xf64>
    %t = affine.for %j = affine_map<(d0) -> (3 - d0)>(%r) to 3 iter_args(%acc = %s) -> f64 {
      %u = affine.load %a[2 - %r, %j] : memref<3x3xf64>
      %x = affine.load %b[%j] : memref<3xf64>
      %m = arith.mulf %u, %x : f64
      %n = arith.subf %acc, %m : f64
      affine.yield %n : f64
    }
    %d = affine.load %a[2 - %r, 2 - %r] : memref<3x3xf64>
    %x = arith.divf %t, %d : f64
    affine.store %x, %b[2 - %r] : memref<3xf64>
  }
  return
}
