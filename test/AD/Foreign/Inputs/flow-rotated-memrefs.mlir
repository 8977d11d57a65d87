// Row: scf | three memrefs rotated by `iter_args`
func.func @f(%x: memref<5xf64>, %y: memref<5xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %a = memref.alloc() : memref<5xf64>
  %b = memref.alloc() : memref<5xf64>
  %c = memref.alloca() : memref<5xf64>
  linalg.copy ins(%x : memref<5xf64>) outs(%a : memref<5xf64>)
  linalg.copy ins(%y : memref<5xf64>) outs(%b : memref<5xf64>)
  %r:3 = scf.for %t = %c0 to %c4 step %c1 iter_args(%p = %a, %q = %b, %o = %c) -> (memref<5xf64>, memref<5xf64>, memref<5xf64>) {
    scf.for %i = %c0 to %c5 step %c1 {
      %u = memref.load %p[%i] : memref<5xf64>
      %v = memref.load %q[%i] : memref<5xf64>
      %w = arith.mulf %u, %v : f64
      %z = math.sin %w : f64
      memref.store %z, %o[%i] : memref<5xf64>
    }
    scf.yield %q, %o, %p : memref<5xf64>, memref<5xf64>, memref<5xf64>
  }
  linalg.copy ins(%r#1 : memref<5xf64>) outs(%y : memref<5xf64>)
  memref.dealloc %a : memref<5xf64>
  memref.dealloc %b : memref<5xf64>
  return
}
