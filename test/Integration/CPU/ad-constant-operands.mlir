// RUN: tai-run %s --no-cache

// Gradients of ops of several operands or results, of which one has a derivative,
// agree with central differences.

!m = vector<2x2xf64>
!u = vector<2xf64>
!w = vector<3xf64>
tai.tree @data : !tai.root<
    dense<[i: 4], {x: f64, x_grad: f64, z: f64, a: !m, a_grad: !m, b: !m, g: !u, g_grad: !u, h: !u, c: !w, c_grad: !w, e: !w}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @a_grad = @data["a_grad"] : !m, rank 1
tai.field @g_grad = @data["g_grad"] : !u, rank 1
tai.field @c_grad = @data["c_grad"] : !w, rank 1
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @a = @data["a"] : !m, rank 1, adjoint @a_grad
tai.field @g = @data["g"] : !u, rank 1, adjoint @g_grad
tai.field @c = @data["c"] : !w, rank 1, adjoint @c_grad
tai.field @z = @data["z"] : f64, rank 1
tai.field @b = @data["b"] : !m, rank 1
tai.field @h = @data["h"] : !u, rank 1
tai.field @e = @data["e"] : !w, rank 1
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %p = arith.constant 0.37 : f64
  %q = arith.constant 0.4 : f64
  %id = arith.constant dense<[[2.0, 0.3], [-0.2, 1.5]]> : !m
  tai.parallel_for (%i) in @x {
    %k = arith.index_cast %i : index to i32
    %f = arith.sitofp %k : i32 to f64
    %t0 = arith.mulf %f, %p : f64
    %t = arith.addf %t0, %q : f64
    %s = math.sin %t : f64
    %r = math.cos %t : f64
    %m = vector.from_elements %s, %r, %t, %q : !m
    %m2 = arith.addf %m, %id : !m
    %u = vector.from_elements %s, %t : !u
    %v = vector.from_elements %t, %r : !u
    %w = vector.from_elements %s, %r, %t : !w
    %y = vector.from_elements %t, %s, %q : !w
    tai.store %t, @x[%i] : f64
    tai.store %r, @z[%i] : f64
    tai.store %m2, @a[%i] : !m
    tai.store %m2, @b[%i] : !m
    tai.store %u, @g[%i] : !u
    tai.store %v, @h[%i] : !u
    tai.store %w, @c[%i] : !w
    tai.store %y, @e[%i] : !w
  }
  tai.return
}

tai.kernel @products() {
  %n = arith.constant dense<[0.3, -0.7, 1.1]> : !w
  %o = arith.constant dense<[[0.3, -0.7], [1.1, 0.4]]> : !m
  tai.parallel_for (%i) in @c {
    %c = tai.load @c[%i] : !w
    %e = tai.load @e[%i] : !w
    %left = tai.cross %c, %e : !w
    %right = tai.cross %e, %c : !w
    %square = arith.mulf %left, %left : !w
    %both = arith.addf %square, %right : !w
    %d = tai.dot %both, %n : !w
    %g = tai.load @g[%i] : !u
    %h = tai.load @h[%i] : !u
    %first = tai.outer %g, %h : (!u, !u) -> !m
    %second = tai.outer %h, %g : (!u, !u) -> !m
    %p = arith.mulf %first, %second : !m
    %q = arith.mulf %p, %o : !m
    %s = tai.sum %q : !m
    %all = arith.addf %d, %s : f64
    tai.atomic add %all, @loss[] : f64
  }
  tai.return
}

tai.kernel @solutions() {
  %o = arith.constant dense<[0.3, -0.7]> : !u
  tai.parallel_for (%i) in @g {
    %g = tai.load @g[%i] : !u
    %h = tai.load @h[%i] : !u
    %a = tai.load @a[%i] : !m
    %b = tai.load @b[%i] : !m
    %0 = tai.solve %b, %g : !m, !u
    %1 = tai.solve %a, %h : !m, !u
    %2 = arith.mulf %0, %1 : !u
    %3 = tai.dot %2, %o : !u
    tai.atomic add %3, @loss[] : f64
  }
  tai.return
}

// The stretch alone; the determinant of one number; one result of two.
tai.kernel @results() {
  %o = arith.constant dense<[[0.3, -0.7], [1.1, 0.4]]> : !m
  tai.parallel_for (%i) in @a {
    %a = tai.load @a[%i] : !m
    %x = tai.load @x[%i] : f64
    %r, %s = tai.polar %a : !m
    %p = arith.mulf %s, %o : !m
    %q = tai.sum %p : !m
    %one = vector.from_elements %x : vector<1x1xf64>
    %d = tai.determinant %one : vector<1x1xf64>
    %sin, %cos = math.sincos %x : f64
    %sin2, %cos2 = math.sincos %d : f64
    %t = arith.mulf %cos, %sin2 : f64
    %all = arith.addf %q, %t : f64
    tai.atomic add %all, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@c, @g] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @products() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a, @g] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @solutions() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a, @x] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @results() : () -> ()
  }
  return
}
