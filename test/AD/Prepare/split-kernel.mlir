// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-split-kernel | FileCheck %s
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-split-kernel --tai-make-adjoint | FileCheck %s --check-prefix=GRAD

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>, {a: f32, a_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 0, adjoint @a_grad

// Each of two loops needs what x held before it. Shared values are computed in
// both; the last has the result.
// CHECK-LABEL: tai.kernel @twice(%{{.+}}: f32) -> f32
//       CHECK:   tai.parallel_for
//       CHECK:   tai.parallel_for
// CHECK-LABEL: tai.kernel @twice.0(
//  CHECK-SAME:     %[[S:.+]]: f32) attributes {part_of = @twice} {
//       CHECK:   arith.mulf %[[S]], %[[S]]
//       CHECK:   tai.parallel_for
//       CHECK:     math.sin
//   CHECK-NOT:   tai.parallel_for
//       CHECK:   tai.return
// CHECK-LABEL: tai.kernel @twice.1(
//  CHECK-SAME:     %[[S:.+]]: f32) -> f32 attributes {part_of = @twice} {
//       CHECK:   %[[SS:.+]] = arith.mulf %[[S]], %[[S]]
//       CHECK:   tai.parallel_for
//       CHECK:     math.exp
//       CHECK:   tai.return %[[SS]]
//
// GRAD-DAG: tai.kernel @twice.0_grad(%{{.+}}: f32) attributes {reads_before = [@x]}
// GRAD-DAG: tai.kernel @twice.1_grad(%{{.+}}: f32) attributes {guarded, reads_before = [@x]}
// GRAD-NOT: @twice_grad
tai.kernel @twice(%s: f32) -> f32 {
  %ss = arith.mulf %s, %s : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    %2 = arith.mulf %1, %ss : f32
    tai.store %2, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %2 = arith.mulf %1, %ss : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return %ss : f32
}

// Loops that agree stay together, and so does one loop that is run again.
// CHECK-LABEL: tai.kernel @agree
//   CHECK-NOT: @agree.0
// CHECK-LABEL: tai.kernel @alone
//   CHECK-NOT: @alone.0
// GRAD-DAG: tai.kernel @agree_grad() attributes {reads_before = [@x]}
// GRAD-DAG: tai.kernel @alone_grad() attributes {reads_before = [@x], reexecutes}
tai.kernel @agree() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @y[%i] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}
tai.kernel @alone() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    %3 = math.sin %2 : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32}>, {a: f32, a_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @a = @t["a"] : f32, rank 0, adjoint @a_grad

tai.kernel @read_early() {
  // expected-note @+2 {{store the new value to another element, or make two kernels}}
  // expected-error @+1 {{the gradient needs the loops of this kernel to be launched one by one, but the value read here is used by a later one}}
  %a = tai.load @a[] : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    %2 = arith.mulf %1, %a : f32
    tai.store %2, @x[%i] : f32
  }
  %double = arith.addf %a, %a : f32
  // expected-note @+1 {{overwritten here in between}}
  tai.store %double, @a[] : f32
  // expected-note @+1 {{used here}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %2 = arith.mulf %1, %a : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad

tai.kernel @carried() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  %one = arith.constant 1.0 : f32
  // expected-note @+2 {{store it to a field, or make two kernels}}
  // expected-error @+1 {{the gradient needs the loops of this kernel to be launched one by one, but a later one uses a value of this one}}
  %a = scf.for %i = %c0 to %c16 step %c1 iter_args(%p = %one) -> f32 {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
    %2 = arith.mulf %p, %0 : f32
    scf.yield %2 : f32
  }
  // expected-note @+1 {{used here}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %2 = arith.mulf %1, %a : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>, dense<[i: 4], {a: f32, a_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 1, adjoint @a_grad

// A value that several parts use, through another one, is computed by each. The
// last part alone returns, and is differentiated by what it returns.
// CHECK-LABEL: tai.kernel @results.0(
//  CHECK-SAME:     %[[S:.+]]: f32) attributes {gradients = array<i64: 0>, part_of = @results}
//       CHECK:   tai.load @a
//       CHECK:   tai.parallel_for
// CHECK-LABEL: tai.kernel @results.1(
//       CHECK:   tai.store %{{.+}}, @a
// CHECK-LABEL: tai.kernel @results.2(
//  CHECK-SAME:     -> f32 attributes {gradients = array<i64: 0, 1>, part_of = @results}
//       CHECK:   tai.parallel_for
//       CHECK:   tai.return %{{.+}} : f32
tai.kernel @results(%s: f32) -> f32 attributes {gradients = array<i64: 0, 1>} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %a = tai.load @a[%c0] : f32
  %b = arith.mulf %a, %s : f32
  %d = arith.mulf %b, %b : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    %2 = arith.mulf %1, %d : f32
    %3 = arith.mulf %2, %b : f32
    tai.store %3, @x[%i] : f32
  }
  tai.store %d, @a[%c1] : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    %2 = arith.mulf %1, %d : f32
    %3 = arith.mulf %2, %b : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return %d : f32
}

// -----

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>, dense<[i: 4], {a: f32, a_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 1, adjoint @a_grad

tai.kernel @result_overwritten() -> f32 {
  %c0 = arith.constant 0 : index
  // expected-note @+2 {{store the new value to another element, or make two kernels}}
  // expected-error @+1 {{the gradient needs the loops of this kernel to be launched one by one, but the value read here is used by a later one}}
  %a = tai.load @a[%c0] : f32
  %b = arith.mulf %a, %a : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  %z = arith.constant 0.0 : f32
  // expected-note @+1 {{overwritten here in between}}
  tai.store %z, @a[%c0] : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @x[%i] : f32
  }
  // expected-note @+1 {{used here}}
  tai.return %b : f32
}
