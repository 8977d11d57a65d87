// Row: affine | a tiled product with bounds by `min`, `affine.vector_load`, `affine.vector_store`
func.func @f(%a: memref<5x5xf64>, %b: memref<5x4xf64>, %c: memref<5x4xf64>) attributes {tai.differentiate} {
  affine.for %it = 0 to 5 step 2 {
    affine.for %kt = 0 to 5 step 3 {
      affine.for %i = affine_map<(d0) -> (d0)>(%it) to min affine_map<(d0) -> (d0 + 2, 5)>(%it) {
        affine.for %k = affine_map<(d0) -> (d0)>(%kt) to min affine_map<(d0) -> (d0 + 3, 5)>(%kt) {
          %x = affine.load %a[%i, %k] : memref<5x5xf64>
          %v = affine.vector_load %b[%k, 0] : memref<5x4xf64>, vector<4xf64>
          %s = affine.vector_load %c[%i, 0] : memref<5x4xf64>, vector<4xf64>
          %xs = vector.broadcast %x : f64 to vector<4xf64>
          %t = vector.fma %xs, %v, %s : vector<4xf64>
          affine.vector_store %t, %c[%i, 0] : memref<5x4xf64>, vector<4xf64>
        }
      }
    }
  }
  return
}
