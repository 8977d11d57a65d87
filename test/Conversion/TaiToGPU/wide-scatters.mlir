// On a GPU additions of 16-bit floats, and those of kernels with compensated
// sums, are rounded once.
//
// RUN: tai-opt %s --tai-scalarize --tai-lower-struct-for --tai-relax-atomics="on-device=true" -o %t.relaxed.mlir
// RUN: FileCheck %s --check-prefix=RELAX < %t.relaxed.mlir
// RUN: tai-opt %t.relaxed.mlir --tai-lower-layout=on-device=true --convert-tai-to-gpu -o %t.gpu.mlir
// RUN: FileCheck %s --check-prefix=GPU < %t.gpu.mlir
// RUN: FileCheck %s --check-prefix=HOST < %t.gpu.mlir

tai.tree @t : !tai.root<dense<[i: 100], {at: i32, v: f32, w: f64}>,
                        dense<[i: 7], {h: f16, s: f32, d: f64}>,
                        dense<[i: 40000000], {large: f16}>,
                        dense<[i: 3], {few: f32}>>
tai.tree @sparse : !tai.root<pointer<[i: 16], dense<[i: 16], {p: f16}>>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @w = @t["w"] : f64, rank 1
tai.field @h = @t["h"] : f16, rank 1
tai.field @s = @t["s"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @large = @t["large"] : f16, rank 1
tai.field @few = @t["few"] : f32, rank 1
tai.field @p = @sparse["p"] : f16, rank 1

// One number of f64 for each element.
// RELAX-LABEL: tai.kernel @halves
//       RELAX: tai.atomic sub {{.+}}, @h[{{.+}}] reduction <buffer wide any buffer 0> : f16
//  HOST-LABEL: llvm.func @halves(
//        HOST:   arith.constant 56 : i64
//        HOST:   llvm.call @tai_rt_device_scratch
//        HOST:   gpu.launch_func @kernels::@halves_0
//        HOST:   gpu.launch_func @kernels::@halves_1
tai.kernel @halves() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %x = arith.truncf %v : f32 to f16
    tai.atomic sub %x, @h[%j] : f16
  }
  tai.return
}

// A sum and its error; a total of f64, too, while blocks add up f32 in f64.
// RELAX-LABEL: tai.kernel @compensated
//       RELAX: tai.atomic add {{.+}}, @d[{{.+}}] reduction <buffer pair any buffer {{.+}}> : f64
//       RELAX: tai.atomic add {{.+}}, @d[{{.+}}] reduction <buffer pair any buffer {{.+}}> : f64
//       RELAX: tai.atomic add {{.+}}, @s[{{.+}}] reduction <register wide any> : f32
//  HOST-LABEL: llvm.func @compensated(
//        HOST:   llvm.call @tai_rt_device_scratch
tai.kernel @compensated() attributes {modes = {sums = "compensated"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %w = tai.load @w[%i] : f64
    %v = tai.load @v[%i] : f32
    tai.atomic add %w, @d[%j] : f64
    tai.atomic add %w, @d[%c1] : f64
    tai.atomic add %v, @s[%c0] : f32
  }
  tai.return
}

// For f32, if there are more than 2^15 for each element.
// RELAX-LABEL: tai.kernel @many
//       RELAX: tai.atomic add {{.+}}, @few[{{.+}}] reduction <buffer wide any buffer 0> : f32
//       RELAX: tai.atomic add {{.+}}, @few[{{[^ ]+}}] : f32
tai.kernel @many() {
  %c0 = arith.constant 0 : index
  %c98304 = arith.constant 98304 : index
  %c98305 = arith.constant 98305 : index
  tai.parallel_for (%i) = (%c0) to (%c98305) {
    %k = arith.remui %i, %c98304 : index
    %j32 = tai.load @at[%k] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%k] : f32
    tai.atomic add %v, @few[%j] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c98304) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    tai.atomic add %v, @few[%j] : f32
  }
  tai.return
}

// Sums beside it would take more memory than a launch may, and a cell may have
// to become active first; other numbers are added as they are.
// RELAX-LABEL: tai.kernel @plain
//   RELAX-NOT: private
//       RELAX: tai.return
tai.kernel @plain() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %w = tai.load @w[%i] : f64
    %x = arith.truncf %v : f32 to f16
    tai.atomic add %x, @large[%j] : f16
    tai.atomic add %x, @p[%j] : f16
    tai.atomic add %v, @s[%j] : f32
    tai.atomic add %w, @d[%j] : f64
  }
  tai.return
}

//   GPU-LABEL: llvm.func @halves_0(
//         GPU:   %[[WIDE:.+]] = arith.extf {{.+}} : f16 to f64
//         GPU:   llvm.call @tai_dev_wide_add_f32({{.+}}, %[[WIDE]])
//     GPU-NOT:   atomicrmw
//   GPU-LABEL: llvm.func @halves_1(
//         GPU:   arith.truncf {{.+}} : f64 to f16
//   GPU-LABEL: llvm.func @compensated_0(
// GPU-COUNT-2:   llvm.call @tai_dev_wide_add_f64
//   GPU-LABEL: llvm.func @compensated_2(
//         GPU:   %[[TOTAL:.+]] = llvm.call @tai_dev_wide_take_f64
//         GPU:   llvm.store %[[TOTAL]], {{.+}} : f64
