// RUN: tai-run %s --no-cache

// Each rule for a scalar op agrees with central differences. The terms of a sum
// have different weights, so that no two errors cancel.

tai.tree @data : !tai.root<
    dense<[i: 24], {x: f64, x_grad: f64, y: f64, y_grad: f64}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y_grad = @data["y_grad"] : f64, rank 1
tai.field @y = @data["y"] : f64, rank 1, adjoint @y_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

// x and y in 0.05 ± 0.83.
tai.kernel @around_zero() {
  %a = arith.constant 0.05 : f64
  %b = arith.constant 0.83 : f64
  %p = arith.constant 1.37 : f64
  %q = arith.constant 2.11 : f64
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %t0 = arith.sitofp %n : i32 to f64
    %t = arith.addf %t0, %p : f64
    %u0 = arith.mulf %t, %p : f64
    %u1 = math.sin %u0 : f64
    %u2 = arith.mulf %u1, %b : f64
    %u = arith.addf %u2, %a : f64
    %v0 = arith.mulf %t, %q : f64
    %v1 = math.sin %v0 : f64
    %v2 = arith.mulf %v1, %b : f64
    %v = arith.addf %v2, %a : f64
    tai.store %u, @x[%i] : f64
    tai.store %v, @y[%i] : f64
  }
  tai.return
}

// x and y in 2.1 ± 0.9.
tai.kernel @above_one() {
  %a = arith.constant 2.1 : f64
  %b = arith.constant 0.9 : f64
  %p = arith.constant 1.37 : f64
  %q = arith.constant 2.11 : f64
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %t0 = arith.sitofp %n : i32 to f64
    %t = arith.addf %t0, %p : f64
    %u0 = arith.mulf %t, %p : f64
    %u1 = math.sin %u0 : f64
    %u2 = arith.mulf %u1, %b : f64
    %u = arith.addf %u2, %a : f64
    %v0 = arith.mulf %t, %q : f64
    %v1 = math.sin %v0 : f64
    %v2 = arith.mulf %v1, %b : f64
    %v = arith.addf %v2, %a : f64
    tai.store %u, @x[%i] : f64
    tai.store %v, @y[%i] : f64
  }
  tai.return
}

// x in {-1.7, -0.7, ...} and y in {-0.38, 0.62, ...}: far from each other and
// from whole and half numbers.
tai.kernel @apart() {
  %a = arith.constant -1.7 : f64
  %b = arith.constant -0.38 : f64
  %five = arith.constant 5 : i32
  %three = arith.constant 3 : i32
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %n5 = arith.remsi %n, %five : i32
    %n3 = arith.remsi %n, %three : i32
    %f5 = arith.sitofp %n5 : i32 to f64
    %f3 = arith.sitofp %n3 : i32 to f64
    %u = arith.addf %f5, %a : f64
    %v = arith.addf %f3, %b : f64
    tai.store %u, @x[%i] : f64
    tai.store %v, @y[%i] : f64
  }
  tai.return
}

tai.kernel @trigonometry() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_sin = math.sin %x : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_sin : f64
    %r_cos = math.cos %x : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %r_cos : f64
    %s1 = arith.addf %t0, %t1 : f64
    %r_tan = math.tan %x : f64
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %r_tan : f64
    %s2 = arith.addf %s1, %t2 : f64
    %r_asin = math.asin %x : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %r_asin : f64
    %s3 = arith.addf %s2, %t3 : f64
    %r_acos = math.acos %x : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %r_acos : f64
    %s4 = arith.addf %s3, %t4 : f64
    %r_atan = math.atan %x : f64
    %c5 = arith.constant 1.16 : f64
    %t5 = arith.mulf %c5, %r_atan : f64
    %s5 = arith.addf %s4, %t5 : f64
    %sc, %cc = math.sincos %x : f64
    %scp = arith.mulf %sc, %cc : f64
    %c6 = arith.constant 1.33 : f64
    %t6 = arith.mulf %c6, %scp : f64
    %s6 = arith.addf %s5, %t6 : f64
    tai.atomic add %s6, @loss[] : f64
  }
  tai.return
}

