// Row: in place | a product by a sparse matrix in rows of entries, with index arrays that the function fills
func.func @f(%v: memref<6xf64>, %x: memref<4xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c6 = arith.constant 6 : index
  %rows = memref.alloc() : memref<4xindex>
  %cols = memref.alloc() : memref<6xindex>
  scf.for %i = %c0 to %c4 step %c1 {
    %p = arith.muli %i, %c2 : index
    memref.store %p, %rows[%i] : memref<4xindex>
  }
  scf.for %i = %c0 to %c6 step %c1 {
    %p = arith.muli %i, %c3 : index
    %q = arith.remui %p, %c4 : index
    memref.store %q, %cols[%i] : memref<6xindex>
  }
  scf.parallel (%i) = (%c0) to (%c3) step (%c1) {
    %next = arith.addi %i, %c1 : index
    %b = memref.load %rows[%i] : memref<4xindex>
    %e = memref.load %rows[%next] : memref<4xindex>
    %old = memref.load %y[%i] : memref<3xf64>
    %s = scf.for %k = %b to %e step %c1 iter_args(%a = %old) -> f64 {
      %j = memref.load %cols[%k] : memref<6xindex>
      %w = memref.load %v[%k] : memref<6xf64>
      %u = memref.load %x[%j] : memref<4xf64>
      %m = arith.mulf %w, %u : f64
      %n = arith.addf %a, %m : f64
      scf.yield %n : f64
    }
    %z = math.tanh %s : f64
    memref.store %z, %y[%i] : memref<3xf64>
  }
  memref.dealloc %rows : memref<4xindex>
  memref.dealloc %cols : memref<6xindex>
  return
}
