// RUN: not tai-run %s 2>&1 | FileCheck %s

// A gradient is asked of a field that has none.

tai.tree @t : !tai.root<{y: f64}>
tai.field @y = @t["y"] : f64, rank 0

tai.kernel @one() {
  %c = arith.constant 1.0 : f64
  tai.store %c, @y[] : f64
  tai.return
}

func.func @main() {
  // CHECK: no-adjoint.mlir:[[@LINE+1]]:{{[0-9]+}}: error: {{.*}}adjoint
  tai.tape loss(@y) {
    tai.launch @one() : () -> ()
  }
  return
}
