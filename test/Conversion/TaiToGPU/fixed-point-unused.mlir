// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics=on-device=true --tai-lower-layout=on-device=true --convert-tai-to-gpu | FileCheck %s

// The first two passes of additions in fixed point are without the other
// effects of the loop. Values that only these used go with them: a branch whose
// result is not needed, and its contents, are removed once. (A branch that went
// first took its contents along, which were then looked at in freed memory: a
// memory checker sees it here, random programs died of it.)

tai.tree @t : !tai.root<dense<[i: 20000], {at: i32, v: f32, y: f32}>, dense<[i: 100], {one: f32}>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @one = @t["one"] : f32, rank 1

// CHECK-LABEL: llvm.func @branch_0(
//   CHECK-NOT:   scf.if
//   CHECK-NOT:   math.sin
//       CHECK:   llvm.call @tai_dev_fixed_scale_f32(
// CHECK-LABEL: llvm.func @branch_1(
//   CHECK-NOT:   scf.if
//   CHECK-NOT:   math.sin
//       CHECK:   llvm.call @tai_dev_fixed_add_f32(
// CHECK-LABEL: llvm.func @branch_2(
//       CHECK:   llvm.call @tai_dev_fixed_round_f32(
//       CHECK:   scf.if
//       CHECK:     math.sin
tai.kernel @branch() {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @one[%j] : f32
    %positive = arith.cmpf ogt, %v, %zero : f32
    %y = scf.if %positive -> f32 {
      %large = arith.addf %v, %v : f32
      %inner = scf.if %positive -> f32 {
        %s = math.sin %large : f32
        %p = arith.mulf %s, %v : f32
        scf.yield %p : f32
      } else {
        scf.yield %zero : f32
      }
      scf.yield %inner : f32
    } else {
      %n = arith.negf %v : f32
      scf.yield %n : f32
    }
    tai.store %y, @y[%i] : f32
  }
  tai.return
}
