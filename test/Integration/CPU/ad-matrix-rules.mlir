// RUN: tai-run %s --no-cache

// The rules of the small-matrix ops agree with central differences. Each kernel
// takes matrices near a well-conditioned one, of 2, 3 or 4 rows.

tai.tree @data : !tai.root<
    dense<[i: 6], {a2: vector<2x2xf64>, a2_grad: vector<2x2xf64>,
                   a3: vector<3x3xf64>, a3_grad: vector<3x3xf64>,
                   a4: vector<4x4xf64>, a4_grad: vector<4x4xf64>,
                   r: vector<2x3xf64>, r_grad: vector<2x3xf64>,
                   u: vector<3xf64>, u_grad: vector<3xf64>,
                   v: vector<3xf64>, v_grad: vector<3xf64>}>,
    {loss: f64, loss_grad: f64}>
tai.field @a2_grad = @data["a2_grad"] : vector<2x2xf64>, rank 1
tai.field @a3_grad = @data["a3_grad"] : vector<3x3xf64>, rank 1
tai.field @a4_grad = @data["a4_grad"] : vector<4x4xf64>, rank 1
tai.field @r_grad = @data["r_grad"] : vector<2x3xf64>, rank 1
tai.field @u_grad = @data["u_grad"] : vector<3xf64>, rank 1
tai.field @v_grad = @data["v_grad"] : vector<3xf64>, rank 1
tai.field @a2 = @data["a2"] : vector<2x2xf64>, rank 1, adjoint @a2_grad
tai.field @a3 = @data["a3"] : vector<3x3xf64>, rank 1, adjoint @a3_grad
tai.field @a4 = @data["a4"] : vector<4x4xf64>, rank 1, adjoint @a4_grad
tai.field @r = @data["r"] : vector<2x3xf64>, rank 1, adjoint @r_grad
tai.field @u = @data["u"] : vector<3xf64>, rank 1, adjoint @u_grad
tai.field @v = @data["v"] : vector<3xf64>, rank 1, adjoint @v_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

// 0.4 sin(7 k + 3 i) + offset
func.func private @entry(%i: index, %k: f64, %offset: f64) -> f64 {
  %seven = arith.constant 7.0 : f64
  %three = arith.constant 3.0 : f64
  %scale = arith.constant 0.4 : f64
  %n = arith.index_cast %i : index to i32
  %x = arith.sitofp %n : i32 to f64
  %a = arith.mulf %x, %three : f64
  %b = arith.mulf %k, %seven : f64
  %c = arith.addf %a, %b : f64
  %s = math.sin %c : f64
  %t = arith.mulf %s, %scale : f64
  %r = arith.addf %t, %offset : f64
  return %r : f64
}

// Fills matrices near diag(3, 1.2, 2) or so, and vectors.
tai.kernel @fill() {
  %zero = arith.constant 0.0 : f64
  %d0 = arith.constant 3.0 : f64
  %d1 = arith.constant 1.2 : f64
  %d2 = arith.constant 2.0 : f64
  %k0 = arith.constant 0.0 : f64
  %k1 = arith.constant 1.0 : f64
  %k2 = arith.constant 2.0 : f64
  %k3 = arith.constant 3.0 : f64
  %k4 = arith.constant 4.0 : f64
  %k5 = arith.constant 5.0 : f64
  tai.parallel_for (%i) in @a2 {
    %e0 = func.call @entry(%i, %k0, %d0) : (index, f64, f64) -> f64
    %e1 = func.call @entry(%i, %k1, %zero) : (index, f64, f64) -> f64
    %e2 = func.call @entry(%i, %k2, %zero) : (index, f64, f64) -> f64
    %e3 = func.call @entry(%i, %k3, %d1) : (index, f64, f64) -> f64
    %e4 = func.call @entry(%i, %k4, %zero) : (index, f64, f64) -> f64
    %e5 = func.call @entry(%i, %k5, %d2) : (index, f64, f64) -> f64
    %m2 = vector.from_elements %e0, %e1, %e2, %e3 : vector<2x2xf64>
    %m3 = vector.from_elements %e0, %e1, %e2, %e4, %e3, %e1, %e2, %e4, %e5 : vector<3x3xf64>
    %m4 = vector.from_elements %e0, %e1, %e2, %e4, %e4, %e3, %e1, %e2, %e2, %e4, %e5, %e1, %e1, %e2, %e4, %e5 : vector<4x4xf64>
    %mr = vector.from_elements %e0, %e1, %e2, %e3, %e4, %e5 : vector<2x3xf64>
    %mu = vector.from_elements %e1, %e3, %e5 : vector<3xf64>
    %mv = vector.from_elements %e0, %e4, %e2 : vector<3xf64>
    tai.store %m2, @a2[%i] : vector<2x2xf64>
    tai.store %m3, @a3[%i] : vector<3x3xf64>
    tai.store %m4, @a4[%i] : vector<4x4xf64>
    tai.store %mr, @r[%i] : vector<2x3xf64>
    tai.store %mu, @u[%i] : vector<3xf64>
    tai.store %mv, @v[%i] : vector<3xf64>
  }
  tai.return
}

