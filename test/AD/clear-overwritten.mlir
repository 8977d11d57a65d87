// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-clear-overwritten | FileCheck %s

!t = !tai.root<dense<[i: 16], {x: f32, y: f32, y_grad: f32, n: i32, v: vector<2xf32>, v_grad: vector<2xf32>}>>
tai.tree @t : !t
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @n = @t["n"] : i32, rank 1

// Conditions and indices stay; values, sums, output and results go.
// CHECK-LABEL: tai.kernel @mixed(%{{.*}}: i32) {
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x
//   CHECK-NOT:     @x
//       CHECK:     %[[N:.+]] = tai.load @n[%[[I]]]
//       CHECK:     scf.if
//       CHECK:       %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:       tai.store %[[ZERO]], @y_grad[%{{.+}}] : f32
//       CHECK:     %[[ZEROS:.+]] = arith.constant dense<0.0{{.*}}> : vector<2xf32>
//       CHECK:     tai.store %[[ZEROS]], @v_grad[%[[I]]] : vector<2xf32>
//   CHECK-NOT:   math.exp
//   CHECK-NOT:   tai.atomic
//   CHECK-NOT:   tai.print
//       CHECK:   tai.return{{$}}
tai.kernel @mixed(%t: i32) -> f32 {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %n = tai.load @n[%i] : i32
    %x = tai.load @x[%i] : f32
    %e = math.exp %x : f32
    %positive = arith.cmpi sgt, %n, %t : i32
    scf.if %positive {
      %next = arith.addi %i, %c1 : index
      tai.store %e, @y[%next] : f32
    }
    %pair = vector.broadcast %e : f32 to vector<2xf32>
    tai.store %pair, @v[%i] : vector<2xf32>
    %old = tai.atomic add %e, @y[%i] : f32
    tai.store %e, @x[%i] : f32
    tai.print "{}" (%e) : f32
  }
  %sum = arith.constant 1.0 : f32
  tai.return %sum : f32
}

// -----

!t = !tai.root<dense<[i: 16], {y: f32, y_grad: f32, count: i32}>>
tai.tree @t : !t
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @count = @t["count"] : i32, rank 1

tai.kernel @compact() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %value = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @y {
    // expected-error@+2 {{the gradient needs to know which elements were overwritten, and they depend on the result of this}}
    // expected-note@+1 {{store to another element}}
    %place = tai.atomic add %one, @count[%c0] : i32
    %at = arith.index_cast %place : i32 to index
    tai.store %value, @y[%at] : f32
  }
  tai.return
}
