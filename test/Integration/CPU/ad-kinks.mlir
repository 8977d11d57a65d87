// RUN: tai-run %s --no-cache

// At kinks and singular points each derivative has one written value (see
// docs/reference/derivatives.md), and nothing that is not finite leaves a point where the
// loss does not depend on it. Written with the former names of checks, as
// programs outside of this tree are.

tai.tree @data : !tai.root<
    dense<[i: 8], {x: f64, x_grad: f64, y: f64, y_grad: f64,
                   v: vector<3xf64>, v_grad: vector<3xf64>,
                   m: vector<2x2xf64>, m_grad: vector<2x2xf64>,
                   n: vector<3x3xf64>, n_grad: vector<3x3xf64>}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @y_grad = @data["y_grad"] : f64, rank 1
tai.field @v_grad = @data["v_grad"] : vector<3xf64>, rank 1
tai.field @m_grad = @data["m_grad"] : vector<2x2xf64>, rank 1
tai.field @n_grad = @data["n_grad"] : vector<3x3xf64>, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @data["y"] : f64, rank 1, adjoint @y_grad
tai.field @v = @data["v"] : vector<3xf64>, rank 1, adjoint @v_grad
tai.field @m = @data["m"] : vector<2x2xf64>, rank 1, adjoint @m_grad
tai.field @n = @data["n"] : vector<3x3xf64>, rank 1, adjoint @n_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

// |x| at 0.
tai.kernel @abs() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = math.absf %x : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// x sqrt(x) at 0: the infinite derivative of the root meets a zero adjoint.
tai.kernel @x_root_x() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %s = math.sqrt %x : f64
  %r = arith.mulf %x, %s : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// A tie goes to the second operand.
tai.kernel @maximum() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = arith.maximumf %x, %y : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// A tie goes to the second operand.
tai.kernel @minimum() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = arith.minimumf %x, %y : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// max(x, 0) at 0: the constant wins. (The op commutes, and constants go second.)
tai.kernel @relu() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = arith.maximumf %x, %zero : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// max(0, x) written as a choice, which keeps its order: x wins.
tai.kernel @relu_second() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %c = arith.cmpf ogt, %zero, %x : f64
  %r = arith.select %c, %zero, %x : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// At both edges of a clamp the derivative is 1.
tai.kernel @clamp() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %one = arith.constant 1.0 : f64
  %r = math.clampf %x to [%zero, %one] : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// atan2 at the origin.
tai.kernel @arctangent() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = math.atan2 %x, %y : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// x^y: 0 by the base where y = 0, 0 by the exponent where x = 0, exact by the base where it is negative.
tai.kernel @power() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = math.powf %x, %y : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// The derivative by the base alone.
tai.kernel @power_of_negative() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %two = arith.constant 2.0 : f64
  %r = math.powf %x, %two : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// select(x > 0, sqrt(x), 0): the arm not taken is NaN, or has an infinite derivative.
tai.kernel @selected_root() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %c = arith.cmpf ogt, %x, %zero : f64
  %s = math.sqrt %x : f64
  %r = arith.select %c, %s, %zero : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// As above, times y: neither factor may hand NaN to the other.
tai.kernel @selected_product() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %c = arith.cmpf ogt, %x, %zero : f64
  %s = math.sqrt %x : f64
  %p = arith.mulf %s, %y : f64
  %q = math.sin %p : f64
  %r = arith.select %c, %q, %zero : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// The same as a branch.
tai.kernel @branch_root() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %c = arith.cmpf ogt, %x, %zero : f64
  %r = scf.if %c -> (f64) {
    %s = math.sqrt %x : f64
    %p = arith.mulf %s, %y : f64
    scf.yield %p : f64
  } else {
    scf.yield %zero : f64
  }
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// 1 / (1 + exp(-x)) far out: exp overflows, the value is 0 and so is the derivative.
tai.kernel @logistic() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %one = arith.constant 1.0 : f64
  %n = arith.negf %x : f64
  %e = math.exp %n : f64
  %d = arith.addf %one, %e : f64
  %r = arith.divf %one, %d : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// mod(5.5, 2) = x - y floor(x / y): 1, -2.
tai.kernel @floored_remainder() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %d = arith.divf %x, %y : f64
  %f = math.floor %d : f64
  %p = arith.mulf %y, %f : f64
  %r = arith.subf %x, %p : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// The truncated remainder: the same for positive numbers.
