// Elements that data choose: the threads of a warp compare them, and add up
// terms of the same one first. Not where a thread has an element of its own,
// adds to many, or adds f64; and not in strict and deterministic kernels.
//
// RUN: tai-opt %s --tai-to-nvvm -o %t.mlir
// RUN: tai-translate --tai-to-ptx %t.mlir | FileCheck %s
// RUN: tai-translate --tai-to-ptx --device-combine-scatters=false %t.mlir | FileCheck %s --check-prefix=OFF
// RUN: tai-translate --tai-to-ptx --device-floats=strict %t.mlir | FileCheck %s --check-prefix=OFF
//
// OFF-NOT: match.all

tai.tree @t : !tai.root<dense<[i: 5000], {at: i32, v: f32, w: f64}>,
                        dense<[i: 4096], {a: f32, d: f64, m: vector<2xf32>}>,
                        dense<[i: 5000], {own: f32}>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @w = @t["w"] : f64, rank 1
tai.field @a = @t["a"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @m = @t["m"] : vector<2xf32>, rank 1
tai.field @own = @t["own"] : f32, rank 1

// CHECK-LABEL: .entry one_0(
// CHECK-COUNT-1: match.all.sync.b64
// CHECK-NOT: match
// CHECK-COUNT-5: shfl.sync.down.b32
// CHECK-NOT: shfl.sync.down
// CHECK-COUNT-5: shfl.sync.bfly.b32
// CHECK-NOT: shfl
// CHECK: ret
tai.kernel @one() {
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @a[%j] : f32
  }
  tai.return
}

// One comparison for both components.
// CHECK-LABEL: .entry vector_0(
// CHECK-COUNT-1: match.all.sync.b64
// CHECK-NOT: match
// CHECK-COUNT-5: shfl.sync.bfly.b32
// CHECK-NOT: shfl.sync.bfly
// CHECK: ret
tai.kernel @vector() {
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    %x = vector.broadcast %v : f32 to vector<2xf32>
    tai.atomic add %x, @m[%j] : vector<2xf32>
  }
  tai.return
}

// CHECK-LABEL: .entry each_0(
// CHECK-NOT: match
// CHECK: ret
tai.kernel @each() {
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    tai.atomic add %v, @own[%i] : f32
  }
  tai.return
}

// CHECK-LABEL: .entry double_0(
// CHECK-NOT: match
// CHECK: ret
tai.kernel @double() {
  tai.parallel_for (%i) in @v {
    %w = tai.load @w[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %w, @d[%j] : f64
  }
  tai.return
}

// A place in the history of each particle: the number of the thread takes part.
// CHECK-LABEL: .entry history_0(
// CHECK-NOT: match
// CHECK: ret
tai.kernel @history() {
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    %k = arith.addi %i, %j : index
    tai.atomic add %v, @a[%k] : f32
  }
  tai.return
}

// Five neighbours.
// CHECK-LABEL: .entry stencil_0(
// CHECK-NOT: match
// CHECK: ret
tai.kernel @stencil() {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j0 = arith.index_cast %at : i32 to index
    %j1 = arith.addi %j0, %c1 : index
    %j2 = arith.addi %j1, %c1 : index
    %j3 = arith.addi %j2, %c1 : index
    %j4 = arith.addi %j3, %c1 : index
    tai.atomic add %v, @a[%j0] : f32
    tai.atomic add %v, @a[%j1] : f32
    tai.atomic add %v, @a[%j2] : f32
    tai.atomic add %v, @a[%j3] : f32
    tai.atomic add %v, @a[%j4] : f32
  }
  tai.return
}
