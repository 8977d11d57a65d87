// Row: scf | two buffers that the function allocates, swapped by `iter_args` for a number of steps known at run time
func.func @f(%x: memref<?xf64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %h = arith.constant 0.3 : f64
  %d = memref.dim %x, %c0 : memref<?xf64>
  %a = memref.alloc(%d) : memref<?xf64>
  %b = memref.alloc(%d) : memref<?xf64>
  memref.copy %x, %a : memref<?xf64> to memref<?xf64>
  %last = arith.subi %d, %c1 : index
  memref.copy %x, %b : memref<?xf64> to memref<?xf64>
  %r:2 = scf.for %t = %c0 to %n step %c1 iter_args(%p = %a, %q = %b) -> (memref<?xf64>, memref<?xf64>) {
    scf.for %i = %c1 to %last step %c1 {
      %im = arith.subi %i, %c1 : index
      %ip = arith.addi %i, %c1 : index
      %l = memref.load %p[%im] : memref<?xf64>
      %m = memref.load %p[%i] : memref<?xf64>
      %u = memref.load %p[%ip] : memref<?xf64>
      %s = arith.mulf %l, %u : f64
      %v = arith.mulf %s, %h : f64
      %w = math.sin %v : f64
      %z = arith.addf %w, %m : f64
      memref.store %z, %q[%i] : memref<?xf64>
    }
    scf.yield %q, %p : memref<?xf64>, memref<?xf64>
  }
  memref.copy %r#0, %x : memref<?xf64> to memref<?xf64>
  memref.dealloc %a : memref<?xf64>
  memref.dealloc %b : memref<?xf64>
  return
}