tai.kernel @remainder() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %r = arith.remf %x, %y : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// Floor and conversions to integers are constant.
tai.kernel @rounding() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %f = math.floor %x : f64
  %i = arith.fptosi %y : f64 to i32
  %g = arith.sitofp %i : i32 to f64
  %r = arith.mulf %f, %g : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// acos(1) under a select: infinite, unless the loss does not depend on it.
tai.kernel @masked_arccos() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %one = arith.constant 1.0 : f64
  %c = arith.cmpf olt, %x, %one : f64
  %a = math.acos %x : f64
  %r = arith.select %c, %a, %zero : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// x / y where x is selected away at y = 0.
tai.kernel @divided() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %x = tai.load @x[%c0] : f64
  %y = tai.load @y[%c0] : f64
  %c = arith.cmpf une, %y, %zero : f64
  %d = arith.divf %x, %y : f64
  %s = math.sin %d : f64
  %r = arith.select %c, %s, %zero : f64
  tai.atomic add %r, @loss[] : f64
  tai.return
}

// The norm at 0, and its direction: nothing.
tai.kernel @norms() {
  %c0 = arith.constant 0 : index
  %v = tai.load @v[%c0] : vector<3xf64>
  %l = tai.norm %v : vector<3xf64>
  tai.atomic add %l, @loss[] : f64
  tai.return
}

// R of the polar decomposition at F = I: dR01 = (0, 1/2, -1/2, 0), in two
// dimensions and in three.
tai.kernel @rotations() {
  %c0 = arith.constant 0 : index
  %m = tai.load @m[%c0] : vector<2x2xf64>
  %n = tai.load @n[%c0] : vector<3x3xf64>
  %r, %s = tai.polar %m : vector<2x2xf64>
  %q, %t = tai.polar %n : vector<3x3xf64>
  %a = vector.extract %r[0, 1] : f64 from vector<2x2xf64>
  %b = vector.extract %q[0, 1] : f64 from vector<3x3xf64>
  %l = arith.addf %a, %b : f64
  tai.atomic add %l, @loss[] : f64
  tai.return
}

// U V' of the singular value decomposition is the same rotation, though U and V
// have no derivative where singular values are equal.
tai.kernel @rotation_by_svd() {
  %c0 = arith.constant 0 : index
  %n = tai.load @n[%c0] : vector<3x3xf64>
  %u, %s, %v = tai.svd %n : vector<3x3xf64>
  %t = tai.transpose %v : vector<3x3xf64> -> vector<3x3xf64>
  %r = tai.matmul %u, %t : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
  %b = vector.extract %r[0, 1] : f64 from vector<3x3xf64>
  tai.atomic add %b, @loss[] : f64
  tai.return
}

// The sum of the singular values at I: the identity.
tai.kernel @sum_of_singular_values() {
  %c0 = arith.constant 0 : index
  %n = tai.load @n[%c0] : vector<3x3xf64>
  %u, %s, %v = tai.svd %n : vector<3x3xf64>
  %b = tai.trace %s : vector<3x3xf64>
  tai.atomic add %b, @loss[] : f64
  tai.return
}

// The corotated energy |F - R|^2 at rest, where every such simulation begins.
tai.kernel @corotated() {
  %c0 = arith.constant 0 : index
  %n = tai.load @n[%c0] : vector<3x3xf64>
  %r, %s = tai.polar %n : vector<3x3xf64>
  %d = arith.subf %n, %r : vector<3x3xf64>
  %e = tai.dot %d, %d : vector<3x3xf64>
  tai.atomic add %e, @loss[] : f64
  tai.return
}

