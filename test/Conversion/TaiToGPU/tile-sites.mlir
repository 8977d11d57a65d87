// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device=true --tai-lower-layout=on-device=true --convert-tai-to-gpu | FileCheck %s

// Loops whose iterations a program may run in tiles: `tai.tiles` has where the
// loop begins, and of each load and store an access as in loop-accesses.mlir;
// then whether it is regular, whether every iteration does it, and for each
// dimension the stride, the extent, the shift and whether that wraps. One
// iteration is a function of its own, whose addresses can be replaced.

tai.tree @tree : !tai.root<dense<[i: 16, j: 10, k: 8], {x: f32}>, dense<[i: 10, j: 8], {a: f32, b: f64}>, {n: i32}>
tai.field @x = @tree["x"] : f32, rank 3
tai.field @a = @tree["a"] : f32, rank 2
tai.field @b = @tree["b"] : f64, rank 2
tai.field @n = @tree["n"] : i32, rank 0

// The dimension of the row is that of the parameter.
// CHECK-LABEL: llvm.func @sweep_0(
//  CHECK-SAME:   tai.tiles = array<i64: 0, 0,
//  CHECK-SAME:   0, 1, 0, 4, 0, 4, 0, 0, 0, 1, 0, 64, 320, 1, 1, 32, 10, -1, 1, 4, 8, 0, 0,
//  CHECK-SAME:   0, 1, 0, 4, 0, 4, 0, 0, 0, 1, 0, 64, 320, 1, 1, 32, 10, 0, 0, 4, 8, 2, 1,
//  CHECK-SAME:   1, 1, 0, 4, 0, 4, 0, 0, 0, 1, 2, 64, 320, 1, 1, 32, 10, 0, 0, 4, 8, 0, 0>
// CHECK-LABEL: llvm.func @sweep_0_tile(
//  CHECK-SAME:   %[[I:[a-z0-9]+]]: i32, %[[J:[a-z0-9]+]]: i32)
//   CHECK-DAG:   arith.index_cast %[[I]] : i32 to index
//   CHECK-DAG:   arith.index_cast %[[J]] : i32 to index
//       CHECK:   %[[FIRST:.*]] = llvm.call @tai_tile_site(%{{.*}}, %{{.*}}) : (!llvm.ptr, i32) -> !llvm.ptr
//       CHECK:   llvm.load %[[FIRST]]
//       CHECK:   %[[SECOND:.*]] = llvm.call @tai_tile_site
//       CHECK:   llvm.load %[[SECOND]]
//       CHECK:   %[[LAST:.*]] = llvm.call @tai_tile_site
//       CHECK:   llvm.store %{{.*}}, %[[LAST]]
//   CHECK-NOT:   scf.for
//       CHECK:   llvm.return
tai.kernel @sweep(%t: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c10, %c8) {
    %next = arith.addi %t, %one : i32
    %from = arith.index_cast %t : i32 to index
    %to = arith.index_cast %next : i32 to index
    %low = arith.addi %i, %c9 : index
    %up = arith.remui %low, %c10 : index
    %0 = tai.load @x[%from, %up, %j] : f32
    %far = arith.addi %j, %c2 : index
    %right = arith.remui %far, %c8 : index
    %1 = tai.load @x[%from, %i, %right] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @x[%to, %i, %j] : f32
  }
  tai.return
}

// Inside of the borders the shift was taken out of the index; a store that not
// every iteration does is not certain, and reads from anywhere in a dimension
// are not regular.
// CHECK-LABEL: llvm.func @inside_0(
//  CHECK-SAME:   tai.tiles = array<i64: 1, 2,
//  CHECK-SAME:   0, 0, 0, 4, 0, 4, 0, 0, 0, 0, 1, 1, 128, 10, -1, 0, 16, 8, 1, 0,
//  CHECK-SAME:   0, 1, 0, 4, 0, 4, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0,
//  CHECK-SAME:   0, 0, 32, 1156, 16, 4, 0, 0, 16, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
//  CHECK-SAME:   1, 0, 8, 8, 0, 8, 0, 0, 0, 0, 1, 0, 128, 10, 0, 0, 16, 8, 0, 0>
tai.kernel @inside() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c7 = arith.constant 7 : index
  %c9 = arith.constant 9 : index
  %zero = arith.constant 0 : i32
  tai.parallel_for (%i, %j) = (%c1, %c2) to (%c9, %c7) {
    %up = arith.subi %i, %c1 : index
    %right = arith.addi %j, %c1 : index
    %0 = tai.load @a[%up, %right] : f32
    %n = tai.load @n[] : i32
    %isPositive = arith.cmpi sgt, %n, %zero : i32
    scf.if %isPositive {
      %any = arith.index_cast %n : i32 to index
      %1 = tai.load @a[%any, %j] : f32
      %2 = arith.addf %0, %1 : f32
      %3 = arith.extf %2 : f32 to f64
      tai.store %3, @b[%i, %j] : f64
    }
  }
  tai.return
}

// Sums may not be done twice.
// CHECK-LABEL: llvm.func @scatter_0(
//   CHECK-NOT:   tai.tiles
//   CHECK-NOT: @scatter_0_tile
tai.kernel @scatter() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c10 = arith.constant 10 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c10, %c8) {
    %0 = tai.load @a[%i, %j] : f32
    %n = tai.load @n[] : i32
    %any = arith.index_cast %n : i32 to index
    %1 = tai.atomic add %0, @a[%any, %j] : f32
    tai.store %0, @x[%c0, %i, %j] : f32
  }
  tai.return
}

// Nor is there anything to keep where nothing is stored.
// CHECK-LABEL: llvm.func @total_0(
//   CHECK-NOT:   tai.tiles
//   CHECK-NOT: @total_0_tile
tai.kernel @total() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c10 = arith.constant 10 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c10, %c8) {
    %0 = tai.load @a[%i, %j] : f32
    %1 = arith.fptosi %0 : f32 to i32
    %2 = tai.atomic add %1, @n[] : i32
  }
  tai.return
}
