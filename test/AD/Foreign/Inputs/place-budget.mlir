// Row: in place | steps within `tai.trace_bytes`, by segments of a loop that carries a number
func.func @f(%x: memref<10xf64>, %w: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 1300 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c41 = arith.constant 41 : index
  %h = arith.constant 0.05 : f64
  %s0 = memref.load %w[%c0] : memref<10xf64>
  %r = scf.for %s = %c2 to %c41 step %c2 iter_args(%acc = %s0) -> f64 {
    scf.for %i = %c1 to %c9 step %c1 {
      %im = arith.subi %i, %c1 : index
      %l = memref.load %x[%im] : memref<10xf64>
      %a = memref.load %x[%i] : memref<10xf64>
      %v = memref.load %w[%i] : memref<10xf64>
      %q = arith.mulf %a, %l : f64
      %q2 = arith.mulf %q, %v : f64
      %t = math.sin %q2 : f64
      %b = arith.mulf %t, %h : f64
      %n = arith.addf %a, %b : f64
      memref.store %n, %x[%i] : memref<10xf64>
    }
    %z = memref.load %x[%c2] : memref<10xf64>
    %u = arith.mulf %z, %acc : f64
    %y = math.tanh %u : f64
    scf.yield %y : f64
  }
  %p = memref.load %x[%c0] : memref<10xf64>
  %rr = arith.mulf %r, %p : f64
  memref.store %rr, %x[%c0] : memref<10xf64>
  return
}