// Fails unless the adjoint of n[0] is this matrix.
func.func private @expect_matrix(%expected: vector<3x3xf64>) {
  %c0 = arith.constant 0 : index
  %g = tai.load @n_grad[%c0] : vector<3x3xf64>
  %d = arith.subf %g, %expected : vector<3x3xf64>
  %zero = arith.constant 0.0 : f64
  %e00 = vector.extract %d[0, 0] : f64 from vector<3x3xf64>
  tai.check_close %e00, %zero tolerance 1.0e-15 : f64
  %e01 = vector.extract %d[0, 1] : f64 from vector<3x3xf64>
  tai.check_close %e01, %zero tolerance 1.0e-15 : f64
  %e02 = vector.extract %d[0, 2] : f64 from vector<3x3xf64>
  tai.check_close %e02, %zero tolerance 1.0e-15 : f64
  %e10 = vector.extract %d[1, 0] : f64 from vector<3x3xf64>
  tai.check_close %e10, %zero tolerance 1.0e-15 : f64
  %e11 = vector.extract %d[1, 1] : f64 from vector<3x3xf64>
  tai.check_close %e11, %zero tolerance 1.0e-15 : f64
  %e12 = vector.extract %d[1, 2] : f64 from vector<3x3xf64>
  tai.check_close %e12, %zero tolerance 1.0e-15 : f64
  %e20 = vector.extract %d[2, 0] : f64 from vector<3x3xf64>
  tai.check_close %e20, %zero tolerance 1.0e-15 : f64
  %e21 = vector.extract %d[2, 1] : f64 from vector<3x3xf64>
  tai.check_close %e21, %zero tolerance 1.0e-15 : f64
  %e22 = vector.extract %d[2, 2] : f64 from vector<3x3xf64>
  tai.check_close %e22, %zero tolerance 1.0e-15 : f64
  return
}

