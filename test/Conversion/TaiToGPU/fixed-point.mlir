// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics=on-device=true -o %t.relaxed.mlir
// RUN: FileCheck %s --check-prefix=RELAX < %t.relaxed.mlir
// RUN: tai-opt %t.relaxed.mlir --tai-lower-layout=on-device=true --convert-tai-to-gpu -o %t.gpu.mlir
// RUN: FileCheck %s --check-prefix=GPU < %t.gpu.mlir
// RUN: FileCheck %s --check-prefix=HOST < %t.gpu.mlir
// RUN: tai-opt %t.relaxed.mlir --tai-lower-layout="on-device=true bounds-check=true" --convert-tai-to-gpu | FileCheck %s --check-prefix=CHECKED
// RUN: tai-opt %s --tai-relax-atomics=on-device=true | FileCheck %s --check-prefix=ANY-ORDER

// In deterministic mode, a GPU adds to elements that the data chooses in fixed
// point, whose result does not depend on the order.

// ANY-ORDER-NOT: reduction <fixed

tai.tree @t : !tai.root<dense<[i: 20000], {at: i32, v: f32, y: f32, count: i32}>, dense<[i: 4, j: 50], {m: vector<2xf32>, d: f64}>, dense<[i: 100], {one: f32, other: f32}>, {total: f32}>
tai.tree @large : !tai.root<dense<[i: 100000000], {far: f32}>>
tai.tree @s : !tai.root<pointer<[i: 16], dense<[i: 16], {p: f32}>>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @count = @t["count"] : i32, rank 1
tai.field @m = @t["m"] : vector<2xf32>, rank 2
tai.field @d = @t["d"] : f64, rank 2
tai.field @one = @t["one"] : f32, rank 1
tai.field @total = @t["total"] : f32, rank 0
tai.field @far = @large["far"] : f32, rank 1
tai.field @p = @s["p"] : f32, rank 1

// A pass for the scales, one for the sums, and one over the elements.
// RELAX-LABEL: tai.kernel @scatter
//       RELAX:   tai.atomic sub %{{.+}}, @one[%{{.+}}] reduction <fixed own any buffer 0> : f32
//   GPU-LABEL: llvm.func @scatter_0(
//       GPU:     llvm.call @tai_dev_fixed_scale_f32(
//   GPU-NOT:     @tai_dev_fixed_
//   GPU-LABEL: llvm.func @scatter_1(
//       GPU:     arith.negf
//       GPU:     llvm.call @tai_dev_fixed_add_f32(
//   GPU-NOT:     @tai_dev_fixed_
//   GPU-LABEL: llvm.func @scatter_2(
//       GPU:     arith.constant 100 : index
//       GPU:     scf.for
//       GPU:       llvm.call @tai_dev_fixed_round_f32(
//   GPU-NOT:     arith.negf
// CHECKED-LABEL: llvm.func @scatter_1(
//       CHECKED:   scf.if
//       CHECKED:     llvm.call @tai_dev_fixed_add_f32(
tai.kernel @scatter() {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic sub %v, @one[%j] : f32
  }
  tai.return
}

// For a time slot and vectors there are accumulators for the varying part.
// Other effects are those of the last pass, which is over the iterations then.
// RELAX-LABEL: tai.kernel @effects
// RELAX-COUNT-2: reduction <fixed own any buffer
//       RELAX:   reduction <register own lanes>
//  HOST-LABEL: llvm.func @effects(%
//  HOST-COUNT-2: llvm.call @tai_rt_device_scratch(%{{.+}}, %c1{{[02]}}00_i64
//       HOST:    gpu.launch_func @kernels::@effects_0
//       HOST:    gpu.launch_func @kernels::@effects_1
//       HOST:    gpu.launch_func @kernels::@effects_2
//   GPU-LABEL: llvm.func @effects_0(
//   GPU-NOT:     llvm.store
//       GPU:     llvm.call @tai_dev_fixed_scale_f32(
//       GPU:     llvm.call @tai_dev_fixed_scale_f64(
//   GPU-NOT:     atomicrmw
//   GPU-LABEL: llvm.func @effects_1(
//   GPU-NOT:     llvm.store
//       GPU:     llvm.call @tai_dev_fixed_add_f32(
//       GPU:     llvm.call @tai_dev_fixed_add_f64(
//   GPU-NOT:     atomicrmw
//   GPU-LABEL: llvm.func @effects_2(
//       GPU:     llvm.call @tai_dev_fixed_round_f32(
//       GPU:     llvm.call @tai_dev_fixed_round_f64(
//       GPU:     llvm.atomicrmw add
//       GPU:     llvm.store
tai.kernel @effects(%t: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    %wide = arith.extf %v : f32 to f64
    tai.atomic add %v, @m[%t, %j] component [%c1] : f32
    tai.atomic add %wide, @d[%t, %j] : f64
    tai.atomic add %v, @total[] : f32
    tai.atomic add %at, @count[%j] : i32
    tai.store %v, @y[%i] : f32
  }
  tai.return
}

// An iteration has stacks of its own each time.
// RELAX-LABEL: tai.kernel @stacks
//       RELAX:   reduction <fixed
//   GPU-LABEL: llvm.func @stacks_0(
//       GPU:     call @tai_dev_fixed_scale_f32(
//   GPU-LABEL: llvm.func @stacks_1(
//       GPU:     call @tai_dev_fixed_add_f32(
tai.kernel @stacks() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    %stack = tai.stack_create : !tai.stack<f32>
    scf.for %k = %c0 to %j step %c1 {
      tai.stack_push %v, %stack : f32
    }
    scf.for %k = %c0 to %j step %c1 {
      %w = tai.stack_pop %stack : f32
      tai.atomic add %w, @one[%k] : f32
    }
    tai.stack_destroy %stack : !tai.stack<f32>
  }
  tai.return
}

// A warp or a thread does the rest.

// A value that an iteration reads after its own write would be missing.
// RELAX-LABEL: tai.kernel @reads_its_own
//   RELAX-NOT:   reduction <fixed
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
tai.kernel @reads_its_own() {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    tai.store %v, @y[%i] : f32
    %w = tai.load @y[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %w, @one[%j] : f32
  }
  tai.return
}

// The order of the program is that of all targets.
// RELAX-LABEL: tai.kernel @strict
//   RELAX-NOT:   reduction <fixed
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
tai.kernel @strict() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @one[%j] : f32
  }
  tai.return
}

// Few iterations do not pay for three launches.
// RELAX-LABEL: tai.kernel @few
//   RELAX-NOT:   reduction <fixed
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
tai.kernel @few() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @one[%j] : f32
  }
  tai.return
}

// More memory than a launch may take.
// RELAX-LABEL: tai.kernel @too_large
//   RELAX-NOT:   reduction <fixed
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
tai.kernel @too_large() {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @far[%j] : f32
  }
  tai.return
}

// An addition may have to make a cell active; and an old value is used.
// RELAX-LABEL: tai.kernel @others
//   RELAX-NOT:   reduction <fixed
//       RELAX: serialize
//   RELAX-NOT:   reduction <fixed
//       RELAX: serialize
tai.kernel @others() {
  %c0 = arith.constant 0 : index
  %c20000 = arith.constant 20000 : index
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    tai.atomic add %v, @p[%j] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c20000) {
    %v = tai.load @v[%i] : f32
    %at = tai.load @at[%i] : i32
    %j = arith.index_cast %at : i32 to index
    %old = tai.atomic add %v, @one[%j] : f32
    tai.store %old, @y[%i] : f32
  }
  tai.return
}
