// Sums on a GPU that are rounded once. The PTX is run with threads in random
// orders, and is right to twice the digits of its terms: also where all lanes
// of a warp add to one element.
//
// RUN: tai-opt %s --tai-to-nvvm -o %t.nvvm.mlir
// RUN: tai-translate --tai-to-ptx %t.nvvm.mlir -o %t.ptx
// RUN: FileCheck %s < %t.ptx
// RUN: %python %S/wide_sums.py %t.ptx

tai.tree @t : !tai.root<dense<[i: 150], {at: i32, v: f32, w: f64}>,
                        dense<[i: 8], {a: f32, pad: f32, d: f64}>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @w = @t["w"] : f64, rank 1
tai.field @a = @t["a"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1

//   CHECK-LABEL: .entry single_0(
//         CHECK:   match.all.sync.b64
//     CHECK-DAG:   shfl.sync
//     CHECK-DAG:   add.rn.f64
//   CHECK-LABEL: .entry single_1(
//         CHECK:   cvt.rn.f32.f64
tai.kernel @single() attributes {modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @v {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @a[%j] : f32
  }
  tai.return
}

// The old value, and the error that follows from it.
//   CHECK-LABEL: .entry double_0(
//     CHECK-NOT:   {{(add|sub)}}.f64
//         CHECK:   atom.{{.*}}add.f64
// CHECK-COUNT-7:   {{(add|sub)}}.rn.f64
//         CHECK:   atom.{{.*}}add.f64
//     CHECK-NOT:   {{(add|sub)}}.f64
//   CHECK-LABEL: .entry double_1(
tai.kernel @double() attributes {modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @v {
    %w = tai.load @w[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic sub %w, @d[%j] : f64
  }
  tai.return
}

// The error is that of adding the rounded product, which memory adds.
//   CHECK-LABEL: .entry product_0(
//     CHECK-NOT:   fma
//         CHECK:   mul.f64
//     CHECK-NOT:   fma
//         CHECK:   atom.{{.*}}add.f64
//     CHECK-NOT:   fma
//         CHECK:   ret;
tai.kernel @product() attributes {modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @v {
    %w = tai.load @w[%i] : f64
    %x = arith.mulf %w, %w : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %x, @d[%j] : f64
  }
  tai.return
}
