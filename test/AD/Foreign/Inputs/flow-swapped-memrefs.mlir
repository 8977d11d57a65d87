// Row: scf | memrefs swapped by `iter_args`
func.func @f(%x: memref<5xf64>, %y: memref<5xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c5 = arith.constant 5 : index
  %a = memref.alloc() : memref<5xf64>
  %b = memref.alloc() : memref<5xf64>
  memref.copy %x, %a : memref<5xf64> to memref<5xf64>
  %r:2 = scf.for %t = %c0 to %c3 step %c1 iter_args(%from = %a, %to = %b) -> (memref<5xf64>, memref<5xf64>) {
    scf.for %i = %c0 to %c5 step %c1 {
      %j = arith.addi %i, %c1 : index
      %k = arith.remsi %j, %c5 : index
      %u = memref.load %from[%i] : memref<5xf64>
      %v = memref.load %from[%k] : memref<5xf64>
      %w = arith.mulf %u, %v : f64
      %z = math.sin %w : f64
      memref.store %z, %to[%i] : memref<5xf64>
    }
    scf.yield %to, %from : memref<5xf64>, memref<5xf64>
  }
  memref.copy %r#0, %y : memref<5xf64> to memref<5xf64>
  memref.dealloc %a : memref<5xf64>
  memref.dealloc %b : memref<5xf64>
  return
}
