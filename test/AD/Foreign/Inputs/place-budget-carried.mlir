// Row: in place | steps within `tai.trace_bytes`, whose records recover a number that the loop carries
func.func @f(%x: memref<10xf64>, %w: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 1000 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c100 = arith.constant 100 : index
  %h = arith.constant 0.99 : f64
  %s0 = memref.load %w[%c0] : memref<10xf64>
  %r = scf.for %s = %c0 to %c100 step %c1 iter_args(%acc = %s0) -> f64 {
    %p = arith.remui %s, %c2 : index
    %a = memref.load %x[%p] : memref<10xf64>
    %y = math.sin %acc : f64
    %z = arith.addf %y, %a : f64
    %n = arith.mulf %a, %h : f64
    %b = arith.negf %n : f64
    memref.store %b, %x[%p] : memref<10xf64>
    scf.yield %z : f64
  }
  memref.store %r, %w[%c1] : memref<10xf64>
  return
}
