// RUN: tai-run %s --no-cache

// The rules for scalar ops hold for vectors, component by component.

tai.tree @data : !tai.root<
    dense<[i: 24], {x: vector<3xf64>, x_grad: vector<3xf64>, y: vector<3xf64>, y_grad: vector<3xf64>}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : vector<3xf64>, rank 1
tai.field @x = @data["x"] : vector<3xf64>, rank 1, adjoint @x_grad
tai.field @y_grad = @data["y_grad"] : vector<3xf64>, rank 1
tai.field @y = @data["y"] : vector<3xf64>, rank 1, adjoint @y_grad
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
    %h = arith.constant 0.5 : f64
    %m0 = arith.addf %u, %v : f64
    %m = arith.mulf %m0, %h : f64
    %e = vector.from_elements %u, %v, %m : vector<3xf64>
    %f = vector.from_elements %m, %u, %v : vector<3xf64>
    tai.store %e, @x[%i] : vector<3xf64>
    tai.store %f, @y[%i] : vector<3xf64>
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
    %h = arith.constant 0.5 : f64
    %m0 = arith.addf %u, %v : f64
    %m = arith.mulf %m0, %h : f64
    %e = vector.from_elements %u, %v, %m : vector<3xf64>
    %f = vector.from_elements %m, %u, %v : vector<3xf64>
    tai.store %e, @x[%i] : vector<3xf64>
    tai.store %f, @y[%i] : vector<3xf64>
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
    %w = arith.subf %a, %f3 : f64
    %e = vector.from_elements %u, %u, %w : vector<3xf64>
    %f = vector.from_elements %v, %v, %v : vector<3xf64>
    tai.store %e, @x[%i] : vector<3xf64>
    tai.store %f, @y[%i] : vector<3xf64>
  }
  tai.return
}

