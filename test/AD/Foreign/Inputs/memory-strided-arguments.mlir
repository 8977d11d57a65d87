// Row: memref | arguments with strides and offsets known at run time, rows by `subview` that drop a dimension
func.func @f(%x: memref<4x4xf64, strided<[?, 1], offset: ?>>, %y: memref<?x?xf64, strided<[?, ?], offset: ?>>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %row = memref.subview %x[%i, 0] [1, 4] [1, 1] : memref<4x4xf64, strided<[?, 1], offset: ?>> to memref<4xf64, strided<[1], offset: ?>>
    %col = memref.subview %y[0, %i] [4, 1] [1, 1] : memref<?x?xf64, strided<[?, ?], offset: ?>> to memref<4xf64, strided<[?], offset: ?>>
    scf.for %j = %c0 to %c4 step %c1 {
      %a = memref.load %row[%j] : memref<4xf64, strided<[1], offset: ?>>
      %b = memref.load %col[%j] : memref<4xf64, strided<[?], offset: ?>>
      %c = arith.mulf %a, %b : f64
      memref.store %c, %col[%j] : memref<4xf64, strided<[?], offset: ?>>
      %d = math.sin %c : f64
      memref.store %d, %row[%j] : memref<4xf64, strided<[1], offset: ?>>
    }
  }
  return
}
