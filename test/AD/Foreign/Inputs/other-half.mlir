// Row: arith | f16 and bf16 inside: `extf`, `truncf`, sums of f32
// Tolerance: 2e-2
func.func @f(%x: memref<4xf32>, %y: memref<4xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf32>
    %b = memref.load %y[%i] : memref<4xf32>
    %ah = arith.truncf %a : f32 to f16
    %bh = arith.truncf %b : f32 to bf16
    %as = arith.mulf %ah, %ah : f16
    %bs = arith.addf %bh, %bh : bf16
    %c = arith.extf %as : f16 to f32
    %d = arith.extf %bs : bf16 to f32
    %r = arith.mulf %c, %d : f32
    memref.store %r, %y[%i] : memref<4xf32>
  }
  return
}
func.func @plain(%x: memref<4xf32>, %y: memref<4xf32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf32>
    %b = memref.load %y[%i] : memref<4xf32>
    %c = arith.mulf %a, %a : f32
    %d = arith.addf %b, %b : f32
    %r = arith.mulf %c, %d : f32
    memref.store %r, %y[%i] : memref<4xf32>
  }
  return
}
