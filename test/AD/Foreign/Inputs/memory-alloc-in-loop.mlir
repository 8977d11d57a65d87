// Row: memref | `memref.alloc` in each iteration of a parallel loop
func.func @f(%x: memref<4x3xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %one = arith.constant 1.0 : f64
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %t = memref.alloc() : memref<3xf64>
    scf.for %j = %c0 to %c3 step %c1 {
      %a = memref.load %x[%i, %j] : memref<4x3xf64>
      %b = math.exp %a : f64
      memref.store %b, %t[%j] : memref<3xf64>
    }
    %p = scf.for %j = %c0 to %c3 step %c1 iter_args(%s = %one) -> f64 {
      %a = memref.load %t[%j] : memref<3xf64>
      %b = arith.addf %a, %s : f64
      %c = arith.mulf %b, %s : f64
      scf.yield %c : f64
    }
    memref.store %p, %y[%i] : memref<4xf64>
    memref.dealloc %t : memref<3xf64>
  }
  return
}