tai.kernel @products() {
  %w = arith.constant dense<[[0.3, -0.7, 1.1], [0.9, 0.2, -0.4], [-1.3, 0.8, 0.5]]> : vector<3x3xf64>
  tai.parallel_for (%i) in @a3 {
    %a = tai.load @a3[%i] : vector<3x3xf64>
    %r = tai.load @r[%i] : vector<2x3xf64>
    %u = tai.load @u[%i] : vector<3xf64>
    %v = tai.load @v[%i] : vector<3xf64>
    %ra = tai.matmul %r, %a : (vector<2x3xf64>, vector<3x3xf64>) -> vector<2x3xf64>
    %rt = tai.transpose %ra : vector<2x3xf64> -> vector<3x2xf64>
    %rr = tai.matmul %rt, %r : (vector<3x2xf64>, vector<2x3xf64>) -> vector<3x3xf64>
    %l0 = tai.dot %rr, %w : vector<3x3xf64>
    %au = tai.matmul %a, %u : (vector<3x3xf64>, vector<3xf64>) -> vector<3xf64>
    %c = tai.cross %au, %v : vector<3xf64>
    %o = tai.outer %c, %u : (vector<3xf64>, vector<3xf64>) -> vector<3x3xf64>
    %ow = arith.mulf %o, %w : vector<3x3xf64>
    %l1 = tai.sum %ow : vector<3x3xf64>
    %l2 = tai.norm %c : vector<3xf64>
    %l3 = tai.trace %a : vector<3x3xf64>
    %l4 = arith.mulf %l2, %l3 : f64
    %s0 = arith.addf %l0, %l1 : f64
    %s1 = arith.addf %s0, %l4 : f64
    tai.atomic add %s1, @loss[] : f64
  }
  tai.return
}

tai.kernel @determinants() {
  tai.parallel_for (%i) in @a3 {
    %a = tai.load @a2[%i] : vector<2x2xf64>
    %b = tai.load @a3[%i] : vector<3x3xf64>
    %c = tai.load @a4[%i] : vector<4x4xf64>
    %l0 = tai.determinant %a : vector<2x2xf64>
    %l1 = tai.determinant %b : vector<3x3xf64>
    %l2 = tai.determinant %c : vector<4x4xf64>
    %s0 = arith.mulf %l0, %l1 : f64
    %s1 = arith.addf %s0, %l2 : f64
    tai.atomic add %s1, @loss[] : f64
  }
  tai.return
}

tai.kernel @inverses() {
  %w2 = arith.constant dense<[[0.3, -0.7], [0.9, 0.2]]> : vector<2x2xf64>
  %w3 = arith.constant dense<[[0.3, -0.7, 1.1], [0.9, 0.2, -0.4], [-1.3, 0.8, 0.5]]> : vector<3x3xf64>
  tai.parallel_for (%i) in @a3 {
    %a = tai.load @a2[%i] : vector<2x2xf64>
    %b = tai.load @a3[%i] : vector<3x3xf64>
    %u = tai.load @u[%i] : vector<3xf64>
    %v = tai.load @v[%i] : vector<3xf64>
    %ai = tai.inverse %a : vector<2x2xf64>
    %bi = tai.inverse %b : vector<3x3xf64>
    %x = tai.solve %b, %u : vector<3x3xf64>, vector<3xf64>
    %l0 = tai.dot %ai, %w2 : vector<2x2xf64>
    %l1 = tai.dot %bi, %w3 : vector<3x3xf64>
    %l2 = tai.dot %x, %v : vector<3xf64>
    %s0 = arith.addf %l0, %l1 : f64
    %s1 = arith.addf %s0, %l2 : f64
    tai.atomic add %s1, @loss[] : f64
  }
  tai.return
}

