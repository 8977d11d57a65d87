// RUN: tai-opt %s --tai-version-ranges | FileCheck %s
// RUN: tai-opt %s --tai-version-ranges=max-ops=1 | FileCheck %s --check-prefix=SMALL

// In the interior, the remainder is the sum and the condition holds. The
// iterations near both ends are one loop, on one thread.
// CHECK-LABEL: tai.kernel @periodic(
//  CHECK-SAME:     %[[X:.+]]: memref<?xf32>, %[[Y:.+]]: memref<?xf32>, %[[N:.+]]: index
//       CHECK:   %[[LENGTH:.+]] = arith.subi %[[N]], %c0
//       CHECK:   arith.cmpi sgt, %[[LENGTH]], %c2
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for (%[[I:.+]]) = (%{{.+}}) to (%{{.+}}) {
//       CHECK:       %[[NEXT:.+]] = arith.addi %[[I]], %c1
//       CHECK:       memref.load %[[X]][%[[NEXT]]]
//       CHECK:     tai.apart
//       CHECK:     tai.parallel_for (%{{.+}}) = (%{{.+}}) to (%{{.+}}) serialize {
//       CHECK:       arith.select
//       CHECK:       arith.remui
//       CHECK:     tai.fallback
//       CHECK:   } else {
//       CHECK:     tai.parallel_for
//       CHECK:       arith.remui
// SMALL-LABEL: tai.kernel @periodic(
//   SMALL-NOT:   scf.if
tai.kernel @periodic(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.remui %0, %n : index
    %2 = memref.load %x[%1] : memref<?xf32>
    memref.store %2, %y[%i] : memref<?xf32>
  }
  tai.return
}

// Indices that are cut off at both ends.
// SMALL-LABEL: tai.kernel @clamped(
// CHECK-LABEL: tai.kernel @clamped(
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for (%[[I:.+]]) =
//       CHECK:       %[[NEXT:.+]] = arith.addi %[[I]], %c1
//       CHECK:       %[[BEFORE:.+]] = arith.subi %[[I]], %c1
//       CHECK:       memref.load %{{.+}}[%[[NEXT]]]
//       CHECK:       memref.load %{{.+}}[%[[BEFORE]]]
tai.kernel @clamped(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %last = arith.subi %n, %c1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.minsi %0, %last : index
    %2 = arith.subi %i, %c1 : index
    %3 = arith.maxsi %2, %c0 : index
    %4 = memref.load %x[%1] : memref<?xf32>
    %5 = memref.load %x[%3] : memref<?xf32>
    %6 = arith.subf %4, %5 : f32
    memref.store %6, %y[%i] : memref<?xf32>
  }
  tai.return
}

// A condition, and one that the ends of the range do not decide.
// CHECK-LABEL: tai.kernel @conditions(
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for (%[[I:.+]]) =
//       CHECK:       %[[OPEN:.+]] = arith.cmpi slt, %[[I]], %{{.+}}
//       CHECK:       scf.if %true
//       CHECK:         scf.if %[[OPEN]]
tai.kernel @conditions(%y: memref<?xf32>, %n: index, %m: index) {
  %one = arith.constant 1.0 : f32
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.cmpi sgt, %i, %c0 : index
    %1 = arith.cmpi slt, %i, %m : index
    scf.if %0 {
      scf.if %1 {
        memref.store %one, %y[%i] : memref<?xf32>
      }
    }
  }
  tai.return
}

// Iterations that meet in memory keep their order.
// CHECK-LABEL: tai.kernel @meets(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @meets(%x: memref<?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.remui %0, %n : index
    %2 = memref.load %x[%1] : memref<?xf32>
    memref.store %2, %x[%i] : memref<?xf32>
  }
  tai.return
}

// Constant bounds are for tai-version-interior.
// CHECK-LABEL: tai.kernel @constant(
//   CHECK-NOT:   tai.apart
//       CHECK:   tai.return
tai.kernel @constant(%x: memref<?xf32>, %y: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.remui %0, %c64 : index
    %2 = memref.load %x[%1] : memref<?xf32>
    memref.store %2, %y[%i] : memref<?xf32>
  }
  tai.return
}

// The period is not the end of the range.
// CHECK-LABEL: tai.kernel @other_period(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @other_period(%x: memref<?xf32>, %y: memref<?xf32>, %n: index, %m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.remui %0, %m : index
    %2 = memref.load %x[%1] : memref<?xf32>
    memref.store %2, %y[%i] : memref<?xf32>
  }
  tai.return
}

// Random numbers belong to positions in the loop.
// CHECK-LABEL: tai.kernel @random(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @random(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.remui %0, %n : index
    %2 = tai.random stream 0 : f32
    %3 = memref.load %x[%1] : memref<?xf32>
    %4 = arith.addf %2, %3 : f32
    memref.store %4, %y[%i] : memref<?xf32>
  }
  tai.return
}
