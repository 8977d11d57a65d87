// RUN: tai-opt %s --tai-make-adjoint | FileCheck %s

// Numbers that the gradient needs again: drawn in loops and branches, or outside of
// them; and sums of narrow adjoints.

!t = !tai.root<dense<[i: 16], {x: f64, x_grad: f64, y: f64, y_grad: f64, z: f64, z_grad: f64, n: i32}>, dense<[i: 8], {q: f16, q_grad: f32, p: f16, p_grad: f32}>, dense<[i: 8], {v: vector<2xf64>, v_grad: vector<2xf64>}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @y_grad = @t["y_grad"] : f64, rank 1
tai.field @z_grad = @t["z_grad"] : f64, rank 1
tai.field @q_grad = @t["q_grad"] : f32, rank 1
tai.field @p_grad = @t["p_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2xf64>, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f64, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f64, rank 1, adjoint @z_grad
tai.field @q = @t["q"] : f16, rank 1, adjoint @q_grad
tai.field @p = @t["p"] : f16, rank 1, adjoint @p_grad
tai.field @v = @t["v"] : vector<2xf64>, rank 1, adjoint @v_grad
tai.field @n = @t["n"] : i32, rank 1

// A draw in a serial loop is recorded, the one of a branch with it, and all that
// stand between are drawn again. The loop that nothing depends on is drawn too.
// CHECK-LABEL: tai.kernel @random_in_if_grad(
//       CHECK:   tai.stack_create
//       CHECK:   scf.for
//       CHECK:     tai.random
//       CHECK:     scf.if
//       CHECK:       tai.random
//       CHECK:   scf.for
//       CHECK:     tai.stack_pop
// CHECK-LABEL: tai.kernel @random_while_grad(
// CHECK-COUNT-2: tai.random
//       CHECK:   tai.stack_pop
tai.kernel @random_in_if(%c: i1, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    scf.for %k = %c0 to %n step %c1 {
      %u = tai.random stream 0 : f64
      %r = scf.if %c -> f64 {
        %v = tai.random stream 0 : f64
        %s = arith.mulf %u, %v : f64
        scf.yield %s : f64
      } else {
        scf.yield %u : f64
      }
      %t = arith.mulf %r, %r : f64
      %q = arith.mulf %t, %0 : f64
      tai.atomic add %q, @y[%i] : f64
    }
  }
  tai.return
}
tai.kernel @random_while(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %r:2 = scf.while (%k = %c0, %a = %0) : (index, f64) -> (index, f64) {
      %go = arith.cmpi slt, %k, %n : index
      scf.condition(%go) %k, %a : index, f64
    } do {
    ^bb0(%k: index, %a: f64):
      %u = tai.random stream 0 : f64
      %v = tai.random stream 0 : f64
      %p = arith.mulf %a, %u : f64
      %q = arith.mulf %p, %v : f64
      %next = arith.addi %k, %c1 : index
      scf.yield %next, %q : index, f64
    }
    %w = scf.while (%k = %c0) : (index) -> index {
      %go = arith.cmpi slt, %k, %n : index
      scf.condition(%go) %k : index
    } do {
    ^bb0(%k: index):
      %u = tai.random stream 0 : f64
      %next = arith.addi %k, %c1 : index
      scf.yield %next : index
    }
    tai.store %r#1, @y[%i] : f64
  }
  tai.return
}

// One that is drawn once, outside of all loops, is drawn once again.
// CHECK-LABEL: tai.kernel @random_outside_loops_grad(
// CHECK-COUNT-1: tai.random
//   CHECK-NOT:   tai.random
//   CHECK-NOT:   tai.stack
//       CHECK:   tai.return
tai.kernel @random_outside_loops() {
  %c0 = arith.constant 0 : index
  %u = tai.random stream 0 : f64
  %0 = tai.load @x[%c0] : f64
  %1 = arith.mulf %0, %u : f64
  %2 = arith.mulf %1, %u : f64
  tai.store %2, @y[%c0] : f64
  tai.return
}

// A branch without the second arm's operations is recomputed as a whole.
// CHECK-LABEL: func.func @region_recomputed_grad(
//       CHECK:   scf.if %{{.+}} -> (f64)
//       CHECK:   return
func.func @region_recomputed(%x: memref<4xf64>, %y: memref<4xf64>, %c: i1, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  %one = arith.constant 1.0 : f64
  %k = scf.if %c -> f64 {
    scf.yield %one : f64
  } else {
    %f = arith.index_cast %n : index to i64
    %g = arith.sitofp %f : i64 to f64
    scf.yield %g : f64
  }
  %1 = arith.mulf %0, %k : f64
  memref.store %1, %y[%c0] : memref<4xf64>
  return
}

// Two adjoints that were read from wider floats are added up in these.
// CHECK-LABEL: tai.kernel @half_sums_grad(
//       CHECK:   %[[A:.+]] = tai.load @p_grad[%{{.+}}] : f32
//       CHECK:   %[[B:.+]] = tai.load @p_grad[%{{.+}}] : f32
//       CHECK:   %[[SUM:.+]] = arith.addf %[[A]], %[[B]] : f32
//       CHECK:   tai.atomic add %[[SUM]], @q_grad[%{{.+}}] exclusive : f32
tai.kernel @half_sums() {
  tai.parallel_for (%i) in @q {
    %0 = tai.load @q[%i] : f16
    tai.store %0, @p[%i] : f16
    tai.atomic add %0, @p[%i] : f16
  }
  tai.return
}
