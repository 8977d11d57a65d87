// RUN: tai-opt %s --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s --check-prefix=ORDERED

// The function of a loop says whether LLVM may choose the order of its sums. In
// a strict and deterministic kernel, sums have the order of all targets.

tai.tree @t : !tai.root<dense<[i: 100000], {x: f32}>, {s: f32, n: i32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 0
tai.field @n = @t["n"] : i32, rank 0

// CHECK-LABEL: llvm.func internal @sum.loop0(
//  CHECK-SAME: "tai.free_sums"
// ORDERED-NOT: tai.free_sums
tai.kernel @sum() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%c1) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.atomic add %0, @s[] : f32
  }
  tai.return
}

// Integers have no order.
// CHECK-LABEL: llvm.func internal @count.loop0(
//   CHECK-NOT: tai.free_sums
tai.kernel @count() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 100000 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%c1) {
    %1 = tai.atomic add %one, @n[] : i32
  }
  tai.return
}