tai.kernel @hyperbolic() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_sinh = math.sinh %x : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_sinh : f64
    %r_cosh = math.cosh %x : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %r_cosh : f64
    %s1 = arith.addf %t0, %t1 : f64
    %r_tanh = math.tanh %x : f64
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %r_tanh : f64
    %s2 = arith.addf %s1, %t2 : f64
    %r_asinh = math.asinh %x : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %r_asinh : f64
    %s3 = arith.addf %s2, %t3 : f64
    %r_atanh = math.atanh %x : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %r_atanh : f64
    %s4 = arith.addf %s3, %t4 : f64
    tai.atomic add %s4, @loss[] : f64
  }
  tai.return
}

tai.kernel @exponentials() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_exp = math.exp %x : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_exp : f64
    %r_exp2 = math.exp2 %x : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %r_exp2 : f64
    %s1 = arith.addf %t0, %t1 : f64
    %r_expm1 = math.expm1 %x : f64
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %r_expm1 : f64
    %s2 = arith.addf %s1, %t2 : f64
    %r_log1p = math.log1p %x : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %r_log1p : f64
    %s3 = arith.addf %s2, %t3 : f64
    %r_erf = math.erf %x : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %r_erf : f64
    %s4 = arith.addf %s3, %t4 : f64
    %r_erfc = math.erfc %x : f64
    %c5 = arith.constant 1.16 : f64
    %t5 = arith.mulf %c5, %r_erfc : f64
    %s5 = arith.addf %s4, %t5 : f64
    tai.atomic add %s5, @loss[] : f64
  }
  tai.return
}

tai.kernel @roots_and_logarithms() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_sqrt = math.sqrt %x : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_sqrt : f64
    %r_rsqrt = math.rsqrt %x : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %r_rsqrt : f64
    %s1 = arith.addf %t0, %t1 : f64
    %r_cbrt = math.cbrt %x : f64
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %r_cbrt : f64
    %s2 = arith.addf %s1, %t2 : f64
    %r_log = math.log %x : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %r_log : f64
    %s3 = arith.addf %s2, %t3 : f64
    %r_log2 = math.log2 %x : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %r_log2 : f64
    %s4 = arith.addf %s3, %t4 : f64
    %r_log10 = math.log10 %x : f64
    %c5 = arith.constant 1.16 : f64
    %t5 = arith.mulf %c5, %r_log10 : f64
    %s5 = arith.addf %s4, %t5 : f64
    %r_acosh = math.acosh %x : f64
    %c6 = arith.constant 1.33 : f64
    %t6 = arith.mulf %c6, %r_acosh : f64
    %s6 = arith.addf %s5, %t6 : f64
    tai.atomic add %s6, @loss[] : f64
  }
  tai.return
}

tai.kernel @powers() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_powf = math.powf %x, %y : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_powf : f64
    %n3 = arith.constant 3 : i32
    %pi3 = math.fpowi %x, %n3 : f64, i32
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %pi3 : f64
    %s1 = arith.addf %t0, %t1 : f64
    %nm2 = arith.constant -2 : i32
    %pim2 = math.fpowi %y, %nm2 : f64, i32
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %pim2 : f64
    %s2 = arith.addf %s1, %t2 : f64
    %e1 = arith.constant 1.7 : f64
    %pc = math.powf %x, %e1 : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %pc : f64
    %s3 = arith.addf %s2, %t3 : f64
    %e2 = arith.constant 0.6 : f64
    %pd = math.powf %e2, %y : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %pd : f64
    %s4 = arith.addf %s3, %t4 : f64
    tai.atomic add %s4, @loss[] : f64
  }
  tai.return
}

