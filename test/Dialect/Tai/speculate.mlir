// RUN: tai-opt %s --loop-invariant-code-motion | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 4], {x: f32, y: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// A load leaves a loop that writes another field only if its index is known to
// be inside: the loop might not have run.
// CHECK-LABEL: tai.kernel @bounds(
//       CHECK:   arith.constant 9
//       CHECK:   scf.for
//       CHECK:     tai.load @x
//       CHECK:     tai.store
tai.kernel @bounds(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  scf.for %i = %c0 to %n step %c1 {
    %0 = tai.load @x[%c9] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}
