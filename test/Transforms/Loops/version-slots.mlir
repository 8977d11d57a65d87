// RUN: tai-opt %s --tai-version-slots | FileCheck %s
// RUN: tai-opt %s --tai-version-slots=max-ops=15 | FileCheck %s --check-prefix=FEW
// RUN: tai-opt %s --tai-version-slots=max-ops=1 | FileCheck %s --check-prefix=SMALL

tai.tree @t : !tai.root<dense<[t: 4, i: 64], {x: f32, v: f32}>, dense<[i: 64], {s: i32}>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @v = @t["v"] : f32, rank 2

// Two versions in which the slots differ by a number of one sign, and the loop
// as it was.
// CHECK-LABEL: tai.kernel @step(
//  CHECK-SAME:     %[[A:.+]]: index, %[[B:.+]]: index
//       CHECK:   %[[D:.+]] = arith.subi %[[A]], %[[B]]
//       CHECK:   %[[ABOVE:.+]] = arith.cmpi slt, %{{.+}}, %[[D]]
//       CHECK:   scf.if %[[ABOVE]] {
//       CHECK:     %[[M:.+]] = arith.maxsi %[[D]], %{{.+}}
//       CHECK:     %[[S:.+]] = arith.addi %[[B]], %[[M]]
//       CHECK:     tai.parallel_for
//       CHECK:       tai.load @x[%[[B]],
//       CHECK:       tai.atomic add %{{.+}}, @x[%[[S]],
//       CHECK:   } else {
//       CHECK:     %[[BELOW:.+]] = arith.cmpi slt, %[[D]], %{{.+}}
//       CHECK:     scf.if %[[BELOW]] {
//       CHECK:       arith.minsi %[[D]], %{{.+}}
//       CHECK:       tai.parallel_for
//       CHECK:     } else {
//       CHECK:       tai.parallel_for
//       CHECK:         tai.load @x[%[[B]],
// SMALL-LABEL: tai.kernel @step(
//   SMALL-NOT:   scf.if
tai.kernel @step(%a: index, %b: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = tai.load @x[%b, %i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = tai.atomic add %0, @x[%a, %1] : f32
  }
  tai.return
}

// Slots that are known to differ need no versions.
// CHECK-LABEL: tai.kernel @next(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @next(%a: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  %b = arith.addi %a, %c1 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = tai.load @x[%b, %i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = tai.atomic add %0, @x[%a, %1] : f32
  }
  tai.return
}

// Each order of three slots has a version, in which the higher ones are sums,
// before the loop as it was. Loops of more operations have none.
// CHECK-LABEL: tai.kernel @three(
//  CHECK-SAME:     %[[A:.+]]: index, %[[B:.+]]: index, %[[C:.+]]: index
//       CHECK:   %[[D:.+]] = arith.subi
//       CHECK:   %[[E:.+]] = arith.subi
//       CHECK:   %[[ONE:.+]] = arith.cmpi slt, %{{.+}}, %[[D]]
//       CHECK:   %[[TWO:.+]] = arith.cmpi slt, %{{.+}}, %[[E]]
//       CHECK:   %[[BOTH:.+]] = arith.andi %[[ONE]], %[[TWO]]
//       CHECK:   scf.if %[[BOTH]] {
//       CHECK:     %[[M:.+]] = arith.maxsi %[[D]]
//       CHECK:     %[[S:.+]] = arith.addi %[[B]], %[[M]]
//       CHECK:     %[[N:.+]] = arith.maxsi %[[E]]
//       CHECK:     %[[T:.+]] = arith.addi %[[S]], %[[N]]
//       CHECK:     tai.parallel_for
//       CHECK:       tai.load @x[%[[B]],
//       CHECK:       tai.load @x[%[[T]],
//       CHECK:       tai.atomic add %{{.+}}, @x[%[[S]],
// CHECK-COUNT-5:   scf.if %{{.+}} {
//       CHECK:     tai.parallel_for
//       CHECK:     } else {
//       CHECK:       tai.parallel_for
//       CHECK:         tai.load @x[%[[B]],
//       CHECK:         tai.load @x[%[[C]],
//       CHECK:         tai.atomic add %{{.+}}, @x[%[[A]],
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
// FEW-LABEL: tai.kernel @three(
//   FEW-NOT:   scf.if
tai.kernel @three(%a: index, %b: index, %c: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = tai.load @x[%b, %i] : f32
    %1 = tai.load @x[%c, %i] : f32
    %2 = arith.addf %0, %1 : f32
    %3 = arith.addi %i, %c1 : index
    %4 = tai.atomic add %2, @x[%a, %3] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @four(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @four(%a: index, %b: index, %c: index, %d: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = tai.load @x[%b, %i] : f32
    %1 = tai.load @x[%c, %i] : f32
    %2 = tai.load @x[%d, %i] : f32
    %3 = arith.addf %0, %1 : f32
    %4 = arith.addf %2, %3 : f32
    %5 = arith.addi %i, %c1 : index
    %6 = tai.atomic add %4, @x[%a, %5] : f32
  }
  tai.return
}
