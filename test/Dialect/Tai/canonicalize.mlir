// RUN: tai-opt %s --canonicalize --cse --split-input-file | FileCheck %s

// The transpose of a transpose is the matrix.
// CHECK-LABEL: tai.kernel @transpose_twice(
// CHECK-SAME:      %[[A:.+]]: vector<2x3xf32>)
//       CHECK:   tai.return %[[A]]
tai.kernel @transpose_twice(%a: vector<2x3xf32>) -> vector<2x3xf32> {
  %0 = tai.transpose %a : vector<2x3xf32> -> vector<3x2xf32>
  %1 = tai.transpose %0 : vector<3x2xf32> -> vector<2x3xf32>
  tai.return %1 : vector<2x3xf32>
}

// -----

// One transpose stays.
// CHECK-LABEL: tai.kernel @transpose_once(
//       CHECK:   tai.transpose
tai.kernel @transpose_once(%a: vector<2x3xf32>) -> vector<3x2xf32> {
  %0 = tai.transpose %a : vector<2x3xf32> -> vector<3x2xf32>
  tai.return %0 : vector<3x2xf32>
}

// -----

// An assertion that holds is removed, one that does not stays. So is a
// precondition.
// CHECK-LABEL: tai.kernel @asserts()
//   CHECK-NOT:   "holds"
//       CHECK:   tai.assert %{{.+}}, "fails"
//   CHECK-NOT:   "kept"
//       CHECK:   tai.precondition %{{.+}}, "broken"
tai.kernel @asserts() {
  %true = arith.constant true
  %false = arith.constant false
  tai.assert %true, "holds"
  tai.assert %false, "fails"
  tai.precondition %true, "kept"
  tai.precondition %false, "broken"
  tai.return
}

// -----

// Loads that nobody uses go; stores and atomics stay.
tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
// CHECK-LABEL: tai.kernel @unused_load(
//   CHECK-NOT:   tai.load
//       CHECK:   tai.atomic add
//       CHECK:   tai.store
tai.kernel @unused_load(%i: index, %f: f32) {
  %0 = tai.load @x[%i] : f32
  %1 = tai.atomic add %f, @x[%i] : f32
  tai.store %f, @x[%i] : f32
  tai.return
}

// -----

// A constant carries no derivative, nor does what is stopped already.
// CHECK-LABEL: tai.kernel @stopped(
//  CHECK-SAME:      %[[A:.+]]: f32)
//       CHECK:   %[[C:.+]] = arith.constant 2.0
//       CHECK:   %[[STOPPED:.+]] = tai.stop_gradient %[[A]]
//   CHECK-NOT:   tai.stop_gradient
//       CHECK:   arith.addf %[[STOPPED]], %[[C]]
tai.kernel @stopped(%a: f32) -> f32 {
  %c = arith.constant 2.0 : f32
  %0 = tai.stop_gradient %a : f32
  %1 = tai.stop_gradient %0 : f32
  %2 = tai.stop_gradient %c : f32
  %3 = arith.addf %1, %2 : f32
  tai.return %3 : f32
}

// -----

// A value that is differentiated as itself; as another one it stays.
// CHECK-LABEL: tai.kernel @derived(
//  CHECK-SAME:      %[[A:.+]]: f32, %[[B:.+]]: f32)
//       CHECK:   %[[D:.+]] = tai.derive_as %[[A]], %[[B]]
//   CHECK-NOT:   tai.derive_as
//       CHECK:   arith.addf %[[A]], %[[D]]
tai.kernel @derived(%a: f32, %b: f32) -> f32 {
  %0 = tai.derive_as %a, %a : f32
  %1 = tai.derive_as %a, %b : f32
  %2 = arith.addf %0, %1 : f32
  tai.return %2 : f32
}

// -----

