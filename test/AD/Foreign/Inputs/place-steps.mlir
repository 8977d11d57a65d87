// Row: in place | time steps on one array: neighbours, nested loops
func.func @f(%x: memref<6xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c5 = arith.constant 5 : index
  %zero = arith.constant 0.0 : f64
  scf.for %t = %c0 to %c3 step %c1 {
    scf.for %i = %c1 to %c5 step %c1 {
      %p = arith.subi %i, %c1 : index
      %q = arith.addi %i, %c1 : index
      %a = memref.load %x[%p] : memref<6xf64>
      %b = memref.load %x[%i] : memref<6xf64>
      %c = memref.load %x[%q] : memref<6xf64>
      %d = arith.mulf %a, %c : f64
      %e = arith.addf %d, %b : f64
      %g = math.sin %e : f64
      memref.store %g, %x[%i] : memref<6xf64>
    }
  }
  %r = scf.for %i = %c0 to %c5 step %c1 iter_args(%s = %zero) -> f64 {
    %a = memref.load %x[%i] : memref<6xf64>
    %b = arith.mulf %a, %a : f64
    %c = arith.addf %b, %s : f64
    scf.yield %c : f64
  }
  memref.store %r, %y[] : memref<f64>
  return
}
