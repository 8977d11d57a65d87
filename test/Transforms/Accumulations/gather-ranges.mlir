// RUN: tai-opt %s --tai-gather-ranges | FileCheck %s
// RUN: tai-opt %s --tai-gather-ranges=max-ops=1 | FileCheck %s --check-prefix=SMALL

tai.tree @t : !tai.root<dense<[i: 64], {x: f32, y: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// An interior in which both terms exist, the elements at both ends, and the
// stores of zero; the loop as it was for arrays that overlap.
// CHECK-LABEL: tai.kernel @central(
//  CHECK-SAME:     %[[X:.+]]: memref<?xf32>, %[[Y:.+]]: memref<?xf32>, %[[N:.+]]: index
//   CHECK-DAG:   memref.extract_aligned_pointer_as_index %[[X]]
//   CHECK-DAG:   memref.extract_aligned_pointer_as_index %[[Y]]
//       CHECK:   %[[LENGTH:.+]] = arith.subi %[[N]], %{{.+}}
//       CHECK:   arith.cmpi sge, %[[LENGTH]], %c2
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for (%[[I:.+]]) =
//       CHECK:       memref.load %[[Y]]
//       CHECK:       memref.load %[[Y]]
//       CHECK:       arith.addf
//       CHECK:       memref.load %[[X]][%[[I]]]
//       CHECK:       memref.store %{{.+}}, %[[X]][%[[I]]]
//   CHECK-NOT:       memref.atomic_rmw
//       CHECK:     tai.apart
//       CHECK:     tai.parallel_for (%[[B:.+]]) = (%{{.+}}) to (%c4
//       CHECK:       arith.cmpi slt, %[[B]], %c2
//       CHECK:       scf.if
//       CHECK:         memref.store %{{.+}}, %[[X]]
//       CHECK:       scf.if
//       CHECK:         memref.store %{{.+}}, %[[X]]
//       CHECK:     tai.parallel_for
//   CHECK-NOT:       memref.atomic_rmw
//       CHECK:       memref.store %{{.+}}, %[[Y]]
//       CHECK:   } else {
//       CHECK:     tai.parallel_for
//       CHECK:       memref.atomic_rmw
//       CHECK:       memref.atomic_rmw
//       CHECK:     tai.fallback
// SMALL-LABEL: tai.kernel @central(
//   SMALL-NOT:   scf.if
tai.kernel @central(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %zero = arith.constant 0.0 : f32
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c1) to (%n) {
    %0 = memref.load %y[%i] : memref<?xf32>
    memref.store %zero, %y[%i] : memref<?xf32>
    %1 = arith.addi %i, %c1 : index
    %2 = memref.atomic_rmw addf %0, %x[%1] : (f32, memref<?xf32>) -> f32
    %3 = arith.subi %i, %c1 : index
    %4 = memref.atomic_rmw addf %0, %x[%3] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// A field, up to a bound of the launch. Nothing is left for the copy.
// SMALL-LABEL: tai.kernel @bound(
// CHECK-LABEL: tai.kernel @bound(
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for (%[[I:.+]]) =
//       CHECK:       tai.atomic add %{{.+}}, @x[%[[I]]] exclusive
//       CHECK:   } else {
//       CHECK:     tai.parallel_for
//       CHECK:       tai.atomic add %{{.+}}, @x[%{{.+}}] : f32
tai.kernel @bound(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @y[%i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = tai.atomic add %0, @x[%1] : f32
  }
  tai.return
}

// One border for each index of the loop, the second within the interior of the
// first.
// CHECK-LABEL: tai.kernel @two(
//       CHECK:   scf.if
//       CHECK:     tai.parallel_for (%[[I:.+]], %[[J:.+]]) =
//       CHECK:       memref.store %{{.+}}, %{{.+}}[%[[I]], %[[J]]]
//       CHECK:     tai.parallel_for (%{{.+}}, %{{.+}}) = (%c0{{.*}}, %{{.+}}) to (%c2{{.*}}, %{{.+}}) {
//       CHECK:     tai.parallel_for (%{{.+}}, %{{.+}}) = (%{{.+}}, %c0{{.*}}) to (%{{.+}}, %c2{{.*}}) {
//       CHECK:   } else {
tai.kernel @two(%x: memref<?x?xf32>, %y: memref<?x?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) {
    %0 = memref.load %y[%i, %j] : memref<?x?xf32>
    %1 = arith.addi %i, %c1 : index
    %2 = memref.atomic_rmw addf %0, %x[%1, %j] : (f32, memref<?x?xf32>) -> f32
    %3 = arith.addi %j, %c1 : index
    %4 = memref.atomic_rmw addf %0, %x[%i, %3] : (f32, memref<?x?xf32>) -> f32
  }
  tai.return
}

// Additions to the element of the iteration itself need no gathering.
// CHECK-LABEL: tai.kernel @own(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @own(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %y[%i] : memref<?xf32>
    %1 = memref.atomic_rmw addf %0, %x[%i] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// An index from data has no owner.
// CHECK-LABEL: tai.kernel @data(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @data(%x: memref<?xf32>, %p: memref<?xindex>, %n: index) {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %p[%i] : memref<?xindex>
    %1 = memref.atomic_rmw addf %one, %x[%0] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// The value is an element that another iteration has written.
// CHECK-LABEL: tai.kernel @written(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @written(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %zero = arith.constant 0.0 : f32
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %1 = arith.addi %i, %c1 : index
    %0 = memref.load %y[%1] : memref<?xf32>
    memref.store %zero, %y[%i] : memref<?xf32>
    %2 = memref.atomic_rmw addf %0, %x[%1] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// The value is the one that the iteration has stored before.
// CHECK-LABEL: tai.kernel @after(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @after(%x: memref<?xf32>, %y: memref<?xf32>, %n: index) {
  %one = arith.constant 1.0 : f32
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    memref.store %one, %y[%i] : memref<?xf32>
    %0 = memref.load %y[%i] : memref<?xf32>
    %1 = arith.addi %i, %c1 : index
    %2 = memref.atomic_rmw addf %0, %x[%1] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// The loop reads the array to which it adds.
// CHECK-LABEL: tai.kernel @read(
//   CHECK-NOT:   scf.if
//       CHECK:   tai.return
tai.kernel @read(%x: memref<?xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %x[%i] : memref<?xf32>
    %1 = arith.addi %i, %c1 : index
    %2 = memref.atomic_rmw addf %0, %x[%1] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}
