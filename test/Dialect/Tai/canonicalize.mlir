// RUN: tai-opt %s --canonicalize --split-input-file | FileCheck %s

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
