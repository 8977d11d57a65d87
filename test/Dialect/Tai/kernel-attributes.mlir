// RUN: tai-opt %s --verify-roundtrip --split-input-file --verify-diagnostics | FileCheck %s

// The attributes of kernels are inherent: no pass may drop them unread. Former
// names, which were discardable, are taken for the present ones.
// CHECK-LABEL: tai.kernel @former_grad() attributes
//  CHECK-SAME:     {conventions = {ties = "split"}, gradients = array<i64>, keeps_activity, modes = {ftz = true, math = "strict"}, part_of = @whole, reads_before = [@x], reexecutes, stored_form = @form, tangent = @tangent, zeroes_adjoint}
tai.kernel @former_grad() attributes {
    tai.before = [@x], tai.conventions = {ties = "split"}, tai.gradients = array<i64>,
    tai.keeps_activity, tai.modes = {math = "strict", ftz = true}, tai.part_of = @whole, tai.reruns, tai.stored_form = @form,
    tai.takes, tai.tangent = @tangent} {
  tai.return
}

// -----

// Attributes of functions of other dialects stay as they are.
// CHECK-LABEL: func.func @f(
//  CHECK-SAME:     attributes {tai.conventions = {ties = "split"}, tai.differentiate, tai.gradients = array<i64: 0>}
func.func @f(%x: f64) attributes {tai.conventions = {ties = "split"}, tai.differentiate, tai.gradients = array<i64: 0>} {
  return
}

// -----

// expected-error @below {{'zeroes_adjoint' is given twice: 'tai.takes' is an older name of it}}
tai.kernel @twice() attributes {tai.takes, zeroes_adjoint} {
  tai.return
}

// -----

// expected-error @below {{'tai.kernel' op attribute 'reads_before' failed to satisfy constraint}}
tai.kernel @no_fields() attributes {tai.before = @x} {
  tai.return
}

// -----

// The generic form does not ask the parser of the op.
// expected-error @below {{expects 'zeroes_adjoint', an attribute of the op itself, where 'tai.takes' was written}}
"tai.kernel"() <{function_type = () -> (), sym_name = "generic"}> ({
  "tai.return"() : () -> ()
}) {tai.takes} : () -> ()

// -----

// Loops and updates have theirs, too.
tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
// CHECK-LABEL: tai.kernel @notes
//       CHECK:   tai.atomic add %{{.+}}, @x[%{{.+}}] reduction <buffer wide any buffer 2> : f32
//       CHECK:   tai.assert %{{.+}}, "m"(%{{.+}}) : f32 {failure = 2 : i32, shapes = array<i32: 1>}
//       CHECK: } {fixed_cost = 2.000000e+00 : f64, in_warp, order = #tai.loop_order<fixed>, outer_dims = 1 : i64, reach = -1 : i64}
tai.kernel @notes(%v: f32, %c: i1) {
  tai.parallel_for (%i) in @x {
    %0 = tai.atomic add %v, @x[%i] reduction <buffer wide any buffer 2> : f32
    tai.assert %c, "m"(%v) : f32 {failure = 2 : i32, shapes = array<i32: 1>}
  } {fixed_cost = 2.0 : f64, in_warp, order = #tai.loop_order<fixed>, outer_dims = 1 : i64, reach = -1 : i64}
  tai.return
}

// -----

tai.kernel @unknown() {
  %c = arith.constant 0 : index
  // expected-error @below {{there is no attribute 'tai.reach'}}
  tai.parallel_for (%i) = (%c) to (%c) {
  } {tai.reach = 1 : i64}
  tai.return
}
