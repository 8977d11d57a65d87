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
