// RUN: tai-opt %s --tai-autodiff | FileCheck %s

// Loops that compare without a sign, and need not be reversed.

tai.tree @t : !tai.root<dense<[i: 8], {x: f64}>, dense<[i: 8], {gx: f64}>, {l: f64}, {gl: f64}, {c: i32}>
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @l = @t["l"] : f64, rank 0, adjoint @gl
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @c = @t["c"] : i32, rank 0

// The adjoint needs one of the two values that the loop carries, and the loop
// still compares without a sign.
// CHECK-LABEL: tai.kernel @unsigned_grad(
//       CHECK:   scf.for unsigned %{{.+}} iter_args(%{{[^,]+}} = %{{.+}}) -> (i32)
tai.kernel @unsigned(%n: i32, %m: i32) {
  %c1 = arith.constant 1 : i32
  %c3 = arith.constant 3 : i32
  %r:2 = scf.for unsigned %j = %n to %m step %c1 iter_args(%a = %c1, %b = %c3) -> (i32, i32) : i32 {
    %u = arith.xori %a, %j : i32
    %v = arith.muli %b, %j : i32
    scf.yield %u, %v : i32, i32
  }
  tai.store %r#1, @c[] : i32
  %at = arith.index_cast %r#0 : i32 to index
  %v = tai.load @x[%at] : f64
  %w = arith.mulf %v, %v : f64
  %3 = tai.atomic add %w, @l[] : f64
  tai.return
}
