// RUN: tai-reduce %s -opt-reduction-pass='opt-pass=canonicalize test=%S/Inputs/has-atomic.sh' | FileCheck %s

// Ops that canonicalization can take away are gone, and the file still passes
// the test.
//     CHECK: tai.kernel @interesting
// CHECK-NOT:   arith.
//     CHECK:   tai.atomic

tai.tree @t : !tai.root<{loss: f32}>
tai.field @loss = @t["loss"] : f32, rank 0

tai.kernel @interesting(%x: f32) {
  %0 = arith.addf %x, %x : f32
  %1 = tai.atomic add %x, @loss[] : f32
  tai.return
}
