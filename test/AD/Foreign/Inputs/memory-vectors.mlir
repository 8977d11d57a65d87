// Row: memref | an array of vectors that the function makes
func.func @f(%x: memref<4x3xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  %t = memref.alloc() : memref<4xvector<3xf64>>
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i, %c0] : memref<4x3xf64>
    %b = memref.load %x[%i, %c1] : memref<4x3xf64>
    %c = memref.load %x[%i, %c2] : memref<4x3xf64>
    %v = vector.from_elements %a, %b, %c : vector<3xf64>
    %w = arith.mulf %v, %v : vector<3xf64>
    memref.store %w, %t[%i] : memref<4xvector<3xf64>>
  }
  scf.for %i = %c0 to %c4 step %c1 {
    %v = memref.load %t[%i] : memref<4xvector<3xf64>>
    %s = vector.reduction <add>, %v : vector<3xf64> into f64
    %r = math.sqrt %s : f64
    memref.store %r, %y[%i] : memref<4xf64>
  }
  memref.dealloc %t : memref<4xvector<3xf64>>
  return
}
