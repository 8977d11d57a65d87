// Row: func | a recursive function of numbers
func.func @f(%a: f64, %n: index) -> f64 attributes {tai.differentiate, tai.gradients = array<i64: 0, 2>} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f64
  %z = arith.cmpi sle, %n, %c0 : index
  %r = scf.if %z -> f64 {
    scf.yield %one : f64
  } else {
    %m = arith.subi %n, %c1 : index
    %p = func.call @f(%a, %m) : (f64, index) -> f64
    %s = math.sin %p : f64
    %q = arith.mulf %s, %a : f64
    scf.yield %q : f64
  }
  return %r : f64
}
