// Row: in place | numbers that a loop carries, within `tai.trace_bytes`
func.func @f(%x: memref<4xf64>) attributes {tai.differentiate, tai.trace_bytes = 320 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %s0 = memref.load %x[%c0] : memref<4xf64>
  %w = memref.load %x[%c1] : memref<4xf64>
  %r = scf.for %s = %c0 to %c100 step %c1 iter_args(%a = %s0) -> f64 {
    %y = math.sin %a : f64
    %z = arith.mulf %y, %w : f64
    %n = arith.addf %z, %a : f64
    scf.yield %n : f64
  }
  memref.store %r, %x[%c0] : memref<4xf64>
  return
}
