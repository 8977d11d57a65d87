// RUN: not tai-run %s 2>&1 | FileCheck %s

// A gradient that cannot be computed is no gradient that is checked: the error
// names the loop.

tai.tree @t : !tai.root<dense<[i: 4], {x: f64, gx: f64}>, {y: f64, gy: f64}>
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @gy = @t["gy"] : f64, rank 0
tai.field @y = @t["y"] : f64, rank 0, adjoint @gy
tai.kernel @square() {
  // CHECK: [[@LINE+1]]:3: error: cannot reverse a serialized loop over a field
  tai.parallel_for (%i) in @x serialize {
    %v = tai.load @x[%i] : f64
    %q = arith.mulf %v, %v : f64
    tai.atomic add %q, @y[] : f64
  }
  tai.return
}
func.func @main() {
  tai_check.gradient loss(@y) wrt [@x] tolerance 1.0e-7 {
    tai.launch @square() : () -> ()
  }
  return
}
