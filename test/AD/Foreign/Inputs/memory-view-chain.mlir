// Row: memref | a chain of `memref.subview`, `cast`, `collapse_shape` and another `subview` with a step
func.func @f(%x: memref<4x6xf64>, %n: index, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %v = memref.subview %x[1, 0] [2, 6] [1, 1] : memref<4x6xf64> to memref<2x6xf64, strided<[6, 1], offset: 6>>
  %w = memref.collapse_shape %v [[0, 1]] : memref<2x6xf64, strided<[6, 1], offset: 6>> into memref<12xf64, strided<[1], offset: 6>>
  %u = memref.subview %w[%n] [4] [2] : memref<12xf64, strided<[1], offset: 6>> to memref<4xf64, strided<[2], offset: ?>>
  %t = memref.cast %u : memref<4xf64, strided<[2], offset: ?>> to memref<?xf64, strided<[?], offset: ?>>
  %size = memref.dim %t, %c0 : memref<?xf64, strided<[?], offset: ?>>
  scf.for %i = %c0 to %size step %c1 {
    %a = memref.load %t[%i] : memref<?xf64, strided<[?], offset: ?>>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %t[%i] : memref<?xf64, strided<[?], offset: ?>>
    %old = memref.load %y[%i] : memref<4xf64>
    %s = arith.mulf %b, %old : f64
    memref.store %s, %y[%i] : memref<4xf64>
  }
  return
}