tai.kernel @trigonometry() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_sin = math.sin %x : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_sin : vector<3xf64>
    %r_cos = math.cos %x : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %r_cos : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %r_tan = math.tan %x : vector<3xf64>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %r_tan : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %r_asin = math.asin %x : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %r_asin : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %r_acos = math.acos %x : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %r_acos : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %r_atan = math.atan %x : vector<3xf64>
    %c5 = arith.constant dense<[1.16, -0.580, -0.16]> : vector<3xf64>
    %t5 = arith.mulf %c5, %r_atan : vector<3xf64>
    %s5 = arith.addf %s4, %t5 : vector<3xf64>
    %sc, %cc = math.sincos %x : vector<3xf64>
    %scp = arith.mulf %sc, %cc : vector<3xf64>
    %c6 = arith.constant dense<[1.33, -0.665, -0.33]> : vector<3xf64>
    %t6 = arith.mulf %c6, %scp : vector<3xf64>
    %s6 = arith.addf %s5, %t6 : vector<3xf64>
    %sum = tai.sum %s6 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @hyperbolic() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_sinh = math.sinh %x : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_sinh : vector<3xf64>
    %r_cosh = math.cosh %x : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %r_cosh : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %r_tanh = math.tanh %x : vector<3xf64>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %r_tanh : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %r_asinh = math.asinh %x : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %r_asinh : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %r_atanh = math.atanh %x : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %r_atanh : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %sum = tai.sum %s4 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @exponentials() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_exp = math.exp %x : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_exp : vector<3xf64>
    %r_exp2 = math.exp2 %x : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %r_exp2 : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %r_expm1 = math.expm1 %x : vector<3xf64>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %r_expm1 : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %r_log1p = math.log1p %x : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %r_log1p : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %r_erf = math.erf %x : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %r_erf : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %r_erfc = math.erfc %x : vector<3xf64>
    %c5 = arith.constant dense<[1.16, -0.580, -0.16]> : vector<3xf64>
    %t5 = arith.mulf %c5, %r_erfc : vector<3xf64>
    %s5 = arith.addf %s4, %t5 : vector<3xf64>
    %sum = tai.sum %s5 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @roots_and_logarithms() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_sqrt = math.sqrt %x : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_sqrt : vector<3xf64>
    %r_rsqrt = math.rsqrt %x : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %r_rsqrt : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %r_cbrt = math.cbrt %x : vector<3xf64>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %r_cbrt : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %r_log = math.log %x : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %r_log : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %r_log2 = math.log2 %x : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %r_log2 : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %r_log10 = math.log10 %x : vector<3xf64>
    %c5 = arith.constant dense<[1.16, -0.580, -0.16]> : vector<3xf64>
    %t5 = arith.mulf %c5, %r_log10 : vector<3xf64>
    %s5 = arith.addf %s4, %t5 : vector<3xf64>
    %r_acosh = math.acosh %x : vector<3xf64>
    %c6 = arith.constant dense<[1.33, -0.665, -0.33]> : vector<3xf64>
    %t6 = arith.mulf %c6, %r_acosh : vector<3xf64>
    %s6 = arith.addf %s5, %t6 : vector<3xf64>
    %sum = tai.sum %s6 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @powers() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_powf = math.powf %x, %y : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_powf : vector<3xf64>
    %n3 = arith.constant dense<3> : vector<3xi32>
    %pi3 = math.fpowi %x, %n3 : vector<3xf64>, vector<3xi32>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %pi3 : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %nm2 = arith.constant dense<-2> : vector<3xi32>
    %pim2 = math.fpowi %y, %nm2 : vector<3xf64>, vector<3xi32>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %pim2 : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %e1 = arith.constant dense<1.7> : vector<3xf64>
    %pc = math.powf %x, %e1 : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %pc : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %e2 = arith.constant dense<0.6> : vector<3xf64>
    %pd = math.powf %e2, %y : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %pd : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %sum = tai.sum %s4 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @arithmetic() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_addf = arith.addf %x, %y : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_addf : vector<3xf64>
    %r_subf = arith.subf %x, %y : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %r_subf : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %r_mulf = arith.mulf %x, %y : vector<3xf64>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %r_mulf : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %r_divf = arith.divf %x, %y : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %r_divf : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %r_atan2 = math.atan2 %x, %y : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %r_atan2 : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %neg = arith.negf %y : vector<3xf64>
    %fm = math.fma %x, %y, %neg : vector<3xf64>
    %c5 = arith.constant dense<[1.16, -0.580, -0.16]> : vector<3xf64>
    %t5 = arith.mulf %c5, %fm : vector<3xf64>
    %s5 = arith.addf %s4, %t5 : vector<3xf64>
    %big = arith.constant dense<7.3> : vector<3xf64>
    %xb = arith.mulf %x, %big : vector<3xf64>
    %rem = arith.remf %xb, %y : vector<3xf64>
    %c6 = arith.constant dense<[1.33, -0.665, -0.33]> : vector<3xf64>
    %t6 = arith.mulf %c6, %rem : vector<3xf64>
    %s6 = arith.addf %s5, %t6 : vector<3xf64>
    %sum = tai.sum %s6 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @choices() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %r_maximumf = arith.maximumf %x, %y : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %r_maximumf : vector<3xf64>
    %r_minimumf = arith.minimumf %x, %y : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %r_minimumf : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %r_maxnumf = arith.maxnumf %x, %y : vector<3xf64>
    %c2 = arith.constant dense<[0.65, -0.325, 0.35]> : vector<3xf64>
    %t2 = arith.mulf %c2, %r_maxnumf : vector<3xf64>
    %s2 = arith.addf %s1, %t2 : vector<3xf64>
    %r_minnumf = arith.minnumf %x, %y : vector<3xf64>
    %c3 = arith.constant dense<[0.82, -0.410, 0.18]> : vector<3xf64>
    %t3 = arith.mulf %c3, %r_minnumf : vector<3xf64>
    %s3 = arith.addf %s2, %t3 : vector<3xf64>
    %lo = arith.constant dense<-0.4> : vector<3xf64>
    %cl = math.clampf %x to [%lo, %y] : vector<3xf64>
    %c4 = arith.constant dense<[0.99, -0.495, 0.01]> : vector<3xf64>
    %t4 = arith.mulf %c4, %cl : vector<3xf64>
    %s4 = arith.addf %s3, %t4 : vector<3xf64>
    %ab = math.absf %x : vector<3xf64>
    %c5 = arith.constant dense<[1.16, -0.580, -0.16]> : vector<3xf64>
    %t5 = arith.mulf %c5, %ab : vector<3xf64>
    %s5 = arith.addf %s4, %t5 : vector<3xf64>
    %cs = math.copysign %x, %y : vector<3xf64>
    %c6 = arith.constant dense<[1.33, -0.665, -0.33]> : vector<3xf64>
    %t6 = arith.mulf %c6, %cs : vector<3xf64>
    %s6 = arith.addf %s5, %t6 : vector<3xf64>
    %cond = arith.cmpf ogt, %x, %y : vector<3xf64>
    %sq = arith.mulf %y, %y : vector<3xf64>
    %sl = arith.select %cond, %x, %sq : vector<3xi1>, vector<3xf64>
    %c7 = arith.constant dense<[1.50, -0.750, -0.50]> : vector<3xf64>
    %t7 = arith.mulf %c7, %sl : vector<3xf64>
    %s7 = arith.addf %s6, %t7 : vector<3xf64>
    %sum = tai.sum %s7 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
  }
  tai.return
}

tai.kernel @rounding() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<3xf64>
    %y = tai.load @y[%i] : vector<3xf64>
    %fl = math.floor %x : vector<3xf64>
    %fi = arith.fptosi %y : vector<3xf64> to vector<3xi32>
    %ff = arith.sitofp %fi : vector<3xi32> to vector<3xf64>
    %g0 = arith.addf %fl, %ff : vector<3xf64>
    %g1 = arith.mulf %g0, %x : vector<3xf64>
    %c0 = arith.constant dense<[0.31, -0.155, 0.69]> : vector<3xf64>
    %t0 = arith.mulf %c0, %g1 : vector<3xf64>
    %ce = math.ceil %x : vector<3xf64>
    %ro = math.round %y : vector<3xf64>
    %g2 = arith.addf %ce, %ro : vector<3xf64>
    %tr = math.trunc %x : vector<3xf64>
    %re = math.roundeven %y : vector<3xf64>
    %g3 = arith.addf %tr, %re : vector<3xf64>
    %g4 = arith.addf %g2, %g3 : vector<3xf64>
    %g5 = arith.mulf %g4, %y : vector<3xf64>
    %c1 = arith.constant dense<[0.48, -0.240, 0.52]> : vector<3xf64>
    %t1 = arith.mulf %c1, %g5 : vector<3xf64>
    %s1 = arith.addf %t0, %t1 : vector<3xf64>
    %sum = tai.sum %s1 : vector<3xf64>
    tai.atomic add %sum, @loss[] : f64
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
