// Additions that meet in memory, in deterministic mode: a warp does them
// together. The PTX is run with threads in random orders, and gives the bits
// of a model of the order in Python. Threads without an iteration must not read
// the writes of others: an index, say.
//
// RUN: tai-opt %s --tai-to-nvvm=deterministic=true -o %t.nvvm.mlir
// RUN: tai-translate --tai-to-ptx --device-floats=strict %t.nvvm.mlir -o %t.ptx
// RUN: FileCheck %s < %t.ptx
// RUN: %python %S/ordered_additions.py %t.ptx
// RUN: tai-translate --tai-to-ptx --device-floats=strict --device-target=sm_75 \
// RUN:   %t.nvvm.mlir -o %t.75.ptx
// RUN: %python %S/ordered_additions.py %t.75.ptx

tai.tree @t : !tai.root<dense<[i: 70], {at: i32, v: f32, w: f64}>,
                        dense<[i: 8], {a: f32, b: f32, d: f64}>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @w = @t["w"] : f64, rank 1
tai.field @a = @t["a"] : f32, rank 1
tai.field @b = @t["b"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1

// One question for all additions to one cell; no atomic operation is left.
// CHECK-LABEL: .entry scatter_0(
//       CHECK: .maxntid 32
//   CHECK-NOT: {{atom|red[.]}}
//       CHECK: bar.warp.sync
//       CHECK: match.any.sync.b64
//       CHECK: vote.sync.any.pred
//       CHECK: shfl.sync.idx.b32
//       CHECK: ld.global.b32
//       CHECK: st.global.b32
//       CHECK: bar.warp.sync
//   CHECK-NOT: match.any
//       CHECK: ld.global.b32
//       CHECK: st.global.b32
//       CHECK: bar.warp.sync
//       CHECK: match.any.sync.b64
//   CHECK-NOT: {{atom|red[.]}}
//       CHECK: ret;
tai.kernel @scatter() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c7 = arith.constant 7 : index
  %n = arith.constant 70 : index
  %zero = arith.constant 0.0 : f32
  %nowhere = arith.constant 100000000 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %w = tai.load @w[%i] : f64
    tai.atomic add %v, @a[%j] : f32
    tai.atomic sub %v, @b[%j] : f32
    %positive = arith.cmpf ogt, %v, %zero : f32
    scf.if %positive {
      tai.atomic add %w, @d[%j] : f64
      %twice = arith.addf %v, %v : f32
      tai.store %twice, @v[%i] : f32
    } else {
      %other = arith.subi %c7, %j : index
      tai.atomic add %v, @a[%other] : f32
    }
    tai.store %nowhere, @at[%i] : i32
    scf.for %k = %c0 to %c3 step %c1 {
      tai.atomic add %v, @b[%k] : f32
    }
  }
  tai.return
}

// In strict kernels, in the order of the iterations, as if one thread did them.
// CHECK-LABEL: .entry turns_0(
//       CHECK: .maxntid 32
//   CHECK-NOT: {{atom|red[.]}}
//       CHECK: match.any.sync.b64
//       CHECK: ld.global.b32
//       CHECK: shfl.sync.idx.b32
//       CHECK: st.global.b32
//   CHECK-NOT: {{atom|red[.]}}
//       CHECK: ret;
tai.kernel @turns() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %n = arith.constant 70 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %w = tai.load @w[%i] : f64
    tai.atomic add %v, @a[%j] : f32
    tai.atomic sub %v, @b[%j] : f32
    %positive = arith.cmpf ogt, %v, %zero : f32
    scf.if %positive {
      tai.atomic add %w, @d[%j] : f64
    }
  }
  tai.return
}
