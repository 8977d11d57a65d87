// RUN: not tai-run %s 2>&1 | FileCheck %s

// A gradient that is wrong is found: the adjoint given with the kernel says
// 3 x^2 where the derivative of x^2 is 2 x.

tai.tree @t : !tai.root<dense<[i: 4], {x: f64, gx: f64}>, {y: f64, gy: f64}>
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @gy = @t["gy"] : f64, rank 0
tai.field @y = @t["y"] : f64, rank 0, adjoint @gy

tai.kernel @fill() {
  %c = arith.constant 0.7 : f64
  tai.parallel_for (%i) in @x {
    tai.store %c, @x[%i] : f64
  }
  tai.return
}

tai.kernel @squares() attributes {adjoint = @squares_by_hand} {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %q = arith.mulf %v, %v : f64
    %old = tai.atomic add %q, @y[] : f64
  }
  tai.return
}

tai.kernel @squares_by_hand() {
  %three = arith.constant 3.0 : f64
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %g = tai.load @gy[] : f64
    %q = arith.mulf %v, %v : f64
    %p = arith.mulf %q, %three : f64
    %s = arith.mulf %p, %g : f64
    %old = tai.atomic add %s, @gx[%i] : f64
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  // CHECK: [[@LINE+1]]:3: error: the gradient of 'y' by 'x' disagrees with central differences
  tai_check.gradient loss(@y) wrt [@x] tolerance 1.0e-7 {
    tai.launch @squares() : () -> ()
  }
  return
}