// A read after a launch is not the read before it, and no launch goes.
tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @empty() {
  tai.return
}
// CHECK-LABEL: func.func @launches(
//       CHECK:   tai.load @x
//  CHECK-NEXT:   tai.launch @empty()
//  CHECK-NEXT:   tai.load @x
func.func @launches(%i: index) -> (f32, f32) {
  %0 = tai.load @x[%i] : f32
  tai.launch @empty() : () -> ()
  %1 = tai.load @x[%i] : f32
  return %0, %1 : f32, f32
}

// -----

// A loop that reads, and does nothing else, goes; so does one without a body.
tai.tree @t : !tai.root<pointer<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
// CHECK-LABEL: tai.kernel @idle_loops(
//  CHECK-NEXT:   tai.return
// CHECK-LABEL: tai.kernel @busy_loops(
// CHECK-COUNT-3: tai.parallel_for
tai.kernel @idle_loops(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.addf %0, %0 : f32
  }
  tai.return
}
tai.kernel @busy_loops(%n: index, %c: i1) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.random stream 0 : f32
  }
  tai.parallel_for (%i) in @x {
    tai.assert %c, "broken"
  }
  tai.parallel_for (%i) in @x {
    tai.print "{}"(%i) : index
  }
  tai.return
}

// -----

// A transposed constant, row by row; one of equal components.
// CHECK-LABEL: tai.kernel @transposed_constants(
//   CHECK-DAG:   arith.constant dense<{{\[\[}}1.000000e+00, 4.000000e+00], [2.000000e+00, 5.000000e+00], [3.000000e+00, -0.000000e+00]]> : vector<3x2xf32>
//   CHECK-DAG:   arith.constant dense<7> : vector<3x2xi32>
//   CHECK-NOT:   tai.transpose
//       CHECK:   tai.return
tai.tree @t : !tai.root<dense<[i: 4], {m: vector<3x2xf32>, n: vector<3x2xi32>}>>
tai.field @m = @t["m"] : vector<3x2xf32>, rank 1
tai.field @n = @t["n"] : vector<3x2xi32>, rank 1
tai.kernel @transposed_constants(%i: index) {
  %0 = arith.constant dense<[[1.0, 2.0, 3.0], [4.0, 5.0, -0.0]]> : vector<2x3xf32>
  %1 = tai.transpose %0 : vector<2x3xf32> -> vector<3x2xf32>
  tai.store %1, @m[%i] : vector<3x2xf32>
  %2 = arith.constant dense<7> : vector<2x3xi32>
  %3 = tai.transpose %2 : vector<2x3xi32> -> vector<3x2xi32>
  tai.store %3, @n[%i] : vector<3x2xi32>
  tai.return
}

// -----

// The transpose of an outer product is one of the same products. If the product
// is used as it is, too, it is not computed twice.
// CHECK-LABEL: tai.kernel @transposed_product(
//  CHECK-SAME:     %[[A:.+]]: vector<2xf32>, %[[B:.+]]: vector<3xf32>)
//       CHECK:   tai.outer %[[B]], %[[A]] : (vector<3xf32>, vector<2xf32>) -> vector<3x2xf32>
//   CHECK-NOT:   tai.transpose
// CHECK-LABEL: tai.kernel @product_used(
//       CHECK:   tai.outer
//       CHECK:   tai.transpose
//   CHECK-NOT:   tai.outer
tai.kernel @transposed_product(%a: vector<2xf32>, %b: vector<3xf32>) -> vector<3x2xf32> {
  %0 = tai.outer %a, %b : (vector<2xf32>, vector<3xf32>) -> vector<2x3xf32>
  %1 = tai.transpose %0 : vector<2x3xf32> -> vector<3x2xf32>
  tai.return %1 : vector<3x2xf32>
}
tai.kernel @product_used(%a: vector<2xf32>) -> vector<2x2xf32> {
  %0 = tai.outer %a, %a : (vector<2xf32>, vector<2xf32>) -> vector<2x2xf32>
  %1 = tai.transpose %0 : vector<2x2xf32> -> vector<2x2xf32>
  %2 = arith.subf %0, %1 : vector<2x2xf32>
  tai.return %2 : vector<2x2xf32>
}

