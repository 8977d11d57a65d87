// Row: memref | `memref.get_global` of a constant
memref.global "private" constant @w : memref<4xf64> = dense<[1.0, -2.0, 0.5, 3.0]>
func.func @f(%x: memref<4xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  %w = memref.get_global @w : memref<4xf64>
  %r = scf.for %i = %c0 to %c4 step %c1 iter_args(%s = %zero) -> f64 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = memref.load %w[%i] : memref<4xf64>
    %c = arith.mulf %a, %b : f64
    %d = math.sin %c : f64
    %e = arith.addf %d, %s : f64
    scf.yield %e : f64
  }
  memref.store %r, %y[] : memref<f64>
  return
}
