// An op whose dialect is not loaded may do anything: it stays in its branch and its
// loops with its region, and it is there once. The pass neither fails nor crashes.
// RUN: tai-opt %s --allow-unregistered-dialect --tai-expand-atomics | FileCheck %s

// CHECK-LABEL: tai.kernel @foreign(
//       CHECK:   tai.parallel_for
//       CHECK:     tai.load @x
//       CHECK:     scf.for
//       CHECK:       scf.if
//  CHECK-NEXT:         "foo.op"
//  CHECK-NEXT:           arith.mulf
//  CHECK-NEXT:           "foo.end"
//       CHECK:         tai.atomic add %{{.*}}, @y[
//   CHECK-NOT:   foo.op
//       CHECK:   tai.return
!scene = !tai.root<dense<[i: 8], {x: f32, y: f32}>>
tai.tree @scene : !scene
tai.field @x = @scene["x"] : f32, rank 1
tai.field @y = @scene["y"] : f32, rank 1
tai.kernel @foreign(%v: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %0 = tai.load @x[%i] : f32
    %near = arith.cmpf olt, %0, %v : f32
    scf.for %j = %c0 to %c8 step %c1 {
      scf.if %near {
        %1 = "foo.op"(%0, %j) ({
          %2 = arith.mulf %0, %v : f32
          "foo.end"(%2) : (f32) -> ()
        }) : (f32, index) -> f32
        tai.atomic add %1, @y[%i] : f32
      }
    }
  }
  tai.return
}
