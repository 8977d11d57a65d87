// Row: func | a function that is differentiated and calls itself, with several blocks
func.func @f(%x: f64, %w: f64, %n: i32) -> f64 attributes {tai.differentiate, tai.gradients = array<i64: 0, 1, 3>} {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %z = arith.cmpi sle, %n, %c0 : i32
  cf.cond_br %z, ^end, ^again
^end:
  %e = math.exp %x : f64
  return %e : f64
^again:
  %m = arith.subi %n, %c1 : i32
  %s = math.sin %x : f64
  %t = arith.mulf %s, %w : f64
  %q = func.call @f(%t, %w, %m) : (f64, f64, i32) -> f64
  %u = arith.mulf %q, %x : f64
  return %u : f64
}
