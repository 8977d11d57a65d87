// RUN: not tai-run %s --debug 2>&1 | FileCheck %s --check-prefix=ABOVE
// RUN: sed -e "s/ogt/olt/; s/constant 0.0 : f64/constant 0.02 : f64/" %s > %t.below.mlir
// RUN: not tai-run %t.below.mlir --debug 2>&1 | FileCheck %s --check-prefix=BELOW
// RUN: sed -e 's/constant 0.0 : f64/constant 0.25 : f64/' %s > %t.first.mlir
// RUN: not tai-run %t.first.mlir --debug 2>&1 | FileCheck %s --check-prefix=FIRST
// RUN: sed -e 's/ogt/une/; s/constant 0.0 : f64/constant 9.0 : f64/' %s > %t.none.mlir
// RUN: tai-run %t.none.mlir --debug

// A program may fail in one of the evaluations of a checked gradient: in the
// first one, or where the differences move a value over a limit, in the one
// direction or in the other. It fails with its own message then.

// ABOVE: error: x is {{-0\.[0-9]+}}
// BELOW: error: x is {{0\.[0-9]+}}
// FIRST: error: x is 0.01
tai.tree @t : !tai.root<{x: f64, gx: f64}, {y: f64, gy: f64}>
tai.field @gx = @t["gx"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 0, adjoint @gx
tai.field @gy = @t["gy"] : f64, rank 0
tai.field @y = @t["y"] : f64, rank 0, adjoint @gy

tai.kernel @fill() {
  %c = arith.constant 0.01 : f64
  tai.store %c, @x[] : f64
  tai.return
}

tai.kernel @square() {
  %limit = arith.constant 0.0 : f64
  %v = tai.load @x[] : f64
  %is = arith.cmpf ogt, %v, %limit : f64
  tai.assert %is, "x is {}"(%v) : f64
  %q = arith.mulf %v, %v : f64
  tai.atomic add %q, @y[] : f64
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@y) wrt [@x] tolerance 1.0e-7 {
    tai.launch @square() : () -> ()
  }
  return
}
