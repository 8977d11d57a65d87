// Additions in fixed point, in deterministic mode on a GPU. The PTX is run with
// threads in random orders, and gives the bits of a model in Python that knows
// no order: also where all lanes of a warp add to one element.
//
// RUN: tai-opt %s --tai-to-nvvm=deterministic=true -o %t.nvvm.mlir
// RUN: tai-translate --tai-to-ptx --device-floats=strict %t.nvvm.mlir -o %t.ptx
// RUN: FileCheck %s < %t.ptx
// RUN: %python %S/fixed_point.py %t.ptx

tai.tree @t : !tai.root<dense<[i: 150], {at: i32, v: f32, w: f64}>,
                        dense<[i: 8], {a: f32, pad: f32, d: f64}>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @w = @t["w"] : f64, rank 1
tai.field @a = @t["a"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1

//   CHECK-LABEL: .entry single_0(
//         CHECK:   match.all.sync.b64
//         CHECK:   atom.global.max.u32
//   CHECK-LABEL: .entry single_1(
//     CHECK-DAG:   shfl.sync
//     CHECK-DAG:   atom.global.add.u64
//   CHECK-LABEL: .entry single_2(
//         CHECK:   cvt.rn.f32.f64
tai.kernel @single() {
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @a[%j] : f32
  }
  tai.return
}

//   CHECK-LABEL: .entry double_1(
// CHECK-COUNT-2:   atom.global.add.u64
tai.kernel @double() {
  tai.parallel_for (%i) in @v {
    %w = tai.load @w[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic sub %w, @d[%j] : f64
  }
  tai.return
}
