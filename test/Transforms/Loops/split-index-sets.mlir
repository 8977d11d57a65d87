// RUN: tai-opt %s --tai-split-index-sets --canonicalize | FileCheck %s

// The interior [1, 63) of the program's index, which is the loop's plus 2.
// CHECK-LABEL: func.func @split(
// CHECK-SAME:      %[[LO:.+]]: index, %[[HI:.+]]: index, %{{.+}}: memref<?xf32>)
//   CHECK-DAG:   %[[CM1:.+]] = arith.constant -1 : index
//   CHECK-DAG:   %[[ONE:.+]] = arith.constant 1.0
//   CHECK-DAG:   %[[TWO:.+]] = arith.constant 2.0
//   CHECK-DAG:   %[[C61:.+]] = arith.constant 61 : index
//       CHECK:   %[[A0:.+]] = arith.maxsi %[[LO]], %[[CM1]]
//       CHECK:   %[[A:.+]] = arith.minsi %[[A0]], %[[HI]]
//       CHECK:   %[[B0:.+]] = arith.maxsi %[[LO]], %[[C61]]
//       CHECK:   %[[B:.+]] = arith.minsi %[[B0]], %[[HI]]
//       CHECK:   scf.for %{{.+}} = %[[A]] to %[[B]]
//   CHECK-NOT:     scf.if
//       CHECK:     memref.store %[[ONE]]
//       CHECK:   scf.for
//       CHECK:     arith.select %{{.+}}, %[[LO]], %[[B]]
//       CHECK:     arith.select %{{.+}}, %[[A]], %[[HI]]
//       CHECK:     scf.for
//   CHECK-NOT:     scf.if
//       CHECK:       memref.store %[[TWO]]
func.func @split(%lo: index, %hi: index, %m: memref<?xf32>) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c63 = arith.constant 63 : index
  scf.for %k = %lo to %hi step %c1 {
    %i = arith.addi %k, %c2 : index
    %above = arith.cmpi sge, %i, %c1 : index
    %below = arith.cmpi slt, %i, %c63 : index
    %inside = arith.andi %above, %below : i1
    scf.if %inside {
      %one = arith.constant 1.0 : f32
      memref.store %one, %m[%i] : memref<?xf32>
    } else {
      %two = arith.constant 2.0 : f32
      memref.store %two, %m[%i] : memref<?xf32>
    } {tai.interior = array<i64: 1, 63>}
  }
  return
}

// An unmarked branch stays, and so does one beside which the loop does more.
// CHECK-LABEL: func.func @stays(
// CHECK-COUNT-2: scf.if
func.func @stays(%lo: index, %hi: index, %m: memref<?xf32>) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  %one = arith.constant 1.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %inside = arith.cmpi slt, %i, %c63 : index
    scf.if %inside {
      memref.store %one, %m[%i] : memref<?xf32>
    }
  }
  scf.for %i = %lo to %hi step %c1 {
    %above = arith.cmpi sge, %i, %c1 : index
    %below = arith.cmpi slt, %i, %c63 : index
    %inside = arith.andi %above, %below : i1
    memref.store %one, %m[%i] : memref<?xf32>
    scf.if %inside {
      memref.store %one, %m[%lo] : memref<?xf32>
    } {tai.interior = array<i64: 1, 63>}
  }
  return
}
