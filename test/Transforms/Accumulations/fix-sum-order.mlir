// RUN: tai-opt %s --tai-fix-sum-order | FileCheck %s
// RUN: tai-opt %s --tai-fix-sum-order --tai-fix-sum-order | FileCheck %s

// Kernels that do not say how their sums are kept are made deterministic, and
// compensated ones both.

tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

// CHECK-LABEL: tai.kernel @own()
// CHECK-SAME: modes = {sums = "deterministic"}
tai.kernel @own() {
  tai.return
}

// CHECK-LABEL: tai.kernel @math()
// CHECK-SAME: modes = {math = "strict", sums = "deterministic"}
tai.kernel @math() attributes {modes = {math = "strict"}} {
  tai.return
}

// CHECK-LABEL: tai.kernel @both()
// CHECK-SAME: modes = {sums = "compensated+deterministic"}
tai.kernel @both() attributes {modes = {sums = "compensated"}} {
  tai.return
}

// A kernel that wants the plain sums keeps them.
// CHECK-LABEL: tai.kernel @plain()
// CHECK-SAME: modes = {sums = "default"}
tai.kernel @plain() attributes {modes = {sums = "default"}} {
  tai.return
}

// CHECK-LABEL: func.func @loop
// CHECK-SAME: passthrough = {{\[\[}}"tai.modes", "sums=deterministic"]]
func.func @loop() {
  tai.parallel_for (%i) in @x {
  }
  return
}

// CHECK-LABEL: func.func @none() {
func.func @none() {
  return
}
