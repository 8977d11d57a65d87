// RUN: tai-run %s 2>&1 | FileCheck %s

// The square is kept in a field without adjoint: a warning says where. Values
// that the loss does not depend on are kept there without a word.

tai.tree @t : !tai.root<{x: f64, gx: f64, kept: f64, seen: f64, loss: f64, gloss: f64}>
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @kept = @t["kept"] : f64, rank 0
tai.field @seen = @t["seen"] : f64, rank 0
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gloss
tai.field @gloss = @t["gloss"] : f64, rank 0

tai.kernel @begin() {
  %c = arith.constant 3.0 : f64
  tai.store %c, @x[] : f64
  tai.return
}
tai.kernel @keep() {
  %0 = tai.load @x[] : f64
  %1 = arith.mulf %0, %0 : f64
  tai.store %0, @seen[] : f64
  // CHECK: warning: {{.*}}lost-gradient.mlir:[[@LINE+1]]:{{[0-9]+}}: kernel 'keep' stores to the field 'kept'
  tai.store %1, @kept[] : f64
  tai.return
}
tai.kernel @total() {
  %0 = tai.load @kept[] : f64
  %1 = tai.load @x[] : f64
  %2 = tai.load @seen[] : f64
  %3 = arith.addf %0, %1 : f64
  tai.atomic add %3, @loss[] : f64
  tai.store %2, @seen[] : f64
  tai.return
}

func.func @main() {
  tai.launch @begin() : () -> ()
  tai.tape loss(@loss) {
    tai.launch @keep() : () -> ()
    tai.launch @total() : () -> ()
  }
  // CHECK-NOT: warning
  %g = tai.load @gx[] : f64
  %one = arith.constant 1.0 : f64
  tai_check.close %g, %one tolerance 1.0e-15 : f64
  return
}