// -----

// The trace of a transpose adds the same numbers in the same order. A
// determinant would not.
// CHECK-LABEL: tai.kernel @traces(
//  CHECK-SAME:     %[[A:.+]]: vector<3x3xf32>)
//       CHECK:   %[[T:.+]] = tai.transpose %[[A]]
//   CHECK-DAG:   tai.trace %[[A]]
//   CHECK-DAG:   tai.determinant %[[T]]
tai.kernel @traces(%a: vector<3x3xf32>) -> f32 {
  %0 = tai.transpose %a : vector<3x3xf32> -> vector<3x3xf32>
  %1 = tai.trace %0 : vector<3x3xf32>
  %2 = tai.determinant %0 : vector<3x3xf32>
  %3 = arith.addf %1, %2 : f32
  tai.return %3 : f32
}

// -----

// Loops that do nothing: without iterations, or without an effect outside.
tai.tree @t : !tai.root<pointer<[i: 4], {x: f32, y: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
// CHECK-LABEL: tai.kernel @empty_loops(
//   CHECK-NOT:   tai.parallel_for
//       CHECK:   tai.return
tai.kernel @empty_loops(%n: index, %a: f32, %yes: i1) {
  %one = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i, %j) = (%c2, %c4) to (%n, %c2) {
    tai.store %a, @x[%i] : f32
  }
  tai.parallel_for (%i) = (%c2) to (%c2) {
    tai.store %a, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
  }
  tai.parallel_for (%i) in @x {
    %s = tai.alloca : !tai.local<f32>
    %k = tai.stack_create : !tai.stack<f32>
    %0 = tai.load @x[%i] : f32
    tai.local_store %0, %s : f32
    %1 = tai.local_load %s : f32
    tai.stack_push %1, %k : f32
    %2 = tai.stack_pop %k : f32
    tai.local_store %2, %s : f32
    tai.stack_destroy %k : !tai.stack<f32>
    %m = memref.alloca() : memref<2xf32>
    scf.if %yes {
      memref.store %2, %m[%one] : memref<2xf32>
    }
  }
  tai.return
}

// -----

// Loops whose effects stay: a store, a message, a random number, memory of the
// caller, and a range that a launch may fill.
tai.tree @t : !tai.root<dense<[i: 4], {x: f32, y: f32}>>
tai.field @x = @t["x"] : f32, rank 1
// CHECK-LABEL: tai.kernel @kept_loops(
// CHECK-COUNT-5: tai.parallel_for
tai.kernel @kept_loops(%n: index, %a: f32, %m: memref<4xf32>, %c: i1) {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    tai.store %a, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    tai.print "{}"(%i) : index
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.random stream 0 : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.if %c {
      %v = memref.subview %m[1] [2] [1] : memref<4xf32> to memref<2xf32, strided<[1], offset: 1>>
      memref.store %a, %v[%c0] : memref<2xf32, strided<[1], offset: 1>>
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c4) {
    tai.assert %c, "broken"
  }
  tai.return
}

// -----

// Locals that are not read, and a stack that nobody pops from.
// CHECK-LABEL: tai.kernel @written_only(
//       CHECK:   %[[S:.+]] = tai.alloca
//  CHECK-NEXT:   tai.local_store %{{.+}}, %[[S]]
//  CHECK-NEXT:   tai.local_load %[[S]]
//  CHECK-NEXT:   tai.return
tai.kernel @written_only(%a: f32) -> f32 {
  %r = tai.alloca : !tai.local<f32>
  tai.local_store %a, %r : f32
  %k = tai.stack_create : !tai.stack<f32>
  tai.stack_push %a, %k : f32
  tai.stack_destroy %k : !tai.stack<f32>
  %s = tai.alloca : !tai.local<f32>
  tai.local_store %a, %s : f32
  %0 = tai.local_load %s : f32
  tai.return %0 : f32
}
