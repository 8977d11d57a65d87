// RUN: tai-opt %s --tai-make-adjoint --verify-diagnostics

// A function with an op that has no rule is refused at the op, once.

!m = vector<2x2xf64>
tai.tree @t : !tai.root<{a: !m, ga: !m, r: !m, gr: !m, v: vector<2xf64>, gv: vector<2xf64>, k: f64, n: i32}>
tai.field @ga = @t["ga"] : !m, rank 0
tai.field @gr = @t["gr"] : !m, rank 0
tai.field @gv = @t["gv"] : vector<2xf64>, rank 0
tai.field @a = @t["a"] : !m, rank 0, adjoint @ga
tai.field @r = @t["r"] : !m, rank 0, adjoint @gr
tai.field @v = @t["v"] : vector<2xf64>, rank 0, adjoint @gv
tai.kernel @no_rule() {
  %zero = arith.constant 0.0 : f64
  %a = tai.load @a[] : !m
  %u, %s, %v = tai.svd %a : !m
  %s0 = vector.extract %s[0, 0] : f64 from !m
  // expected-error @+2 {{'arith.scaling_extf' has no derivative rule, but a gradient passes through it}}
  // expected-note @+1 {{compute the value from differentiable ops}}
  %b = arith.scaling_extf %s0, %s0 : f64, f64 to f128
  %m0 = arith.truncf %b : f128 to f64
  %m = vector.from_elements %m0, %zero, %zero, %s0 : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  tai.store %2, @r[] : !m
  tai.return
}