// Fails unless the adjoints of x[0] and y[0] are these.
func.func private @expect(%dx: f64, %dy: f64) {
  %c0 = arith.constant 0 : index
  %gx = tai.load @x_grad[%c0] : f64
  %gy = tai.load @y_grad[%c0] : f64
  tai.check_close %gx, %dx tolerance 0.0 : f64
  tai.check_close %gy, %dy tolerance 0.0 : f64
  return
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %x0 = arith.constant 0.0 : f64
  %y0 = arith.constant 0.0 : f64
  %dx0 = arith.constant 0.0 : f64
  %dy0 = arith.constant 0.0 : f64
  tai.store %x0, @x[%c0] : f64
  tai.store %y0, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @abs() : () -> ()
  }
  func.call @expect(%dx0, %dy0) : (f64, f64) -> ()

  %x1 = arith.constant -2.0 : f64
  %y1 = arith.constant 0.0 : f64
  %dx1 = arith.constant -1.0 : f64
  %dy1 = arith.constant 0.0 : f64
  tai.store %x1, @x[%c0] : f64
  tai.store %y1, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @abs() : () -> ()
  }
  func.call @expect(%dx1, %dy1) : (f64, f64) -> ()

  %x2 = arith.constant 0.0 : f64
  %y2 = arith.constant 0.0 : f64
  %dx2 = arith.constant 0.0 : f64
  %dy2 = arith.constant 0.0 : f64
  tai.store %x2, @x[%c0] : f64
  tai.store %y2, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @x_root_x() : () -> ()
  }
  func.call @expect(%dx2, %dy2) : (f64, f64) -> ()

  %x3 = arith.constant 1.0 : f64
  %y3 = arith.constant 1.0 : f64
  %dx3 = arith.constant 0.0 : f64
  %dy3 = arith.constant 1.0 : f64
  tai.store %x3, @x[%c0] : f64
  tai.store %y3, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @maximum() : () -> ()
  }
  func.call @expect(%dx3, %dy3) : (f64, f64) -> ()

  %x4 = arith.constant 2.0 : f64
  %y4 = arith.constant 1.0 : f64
  %dx4 = arith.constant 1.0 : f64
  %dy4 = arith.constant 0.0 : f64
  tai.store %x4, @x[%c0] : f64
  tai.store %y4, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @maximum() : () -> ()
  }
  func.call @expect(%dx4, %dy4) : (f64, f64) -> ()

  %x5 = arith.constant 1.0 : f64
  %y5 = arith.constant 1.0 : f64
  %dx5 = arith.constant 0.0 : f64
  %dy5 = arith.constant 1.0 : f64
  tai.store %x5, @x[%c0] : f64
  tai.store %y5, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @minimum() : () -> ()
  }
  func.call @expect(%dx5, %dy5) : (f64, f64) -> ()

  %x6 = arith.constant 2.0 : f64
  %y6 = arith.constant 1.0 : f64
  %dx6 = arith.constant 0.0 : f64
  %dy6 = arith.constant 1.0 : f64
  tai.store %x6, @x[%c0] : f64
  tai.store %y6, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @minimum() : () -> ()
  }
  func.call @expect(%dx6, %dy6) : (f64, f64) -> ()

  %x7 = arith.constant 0.0 : f64
  %y7 = arith.constant 0.0 : f64
  %dx7 = arith.constant 0.0 : f64
  %dy7 = arith.constant 0.0 : f64
  tai.store %x7, @x[%c0] : f64
  tai.store %y7, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @relu() : () -> ()
  }
  func.call @expect(%dx7, %dy7) : (f64, f64) -> ()

  %x8 = arith.constant 0.0 : f64
  %y8 = arith.constant 0.0 : f64
  %dx8 = arith.constant 1.0 : f64
  %dy8 = arith.constant 0.0 : f64
  tai.store %x8, @x[%c0] : f64
  tai.store %y8, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @relu_second() : () -> ()
  }
  func.call @expect(%dx8, %dy8) : (f64, f64) -> ()

  %x9 = arith.constant 0.0 : f64
  %y9 = arith.constant 0.0 : f64
  %dx9 = arith.constant 1.0 : f64
  %dy9 = arith.constant 0.0 : f64
  tai.store %x9, @x[%c0] : f64
  tai.store %y9, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @clamp() : () -> ()
  }
  func.call @expect(%dx9, %dy9) : (f64, f64) -> ()

  %x10 = arith.constant 1.0 : f64
  %y10 = arith.constant 0.0 : f64
  %dx10 = arith.constant 1.0 : f64
  %dy10 = arith.constant 0.0 : f64
  tai.store %x10, @x[%c0] : f64
  tai.store %y10, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @clamp() : () -> ()
  }
  func.call @expect(%dx10, %dy10) : (f64, f64) -> ()

  %x11 = arith.constant -0.5 : f64
  %y11 = arith.constant 0.0 : f64
  %dx11 = arith.constant 0.0 : f64
  %dy11 = arith.constant 0.0 : f64
  tai.store %x11, @x[%c0] : f64
  tai.store %y11, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @clamp() : () -> ()
  }
  func.call @expect(%dx11, %dy11) : (f64, f64) -> ()

  %x12 = arith.constant 1.5 : f64
  %y12 = arith.constant 0.0 : f64
  %dx12 = arith.constant 0.0 : f64
  %dy12 = arith.constant 0.0 : f64
  tai.store %x12, @x[%c0] : f64
  tai.store %y12, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @clamp() : () -> ()
  }
  func.call @expect(%dx12, %dy12) : (f64, f64) -> ()

  %x13 = arith.constant 0.0 : f64
  %y13 = arith.constant 0.0 : f64
  %dx13 = arith.constant 0.0 : f64
  %dy13 = arith.constant 0.0 : f64
  tai.store %x13, @x[%c0] : f64
  tai.store %y13, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @arctangent() : () -> ()
  }
  func.call @expect(%dx13, %dy13) : (f64, f64) -> ()

  %x14 = arith.constant 1.0 : f64
  %y14 = arith.constant 0.0 : f64
  %dx14 = arith.constant 0.0 : f64
  %dy14 = arith.constant -1.0 : f64
  tai.store %x14, @x[%c0] : f64
  tai.store %y14, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @arctangent() : () -> ()
  }
  func.call @expect(%dx14, %dy14) : (f64, f64) -> ()

  %x15 = arith.constant 0.0 : f64
  %y15 = arith.constant 0.0 : f64
  %dx15 = arith.constant 0.0 : f64
  %dy15 = arith.constant 0.0 : f64
  tai.store %x15, @x[%c0] : f64
  tai.store %y15, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @power() : () -> ()
  }
  func.call @expect(%dx15, %dy15) : (f64, f64) -> ()

  %x16 = arith.constant 0.0 : f64
  %y16 = arith.constant 2.0 : f64
  %dx16 = arith.constant 0.0 : f64
  %dy16 = arith.constant 0.0 : f64
  tai.store %x16, @x[%c0] : f64
  tai.store %y16, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @power() : () -> ()
  }
  func.call @expect(%dx16, %dy16) : (f64, f64) -> ()

  %x17 = arith.constant 0.0 : f64
  %y17 = arith.constant 1.0 : f64
  %dx17 = arith.constant 1.0 : f64
  %dy17 = arith.constant 0.0 : f64
  tai.store %x17, @x[%c0] : f64
  tai.store %y17, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @power() : () -> ()
  }
  func.call @expect(%dx17, %dy17) : (f64, f64) -> ()

  %x18 = arith.constant -2.0 : f64
  %y18 = arith.constant 0.0 : f64
  %dx18 = arith.constant -4.0 : f64
  %dy18 = arith.constant 0.0 : f64
  tai.store %x18, @x[%c0] : f64
  tai.store %y18, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @power_of_negative() : () -> ()
  }
  func.call @expect(%dx18, %dy18) : (f64, f64) -> ()

  %x19 = arith.constant -1.0 : f64
  %y19 = arith.constant 0.0 : f64
  %dx19 = arith.constant 0.0 : f64
  %dy19 = arith.constant 0.0 : f64
  tai.store %x19, @x[%c0] : f64
  tai.store %y19, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @selected_root() : () -> ()
  }
  func.call @expect(%dx19, %dy19) : (f64, f64) -> ()

  %x20 = arith.constant 0.0 : f64
  %y20 = arith.constant 0.0 : f64
  %dx20 = arith.constant 0.0 : f64
  %dy20 = arith.constant 0.0 : f64
  tai.store %x20, @x[%c0] : f64
  tai.store %y20, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @selected_root() : () -> ()
  }
  func.call @expect(%dx20, %dy20) : (f64, f64) -> ()

  %x21 = arith.constant 4.0 : f64
  %y21 = arith.constant 0.0 : f64
  %dx21 = arith.constant 0.25 : f64
  %dy21 = arith.constant 0.0 : f64
  tai.store %x21, @x[%c0] : f64
  tai.store %y21, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @selected_root() : () -> ()
  }
  func.call @expect(%dx21, %dy21) : (f64, f64) -> ()

  %x22 = arith.constant -1.0 : f64
  %y22 = arith.constant 3.0 : f64
  %dx22 = arith.constant 0.0 : f64
  %dy22 = arith.constant 0.0 : f64
  tai.store %x22, @x[%c0] : f64
  tai.store %y22, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @selected_product() : () -> ()
  }
  func.call @expect(%dx22, %dy22) : (f64, f64) -> ()

  %x23 = arith.constant -1.0 : f64
  %y23 = arith.constant 3.0 : f64
  %dx23 = arith.constant 0.0 : f64
  %dy23 = arith.constant 0.0 : f64
  tai.store %x23, @x[%c0] : f64
  tai.store %y23, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @branch_root() : () -> ()
  }
  func.call @expect(%dx23, %dy23) : (f64, f64) -> ()

  %x24 = arith.constant 4.0 : f64
  %y24 = arith.constant 3.0 : f64
  %dx24 = arith.constant 0.75 : f64
  %dy24 = arith.constant 2.0 : f64
  tai.store %x24, @x[%c0] : f64
  tai.store %y24, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @branch_root() : () -> ()
  }
  func.call @expect(%dx24, %dy24) : (f64, f64) -> ()

  %x25 = arith.constant -800.0 : f64
  %y25 = arith.constant 0.0 : f64
  %dx25 = arith.constant 0.0 : f64
  %dy25 = arith.constant 0.0 : f64
  tai.store %x25, @x[%c0] : f64
  tai.store %y25, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @logistic() : () -> ()
  }
  func.call @expect(%dx25, %dy25) : (f64, f64) -> ()

  %x26 = arith.constant 5.5 : f64
  %y26 = arith.constant 2.0 : f64
  %dx26 = arith.constant 1.0 : f64
  %dy26 = arith.constant -2.0 : f64
  tai.store %x26, @x[%c0] : f64
  tai.store %y26, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @floored_remainder() : () -> ()
  }
  func.call @expect(%dx26, %dy26) : (f64, f64) -> ()

  %x27 = arith.constant 5.5 : f64
  %y27 = arith.constant 2.0 : f64
  %dx27 = arith.constant 1.0 : f64
  %dy27 = arith.constant -2.0 : f64
  tai.store %x27, @x[%c0] : f64
  tai.store %y27, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @remainder() : () -> ()
  }
  func.call @expect(%dx27, %dy27) : (f64, f64) -> ()

  %x28 = arith.constant -5.5 : f64
  %y28 = arith.constant 2.0 : f64
  %dx28 = arith.constant 1.0 : f64
  %dy28 = arith.constant 2.0 : f64
  tai.store %x28, @x[%c0] : f64
  tai.store %y28, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @remainder() : () -> ()
  }
  func.call @expect(%dx28, %dy28) : (f64, f64) -> ()

  %x29 = arith.constant 2.0 : f64
  %y29 = arith.constant 3.0 : f64
  %dx29 = arith.constant 0.0 : f64
  %dy29 = arith.constant 0.0 : f64
  tai.store %x29, @x[%c0] : f64
  tai.store %y29, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @rounding() : () -> ()
  }
  func.call @expect(%dx29, %dy29) : (f64, f64) -> ()

  %x30 = arith.constant 1.0 : f64
  %y30 = arith.constant 0.0 : f64
  %dx30 = arith.constant 0.0 : f64
  %dy30 = arith.constant 0.0 : f64
  tai.store %x30, @x[%c0] : f64
  tai.store %y30, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @masked_arccos() : () -> ()
  }
  func.call @expect(%dx30, %dy30) : (f64, f64) -> ()

  %x31 = arith.constant 1.0 : f64
  %y31 = arith.constant 0.0 : f64
  %dx31 = arith.constant 0.0 : f64
  %dy31 = arith.constant 0.0 : f64
  tai.store %x31, @x[%c0] : f64
  tai.store %y31, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @divided() : () -> ()
  }
  func.call @expect(%dx31, %dy31) : (f64, f64) -> ()

  %x32 = arith.constant 0.0 : f64
  %y32 = arith.constant 2.0 : f64
  %dx32 = arith.constant 0.5 : f64
  %dy32 = arith.constant -0.0 : f64
  tai.store %x32, @x[%c0] : f64
  tai.store %y32, @y[%c0] : f64
  tai.tape loss(@loss) {
    tai.launch @divided() : () -> ()
  }
  func.call @expect(%dx32, %dy32) : (f64, f64) -> ()

  %origin = arith.constant dense<0.0> : vector<3xf64>
  tai.store %origin, @v[%c0] : vector<3xf64>
  tai.tape loss(@loss) {
    tai.launch @norms() : () -> ()
  }
  %zero = arith.constant 0.0 : f64
  %g = tai.load @v_grad[%c0] : vector<3xf64>
  %g0 = vector.extract %g[0] : f64 from vector<3xf64>
  %g1 = vector.extract %g[1] : f64 from vector<3xf64>
  %g2 = vector.extract %g[2] : f64 from vector<3xf64>
  tai.check_close %g0, %zero tolerance 0.0 : f64
  tai.check_close %g1, %zero tolerance 0.0 : f64
  tai.check_close %g2, %zero tolerance 0.0 : f64

  %i2 = arith.constant dense<[[1.0, 0.0], [0.0, 1.0]]> : vector<2x2xf64>
  %i3 = arith.constant dense<[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]> : vector<3x3xf64>
  %turn = arith.constant dense<[[0.0, 0.5, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]> : vector<3x3xf64>
  %none = arith.constant dense<0.0> : vector<3x3xf64>
  tai.store %i2, @m[%c0] : vector<2x2xf64>
  tai.store %i3, @n[%c0] : vector<3x3xf64>
  tai.tape loss(@loss) {
    tai.launch @rotations() : () -> ()
  }
  func.call @expect_matrix(%turn) : (vector<3x3xf64>) -> ()
  %half = arith.constant 0.5 : f64
  %minus = arith.constant -0.5 : f64
  %h = tai.load @m_grad[%c0] : vector<2x2xf64>
  %h00 = vector.extract %h[0, 0] : f64 from vector<2x2xf64>
  %h01 = vector.extract %h[0, 1] : f64 from vector<2x2xf64>
  %h10 = vector.extract %h[1, 0] : f64 from vector<2x2xf64>
  %h11 = vector.extract %h[1, 1] : f64 from vector<2x2xf64>
  tai.check_close %h00, %zero tolerance 1.0e-15 : f64
  tai.check_close %h01, %half tolerance 1.0e-15 : f64
  tai.check_close %h10, %minus tolerance 1.0e-15 : f64
  tai.check_close %h11, %zero tolerance 1.0e-15 : f64
  tai.tape loss(@loss) {
    tai.launch @rotation_by_svd() : () -> ()
  }
  func.call @expect_matrix(%turn) : (vector<3x3xf64>) -> ()
  tai.tape loss(@loss) {
    tai.launch @sum_of_singular_values() : () -> ()
  }
  func.call @expect_matrix(%i3) : (vector<3x3xf64>) -> ()
  tai.tape loss(@loss) {
    tai.launch @corotated() : () -> ()
  }
  func.call @expect_matrix(%none) : (vector<3x3xf64>) -> ()
  return
}
