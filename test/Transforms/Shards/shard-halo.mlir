// RUN: tai-opt %s --tai-shard | FileCheck %s

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, at: i32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @at = @t["at"] : i32, rank 1

// Data choose rows within the halo: it is fetched, and each access is checked.
// CHECK-LABEL: tai.kernel @near(
//       CHECK:   tai_mesh.exchange fetch @x before 3 after 3
//       CHECK:   %[[FIRST:.*]] = arith.addi %{{.*}}, %{{.*}} : index
//       CHECK:   %[[END:.*]] = arith.addi %[[FIRST]], %{{.*}} : index
//       CHECK:   tai.parallel_for
//       CHECK:     %[[ROW:.*]] = arith.index_cast
//       CHECK:     %[[LOW:.*]] = arith.cmpi sge, %[[ROW]], %[[FIRST]]
//       CHECK:     %[[HIGH:.*]] = arith.cmpi slt, %[[ROW]], %[[END]]
//       CHECK:     %[[HOLDS:.*]] = arith.andi %[[LOW]], %[[HIGH]]
//       CHECK:     tai.assert %[[HOLDS]], "data choose row {} of 'x' on a rank that has rows {} to {}, with a halo of 3; {{.*}}"(%[[ROW]], %[[FIRST]], %{{.*}})
//       CHECK:     tai.load @x[%[[ROW]]]
//       CHECK:   }
//  CHECK-NEXT:   tai_mesh.exchange stale @y
tai.kernel @near() {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%1] : f32
    tai.store %2, @y[%i] : f32
  } {tai_mesh.halo = 3 : i64}
  tai.return
}

// Additions within the halo are collected.
// CHECK-LABEL: tai.kernel @add(
//       CHECK:   tai_mesh.exchange clear @y before 2 after 2
//       CHECK:     tai.assert
//       CHECK:   tai_mesh.exchange collect @y before 2 after 2
tai.kernel @add() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    tai.atomic add %2, @y[%1] : f32
  } {tai_mesh.halo = 2 : i64}
  tai.return
}

// Rows of the rank itself may be stored, and the old value of an update be read.
// CHECK-LABEL: tai.kernel @own(
//   CHECK-NOT:   tai_mesh.exchange
//       CHECK:   tai.parallel_for
//       CHECK:     tai.assert
//       CHECK:     tai.store %{{.*}}, @y[
//       CHECK:   }
//  CHECK-NEXT:   tai_mesh.exchange stale @y
tai.kernel @own() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    tai.store %2, @y[%1] : f32
  } {tai_mesh.halo = 0 : i64}
  tai.return
}

// All rows are gathered for reads, and summed up after additions; no row is
// beyond them.
// CHECK-LABEL: tai.kernel @all(
//   CHECK-DAG:   tai_mesh.exchange gather @x
//   CHECK-DAG:   tai_mesh.exchange open @y
//       CHECK:   tai.parallel_for
//   CHECK-NOT:     tai.assert
//       CHECK:   }
//       CHECK:   tai_mesh.exchange sum @y
tai.kernel @all() {
  tai.parallel_for (%i) in @at {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%1] : f32
    tai.atomic add %2, @y[%1] : f32
  } {tai_mesh.halo = -1 : i64}
  tai.return
}
