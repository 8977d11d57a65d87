// RUN: tai-opt %s --tai-lower-struct-for | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 4, j: 8], {x: f32, y: f32}>,
                        dense<[j: 8], dense<[i: 4], {c: f32}>>, {s: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @shifted = @t["y"] : f32, rank 2, offset [-2, 10]
tai.field @columns = @t["c"] : f32, rank 2
tai.field @s = @t["s"] : f32, rank 0

// The last axis of the layout is the innermost dimension.
// CHECK-LABEL: tai.kernel @row_major
//       CHECK:   %[[C0:.+]] = arith.constant 0 : index
//       CHECK:   %[[C4:.+]] = arith.constant 4 : index
//       CHECK:   %[[C0_1:.+]] = arith.constant 0 : index
//       CHECK:   %[[C8:.+]] = arith.constant 8 : index
//       CHECK:   tai.parallel_for (%[[I:.+]], %[[J:.+]]) = (%[[C0]], %[[C0_1]]) to (%[[C4]], %[[C8]])
//       CHECK:     tai.load @x[%[[I]], %[[J]]]
tai.kernel @row_major() {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
  }
  tai.return
}

// Where the layout stores columns, the loop walks through columns.
// CHECK-LABEL: tai.kernel @column_major
//       CHECK:   tai.parallel_for (%[[J:.+]], %[[I:.+]]) =
//       CHECK:     tai.load @columns[%[[I]], %[[J]]]
tai.kernel @column_major() {
  tai.parallel_for (%i, %j) in @columns {
    %0 = tai.load @columns[%i, %j] : f32
  }
  tai.return
}

// Indices start at the offset of the field.
// CHECK-LABEL: tai.kernel @offset
//   CHECK-DAG:   %[[M2:.+]] = arith.constant -2 : index
//   CHECK-DAG:   %[[P2:.+]] = arith.constant 2 : index
//   CHECK-DAG:   %[[P10:.+]] = arith.constant 10 : index
//   CHECK-DAG:   %[[P18:.+]] = arith.constant 18 : index
//       CHECK:   tai.parallel_for {{.+}} = (%[[M2]], %[[P10]]) to (%[[P2]], %[[P18]])
tai.kernel @offset() {
  tai.parallel_for (%i, %j) in @shifted {
    %0 = tai.load @shifted[%i, %j] : f32
  }
  tai.return
}

// A field without dimensions has one element.
// CHECK-LABEL: tai.kernel @scalar
//       CHECK:   %[[C0:.+]] = arith.constant 0 : index
//       CHECK:   %[[C1:.+]] = arith.constant 1 : index
//       CHECK:   tai.parallel_for (%{{.+}}) = (%[[C0]]) to (%[[C1]])
tai.kernel @scalar() {
  tai.parallel_for () in @s {
    %0 = tai.load @s[] : f32
  }
  tai.return
}

// Attributes of the loop stay.
// CHECK-LABEL: tai.kernel @attributes
//       CHECK:   tai.parallel_for {{.+}} serialize block_dim 64
tai.kernel @attributes() {
  tai.parallel_for (%i, %j) in @x serialize block_dim 64 {
    %0 = tai.load @x[%i, %j] : f32
  }
  tai.return
}

// A box is left alone.
// CHECK-LABEL: tai.kernel @box
//  CHECK-SAME:     %[[N:.+]]: index
//       CHECK:   %[[C0:.+]] = arith.constant 0 : index
//  CHECK-NEXT:   tai.parallel_for (%{{.+}}) = (%[[C0]]) to (%[[N]])
tai.kernel @box(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
  }
  tai.return
}
