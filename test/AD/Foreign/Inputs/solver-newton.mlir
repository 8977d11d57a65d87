// Row: scf | Newton's method in `scf.while` for a system of two equations, numbers by `tai.gradients`
func.func @f(%a: f64, %b: f64) -> (f64, f64) attributes {tai.differentiate, tai.gradients = array<i64: 0, 1, 2, 3>} {
  %one = arith.constant 1.0 : f64
  %small = arith.constant 1.0e-14 : f64
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %c50 = arith.constant 50 : i32
  %qa = arith.mulf %a, %a : f64
  %qb = arith.mulf %b, %b : f64
  // u + v^3 / 20 = 1 + a^2, v + u^3 / 40 = b^2
  %third = arith.constant 0.025 : f64
  %twentieth = arith.constant 0.05 : f64
  %three = arith.constant 3.0 : f64
  %ra = arith.addf %one, %qa : f64
  %r:3 = scf.while (%u = %qa, %v = %qb, %n = %c0) : (f64, f64, i32) -> (f64, f64, i32) {
    %v2 = arith.mulf %v, %v : f64
    %v3a = arith.mulf %v2, %v : f64
    %v3 = arith.mulf %v3a, %twentieth : f64
    %s = arith.addf %u, %v3 : f64
    %e = arith.subf %s, %ra : f64
    %m = math.absf %e : f64
    %far = arith.cmpf ogt, %m, %small : f64
    %few = arith.cmpi slt, %n, %c50 : i32
    %go = arith.andi %far, %few : i1
    scf.condition(%go) %u, %v, %n : f64, f64, i32
  } do {
  ^bb0(%u: f64, %v: f64, %n: i32):
    %u2 = arith.mulf %u, %u : f64
    %u3 = arith.mulf %u2, %u : f64
    %v2 = arith.mulf %v, %v : f64
    %v3a = arith.mulf %v2, %v : f64
    %v3 = arith.mulf %v3a, %twentieth : f64
    %s = arith.addf %u, %v3 : f64
    %e1 = arith.subf %s, %ra : f64
    %t = arith.mulf %u3, %third : f64
    %t1 = arith.addf %v, %t : f64
    %e2 = arith.subf %t1, %qb : f64
    %j12a = arith.mulf %three, %v2 : f64
    %j12 = arith.mulf %j12a, %twentieth : f64
    %j21a = arith.mulf %three, %u2 : f64
    %j21 = arith.mulf %j21a, %third : f64
    %jj = arith.mulf %j12, %j21 : f64
    %det = arith.subf %one, %jj : f64
    %p = arith.mulf %j12, %e2 : f64
    %p1 = arith.subf %e1, %p : f64
    %du = arith.divf %p1, %det : f64
    %q = arith.mulf %j21, %e1 : f64
    %q1 = arith.subf %e2, %q : f64
    %dv = arith.divf %q1, %det : f64
    %damp = arith.constant 0.9 : f64
    %du1 = arith.mulf %du, %damp : f64
    %dv1 = arith.mulf %dv, %damp : f64
    %un = arith.subf %u, %du1 : f64
    %vn = arith.subf %v, %dv1 : f64
    %more = arith.addi %n, %c1 : i32
    scf.yield %un, %vn, %more : f64, f64, i32
  }
  return %r#0, %r#1 : f64, f64
}
