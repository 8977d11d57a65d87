// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-ptx | FileCheck %s

// The expected code of simple kernels: indices of 32 bits without divisions by
// extents that are powers of two, loads past the cache of writes, vectors as
// one access, sums and products in one operation, and one addition to memory
// for a scatter of a vector.

tai.tree @t : !tai.root<dense<[i: 4096, j: 4096], {x: vector<4xf32>}>, dense<[i: 1024, j: 1024], {p: f32}>, dense<[i: 1024, j: 1024], {q: f32}>, dense<[i: 2048, j: 2048], {large: f32}>, dense<[i: 2048, j: 2048], {result: f32}>, dense<[i: 4096], {sums: vector<2xf32>}>, dense<[i: 64, j: 64], {momentum: vector<2xf32>, mass: f32, rest: f32}>>
tai.field @x = @t["x"] : vector<4xf32>, rank 2
tai.field @p = @t["p"] : f32, rank 2
tai.field @q = @t["q"] : f32, rank 2
tai.field @large = @t["large"] : f32, rank 2
tai.field @result = @t["result"] : f32, rank 2
tai.field @sums = @t["sums"] : vector<2xf32>, rank 1

tai.field @momentum = @t["momentum"] : vector<2xf32>, rank 2
tai.field @mass = @t["mass"] : f32, rank 2
tai.field @rest = @t["rest"] : f32, rank 2

// CHECK-LABEL: .entry scale_0(
//   CHECK-NOT: {{(div|rem)[.]}}
//       CHECK: mad.lo.s32
//       CHECK: mul.wide.{{[us]}}32
//       CHECK: ld.global.v4.b32
//       CHECK: st.global.v4.b32
//   CHECK-NOT: .local
tai.kernel @scale(%a: f32) {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : vector<4xf32>
    %1 = vector.broadcast %a : f32 to vector<4xf32>
    %2 = arith.mulf %0, %1 : vector<4xf32>
    tai.store %2, @x[%i, %j] : vector<4xf32>
  }
  tai.return
}

// CHECK-LABEL: .entry average_0(
//   CHECK-NOT: {{(div|rem)[.]}}
//   Four iterations at a time: first all loads, then all stores.
// CHECK-COUNT-8: ld.global.nc.b32
// CHECK-COUNT-4: st.global.b32
//       CHECK: bra
//   The remaining code, with one counter for the loop.
//       CHECK: ld.global.nc.b32
//   CHECK-NOT: {{(div|rem)[.]}}
//       CHECK: ld.global.nc.b32
//       CHECK: fma.rn.f32
//       CHECK: st.global.b32
//       CHECK: add.s32 [[I:%r[0-9]+]], [[I]], [[STRIDE:%r[0-9]+]];
//   CHECK-NOT: , [[STRIDE]];
//       CHECK: bra
tai.kernel @average(%a: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c1023 = arith.constant 1023 : index
  tai.parallel_for (%i, %j) in @p {
    %left = arith.subi %j, %c1 : index
    %inside = arith.maxsi %left, %c0 : index
    %0 = tai.load @p[%i, %inside] : f32
    %1 = tai.load @p[%i, %j] : f32
    %2 = arith.mulf %0, %a : f32
    %3 = arith.addf %1, %2 : f32
    tai.store %3, @q[%i, %j] : f32
  }
  tai.return
}

// CHECK-LABEL: .entry scatter_0(
//       CHECK: red.relaxed.gpu.global.add.v2.f32
//   CHECK-NOT: atom
//       CHECK: ret;
tai.kernel @scatter(%a: vector<2xf32>) {
  tai.parallel_for (%i, %j) in @p {
    %0 = tai.load @p[%i, %j] : f32
    %1 = arith.fptosi %0 : f32 to i32
    %2 = arith.index_cast %1 : i32 to index
    %3 = tai.atomic add %a, @sums[%2] : vector<2xf32>
  }
  tai.return
}

// In a large array, four elements for each thread. Inside: three vectors, two
// neighbours, one vector.
// CHECK-LABEL: .entry stencil_0(
//   CHECK-NOT: {{(div|rem)[.]}}
//       CHECK: ld.global.nc.v4.b32
//   CHECK-NOT: bra
//       CHECK: ld.global.nc.v4.b32
//   CHECK-NOT: bra
//       CHECK: ld.global.nc.b32
//   CHECK-NOT: {{bra|ld[.]}}
//       CHECK: ld.global.nc.v4.b32
//   CHECK-NOT: bra
//       CHECK: ld.global.nc.b32
//   CHECK-NOT: {{bra|ld[.]}}
//       CHECK: st.global.v4.b32
//   CHECK-NOT: .v4
//       CHECK: ret;
tai.kernel @stencil(%a: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2047 = arith.constant 2047 : index
  tai.parallel_for (%i, %j) = (%c1, %c1) to (%c2047, %c2047) {
    %up = arith.subi %i, %c1 : index
    %0 = tai.load @large[%up, %j] : f32
    %down = arith.addi %i, %c1 : index
    %1 = tai.load @large[%down, %j] : f32
    %left = arith.subi %j, %c1 : index
    %2 = tai.load @large[%i, %left] : f32
    %right = arith.addi %j, %c1 : index
    %3 = tai.load @large[%i, %right] : f32
    %4 = arith.addf %0, %1 : f32
    %5 = arith.addf %4, %2 : f32
    %6 = arith.addf %5, %3 : f32
    %7 = arith.mulf %6, %a : f32
    tai.store %7, @result[%i, %j] : f32
  }
  tai.return
}

// Fields of one cell are added to at once, and neighbours are told by constants.
// CHECK-LABEL: .entry nodes_0(
//       CHECK: red.relaxed.gpu.global.add.v4.f32 [[[NODE:%rd[0-9]+]]]
//       CHECK: add.s64 [[NEXT:%rd[0-9]+]], {{.+}}, 1040;
//       CHECK: red.relaxed.gpu.global.add.v4.f32 [[[NEXT]]]
//   CHECK-NOT: {{atom|red}}
//       CHECK: ret;
tai.kernel @nodes(%a: f32) {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c1 = arith.constant 1 : i32
  %zero = arith.constant 0.0 : f32
  %v = vector.broadcast %a : f32 to vector<2xf32>
  tai.parallel_for (%p) = (%c0) to (%c64) {
    %x = tai.load @p[%p, %p] : f32
    %cell = arith.fptosi %x : f32 to i32
    %0 = arith.index_cast %cell : i32 to index
    %1 = tai.atomic add %v, @momentum[%0, %0] : vector<2xf32>
    %2 = tai.atomic add %a, @mass[%0, %0] : f32
    %3 = tai.atomic add %zero, @rest[%0, %0] : f32
    %next = arith.addi %cell, %c1 : i32
    %4 = arith.index_cast %next : i32 to index
    %5 = tai.atomic add %v, @momentum[%4, %4] : vector<2xf32>
    %6 = tai.atomic add %a, @mass[%4, %4] : f32
    %7 = tai.atomic add %zero, @rest[%4, %4] : f32
  }
  tai.return
}
