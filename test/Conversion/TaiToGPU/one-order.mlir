// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics | FileCheck %s --check-prefixes=RELAX,HOST
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics=on-device=true | FileCheck %s --check-prefixes=RELAX,DEVICE
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s --check-prefix=CPU
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics=on-device=true --tai-lower-layout=on-device=true --convert-tai-to-gpu | FileCheck %s --check-prefix=GPU

// Strict and deterministic kernels add up in one order on all targets.

tai.tree @t : !tai.root<dense<[i: 20000], {at: i32, v: f64}>, dense<[i: 8], {g: f64}>, {total: f64, most: f64, count: i32, h: f16}>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f64, rank 1
tai.field @g = @t["g"] : f64, rank 1
tai.field @total = @t["total"] : f64, rank 0
tai.field @most = @t["most"] : f64, rank 0
tai.field @count = @t["count"] : i32, rank 0
tai.field @h = @t["h"] : f16, rank 0

// 20000 iterations are 27 chunks of 768, in 256 lanes of f64. Sums of integers
// and extremes stay sums of partitions.
// RELAX-LABEL: tai.kernel @sums
//       RELAX: tai.atomic add %{{.+}}, @total[] reduction <register own common>
//   CPU-LABEL: llvm.func @sums(
//       CPU:     %[[COUNT:.+]] = arith.constant 27 : i64
//       CPU:     tai_rt_parts(%{{.+}}, %[[COUNT]]
//       CPU:     llvm.call @tai_rt_parallel_for
//       CPU:     scf.for %{{.+}} = %{{.+}} to %c108
//   CPU-LABEL: llvm.func internal @sums.loop0(
//       CPU:     llvm.alloca %{{.+}} x !llvm.array<256 x i64>
//       CPU:     scf.for %[[CHUNK:.+]] =
//       CPU:       arith.constant -0.000000e+00 : f64
//       CPU:       scf.for
//       CPU:         scf.for
//       CPU:           arith.addf %{{.+}}, %{{.+}} : f64
//       CPU:       scf.for %{{.+}} = %{{.+}} to %c128
//       CPU:       scf.for %{{.+}} = %{{.+}} to %c4
//   GPU-LABEL: llvm.func @sums_0(
//       GPU:     %[[LANES:.+]] = arith.constant 6912 : index
//       GPU:     scf.for %[[LANE:.+]] = %{{.+}} to %[[LANES]]
//       GPU:       %[[LENGTH:.+]] = arith.constant 768 : index
//       GPU:       arith.divui %[[LANE]], %{{.+}}
//       GPU:       arith.remui %[[LANE]], %{{.+}}
//       GPU:       scf.for
//   GPU-LABEL: llvm.func @sums_1(
//       GPU:     arith.remui %{{.+}}, %{{.+}}
//       GPU:     scf.for %{{.+}} = %{{.+}} to %c128{{.*}} step %c4
tai.kernel @sums() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f64
    %h = arith.truncf %v : f64 to f16
    tai.atomic add %v, @total[] : f64
    tai.atomic max %v, @most[] : f64
    tai.atomic add %one, @count[] : i32
    tai.atomic sub %h, @h[] : f16
  }
  tai.return
}

// Additions that meet are in the order of iterations: on a CPU by one thread.
// No part of the field is copied. On a GPU threads of a warp take turns; where
// an element may get two additions of an iteration, one thread does all. A sum
// of all iterations that meets such a loop takes its turns as well.
// RELAX-LABEL: tai.kernel @scatter
//        HOST:   serialize
//        HOST:   tai.atomic add %{{.+}}, @g[%{{.+}}] exclusive : f64
//        HOST:   tai.atomic add %{{.+}}, @total[] exclusive : f64
//      DEVICE:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f64
//      DEVICE:   tai.atomic add %{{.+}}, @total[] : f64
//      DEVICE: } {in_warp, order = #tai.loop_order<common>}
//   GPU-LABEL: llvm.func @scatter_0(
//       GPU:     %[[TURNS:.+]] = llvm.call @tai_dev_ordered_turns(
//       GPU:     llvm.call @tai_dev_ordered_append_f64(%[[TURNS]],
tai.kernel @scatter() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @g[%j] : f64
    tai.atomic add %v, @total[] : f64
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @two_sites
//       RELAX: serialize
tai.kernel @two_sites() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    %k = arith.addi %j, %c1 : index
    tai.atomic add %v, @g[%j] : f64
    tai.atomic add %v, @g[%k] : f64
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @inner_loop
//       RELAX: serialize
tai.kernel @inner_loop() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    scf.for %k = %c0 to %c3 step %c1 {
      tai.atomic add %v, @g[%j] : f64
    }
  }
  tai.return
}

// Without strict floats, the targets choose for themselves.
// RELAX-LABEL: tai.kernel @own_orders
//       RELAX:   reduction <{{buffer|fixed}} own any buffer 0>
//  DEVICE-NOT: in_warp
tai.kernel @own_orders() {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f64
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @g[%j] : f64
  }
  tai.return
}

// Few iterations are not simply added one after another, as they are on one
// thread of a CPU otherwise: a device has the lanes.
// RELAX-LABEL: tai.kernel @few
//       RELAX:   reduction <register
//   RELAX-NOT:   serialize
//       RELAX: tai.return
//   CPU-LABEL: llvm.func internal @few.loop0(
tai.kernel @few() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) = (%c0) to (%c3) {
    %v = tai.load @v[%i] : f64
    tai.atomic add %v, @total[] : f64
  }
  tai.return
}
