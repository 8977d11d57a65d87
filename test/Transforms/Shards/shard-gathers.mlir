// RUN: tai-opt %s --tai-shard=gathers --canonicalize | FileCheck %s
// RUN: tai-opt %s --tai-shard --canonicalize | FileCheck %s --check-prefix=SCATTER

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, z: f32, at: i32}>>>
tai.tree @s : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 4], {u: f32, v: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @z = @t["z"] : f32, rank 1
tai.field @at = @t["at"] : i32, rank 1
tai.field @u = @s["u"] : f32, rank 1
tai.field @v = @s["v"] : f32, rank 1

// Additions to the neighbours, as the adjoint of a stencil makes them: the owner
// of a row reads the neighbours.
// CHECK-LABEL: tai.kernel @stencil(
//   CHECK-NOT:   tai_mesh.exchange {{clear|collect}}
//       CHECK:   tai_mesh.exchange fetch @y before 1 after 1
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic add %{{.*}}, @x[%{{.*}}] exclusive
//   CHECK-NOT:   tai_mesh.exchange {{clear|collect}}
//       CHECK:   tai_mesh.exchange stale @x
// SCATTER-LABEL: tai.kernel @stencil(
//       SCATTER:   tai_mesh.exchange clear @x after 2
//       SCATTER:   tai_mesh.exchange collect @x after 2
tai.kernel @stencil() {
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c1) to (%c63) {
    %0 = tai.load @y[%i] : f32
    %below = arith.subi %i, %c1 : index
    %above = arith.addi %i, %c1 : index
    tai.atomic add %0, @x[%below] : f32
    tai.atomic add %0, @x[%above] : f32
  }
  tai.return
}

// The first row gets two terms, of rows 0 and 1: both are read at the index of
// the loop plus a constant, so that the rank of a row is known.
// CHECK-LABEL: tai.kernel @border(
//   CHECK-NOT:   tai_mesh.exchange {{clear|collect}}
//       CHECK:   tai_mesh.exchange fetch @y after 1
//       CHECK:   tai.atomic add %{{.*}}, @x[%{{.*}}] exclusive
// SCATTER-LABEL: tai.kernel @border(
//       SCATTER:   tai_mesh.exchange collect @x before 1
tai.kernel @border() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f32
    %1 = arith.subi %i, %c1 : index
    %below = arith.maxsi %1, %c0 : index
    tai.atomic add %0, @x[%below] : f32
  }
  tai.return
}

// One of two additions cannot be gathered: the loop stays as it is.
// CHECK-LABEL: tai.kernel @half(
//       CHECK:   tai_mesh.exchange clear @x before 1
//       CHECK:   tai_mesh.exchange clear @z after 1
//       CHECK:   tai.atomic add %{{.*}}, @x[%{{.*}}] :
//       CHECK:   tai_mesh.exchange collect @x before 1
tai.kernel @half() {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c1) to (%c64) {
    %0 = tai.load @y[%i] : f32
    %below = arith.subi %i, %c1 : index
    tai.atomic add %0, @x[%i] : f32
    tai.atomic add %0, @x[%below] : f32
    %above = arith.addi %i, %c1 : index
    tai.atomic sub %0, @z[%above] : f32
  }
  tai.return
}

// The terms are products of two neighbours, and a rank has one row: it cannot
// read rows at distance 2, and additions are collected instead.
// CHECK-LABEL: tai.kernel @narrow(
//       CHECK:   tai_mesh.exchange fetch @u
//       CHECK:   tai_mesh.exchange clear @v before 1
//       CHECK:   tai_mesh.exchange collect @v before 1
tai.kernel @narrow() {
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) = (%c1) to (%c3) {
    %below = arith.subi %i, %c1 : index
    %above = arith.addi %i, %c1 : index
    %0 = tai.load @u[%above] : f32
    %1 = tai.load @u[%i] : f32
    %2 = arith.mulf %0, %1 : f32
    tai.atomic add %2, @v[%i] : f32
    tai.atomic add %2, @v[%below] : f32
  }
  tai.return
}

// Data choose rows: terms of other iterations would read beyond the halo.
// CHECK-LABEL: tai.kernel @chosen(
//       CHECK:   tai_mesh.exchange clear @x before 1
//       CHECK:   tai_mesh.exchange collect @x before 1
tai.kernel @chosen() {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c1) to (%c64) {
    %row = tai.load @at[%i] : i32
    %at = arith.index_cast %row : i32 to index
    %0 = tai.load @y[%at] : f32
    %below = arith.subi %i, %c1 : index
    tai.atomic add %0, @x[%i] : f32
    tai.atomic add %0, @x[%below] : f32
  } {tai_mesh.halo = 3 : i64}
  tai.return
}