tai.kernel @arithmetic() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_addf = arith.addf %x, %y : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_addf : f64
    %r_subf = arith.subf %x, %y : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %r_subf : f64
    %s1 = arith.addf %t0, %t1 : f64
    %r_mulf = arith.mulf %x, %y : f64
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %r_mulf : f64
    %s2 = arith.addf %s1, %t2 : f64
    %r_divf = arith.divf %x, %y : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %r_divf : f64
    %s3 = arith.addf %s2, %t3 : f64
    %r_atan2 = math.atan2 %x, %y : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %r_atan2 : f64
    %s4 = arith.addf %s3, %t4 : f64
    %neg = arith.negf %y : f64
    %fm = math.fma %x, %y, %neg : f64
    %c5 = arith.constant 1.16 : f64
    %t5 = arith.mulf %c5, %fm : f64
    %s5 = arith.addf %s4, %t5 : f64
    %big = arith.constant 7.3 : f64
    %xb = arith.mulf %x, %big : f64
    %rem = arith.remf %xb, %y : f64
    %c6 = arith.constant 1.33 : f64
    %t6 = arith.mulf %c6, %rem : f64
    %s6 = arith.addf %s5, %t6 : f64
    tai.atomic add %s6, @loss[] : f64
  }
  tai.return
}

tai.kernel @choices() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %r_maximumf = arith.maximumf %x, %y : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %r_maximumf : f64
    %r_minimumf = arith.minimumf %x, %y : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %r_minimumf : f64
    %s1 = arith.addf %t0, %t1 : f64
    %r_maxnumf = arith.maxnumf %x, %y : f64
    %c2 = arith.constant 0.65 : f64
    %t2 = arith.mulf %c2, %r_maxnumf : f64
    %s2 = arith.addf %s1, %t2 : f64
    %r_minnumf = arith.minnumf %x, %y : f64
    %c3 = arith.constant 0.82 : f64
    %t3 = arith.mulf %c3, %r_minnumf : f64
    %s3 = arith.addf %s2, %t3 : f64
    %lo = arith.constant -0.4 : f64
    %cl = math.clampf %x to [%lo, %y] : f64
    %c4 = arith.constant 0.99 : f64
    %t4 = arith.mulf %c4, %cl : f64
    %s4 = arith.addf %s3, %t4 : f64
    %ab = math.absf %x : f64
    %c5 = arith.constant 1.16 : f64
    %t5 = arith.mulf %c5, %ab : f64
    %s5 = arith.addf %s4, %t5 : f64
    %cs = math.copysign %x, %y : f64
    %c6 = arith.constant 1.33 : f64
    %t6 = arith.mulf %c6, %cs : f64
    %s6 = arith.addf %s5, %t6 : f64
    %cond = arith.cmpf ogt, %x, %y : f64
    %sq = arith.mulf %y, %y : f64
    %sl = arith.select %cond, %x, %sq : f64
    %c7 = arith.constant 1.50 : f64
    %t7 = arith.mulf %c7, %sl : f64
    %s7 = arith.addf %s6, %t7 : f64
    tai.atomic add %s7, @loss[] : f64
  }
  tai.return
}

tai.kernel @rounding() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %fl = math.floor %x : f64
    %fi = arith.fptosi %y : f64 to i32
    %ff = arith.sitofp %fi : i32 to f64
    %g0 = arith.addf %fl, %ff : f64
    %g1 = arith.mulf %g0, %x : f64
    %c0 = arith.constant 0.31 : f64
    %t0 = arith.mulf %c0, %g1 : f64
    %ce = math.ceil %x : f64
    %ro = math.round %y : f64
    %g2 = arith.addf %ce, %ro : f64
    %tr = math.trunc %x : f64
    %re = math.roundeven %y : f64
    %g3 = arith.addf %tr, %re : f64
    %g4 = arith.addf %g2, %g3 : f64
    %g5 = arith.mulf %g4, %y : f64
    %c1 = arith.constant 0.48 : f64
    %t1 = arith.mulf %c1, %g5 : f64
    %s1 = arith.addf %t0, %t1 : f64
    tai.atomic add %s1, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  tai.launch @around_zero() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @trigonometry() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @hyperbolic() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @exponentials() : () -> ()
  }
  tai.launch @above_one() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @roots_and_logarithms() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @powers() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @arithmetic() : () -> ()
  }
  tai.launch @apart() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @choices() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @y] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @rounding() : () -> ()
  }
  return
}