// Both factors of the polar decomposition, with different weights.
tai.kernel @polars() {
  %w2 = arith.constant dense<[[0.3, -0.7], [0.9, 0.2]]> : vector<2x2xf64>
  %w3 = arith.constant dense<[[0.3, -0.7, 1.1], [0.9, 0.2, -0.4], [-1.3, 0.8, 0.5]]> : vector<3x3xf64>
  tai.parallel_for (%i) in @a3 {
    %a = tai.load @a2[%i] : vector<2x2xf64>
    %b = tai.load @a3[%i] : vector<3x3xf64>
    %r2, %s2 = tai.polar %a : vector<2x2xf64>
    %r3, %s3 = tai.polar %b : vector<3x3xf64>
    %p2 = arith.mulf %s2, %r2 : vector<2x2xf64>
    %p3 = arith.mulf %s3, %r3 : vector<3x3xf64>
    %q2 = arith.addf %p2, %r2 : vector<2x2xf64>
    %q3 = arith.addf %p3, %r3 : vector<3x3xf64>
    %l0 = tai.dot %q2, %w2 : vector<2x2xf64>
    %l1 = tai.dot %q3, %w3 : vector<3x3xf64>
    %s0 = arith.addf %l0, %l1 : f64
    tai.atomic add %s0, @loss[] : f64
  }
  tai.return
}

// All three factors; signs of singular vectors cancel in the products.
tai.kernel @singular_values() {
  %w2 = arith.constant dense<[[0.3, -0.7], [0.9, 0.2]]> : vector<2x2xf64>
  %w3 = arith.constant dense<[[0.3, -0.7, 1.1], [0.9, 0.2, -0.4], [-1.3, 0.8, 0.5]]> : vector<3x3xf64>
  tai.parallel_for (%i) in @a3 {
    %a = tai.load @a2[%i] : vector<2x2xf64>
    %b = tai.load @a3[%i] : vector<3x3xf64>
    %u2, %s2, %v2 = tai.svd %a : vector<2x2xf64>
    %u3, %s3, %v3 = tai.svd %b : vector<3x3xf64>
    %uu2 = arith.mulf %u2, %u2 : vector<2x2xf64>
    %uv2 = arith.mulf %u2, %v2 : vector<2x2xf64>
    %x2 = arith.addf %uu2, %uv2 : vector<2x2xf64>
    %y2 = arith.addf %x2, %s2 : vector<2x2xf64>
    %uu3 = arith.mulf %u3, %u3 : vector<3x3xf64>
    %vv3 = arith.mulf %v3, %v3 : vector<3x3xf64>
    %vw3 = arith.mulf %vv3, %w3 : vector<3x3xf64>
    %uv3 = arith.mulf %u3, %v3 : vector<3x3xf64>
    %x3 = arith.addf %uu3, %uv3 : vector<3x3xf64>
    %z3 = arith.addf %x3, %vw3 : vector<3x3xf64>
    %ss3 = arith.mulf %s3, %s3 : vector<3x3xf64>
    %y3 = arith.addf %z3, %ss3 : vector<3x3xf64>
    %l0 = tai.dot %y2, %w2 : vector<2x2xf64>
    %l1 = tai.dot %y3, %w3 : vector<3x3xf64>
    %s0 = arith.addf %l0, %l1 : f64
    tai.atomic add %s0, @loss[] : f64
  }
  tai.return
}

tai.kernel @eigenvalues() {
  %w = arith.constant dense<[[0.3, -0.7, 1.1], [0.9, 0.2, -0.4], [-1.3, 0.8, 0.5]]> : vector<3x3xf64>
  %c = arith.constant dense<[0.8, -0.3, 1.9]> : vector<3xf64>
  %w2 = arith.constant dense<[[0.3, -0.7], [0.9, 0.2]]> : vector<2x2xf64>
  %c2 = arith.constant dense<[0.8, -0.3]> : vector<2xf64>
  tai.parallel_for (%i) in @a3 {
    %a = tai.load @a3[%i] : vector<3x3xf64>
    %l, %q = tai.sym_eig %a : vector<3x3xf64> -> vector<3xf64>
    %qq = arith.mulf %q, %q : vector<3x3xf64>
    %l0 = tai.dot %qq, %w : vector<3x3xf64>
    %ll = arith.mulf %l, %l : vector<3xf64>
    %l1 = tai.dot %ll, %c : vector<3xf64>
    %b = tai.load @a2[%i] : vector<2x2xf64>
    %m, %p = tai.sym_eig %b : vector<2x2xf64> -> vector<2xf64>
    %pp = arith.mulf %p, %p : vector<2x2xf64>
    %l2 = tai.dot %pp, %w2 : vector<2x2xf64>
    %l3 = tai.dot %m, %c2 : vector<2xf64>
    %s0 = arith.addf %l0, %l1 : f64
    %s1 = arith.addf %l2, %l3 : f64
    %s2 = arith.addf %s0, %s1 : f64
    tai.atomic add %s2, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@a3, @r, @u, @v] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @products() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a2, @a3, @a4] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @determinants() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a2, @a3, @u, @v] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @inverses() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a2, @a3] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @polars() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a2, @a3] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @singular_values() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@a2, @a3] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @eigenvalues() : () -> ()
  }
  return
}
