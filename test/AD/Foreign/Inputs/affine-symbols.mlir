// Row: affine | bounds with symbols, `affine.min`, `affine.max`, maps of symbols in accesses
#tile = affine_map<(d0)[s0] -> (d0 * 2, s0)>
#end = affine_map<(d0)[s0] -> (d0 * 2 + 2, s0)>
func.func @f(%x: memref<?xf64>, %y: memref<?xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %n = memref.dim %x, %c0 : memref<?xf64>
  affine.for %i = 0 to affine_map<()[s0] -> (s0 ceildiv 2)>()[%n] {
    affine.for %j = max #tile(%i)[%c0] to min #end(%i)[%n] {
      %a = affine.load %x[%j] : memref<?xf64>
      %m = affine.min affine_map<(d0)[s0] -> (d0 + 1, s0 - 1)>(%j)[%n]
      %b = memref.load %x[%m] : memref<?xf64>
      %p = arith.mulf %a, %b : f64
      %old = affine.load %y[-%j + symbol(%n) - 1] : memref<?xf64>
      %s = arith.addf %p, %old : f64
      affine.store %s, %y[-%j + symbol(%n) - 1] : memref<?xf64>
    }
  }
  return
}
