// RUN: tai-opt %s --tai-to-nvvm | FileCheck %s

// On a GPU, sums over many iterations into one 16-bit number: threads and blocks
// add up in f64, and a second function adds the sum once. Rounded after each
// addition it would stop growing at 2048 of its terms, or at 256.

tai.tree @t : !tai.root<dense<[i: 4096], {x: f16, y: bf16}>, {s: f16, b: bf16}>
tai.field @x = @t["x"] : f16, rank 1
tai.field @y = @t["y"] : bf16, rank 1
tai.field @s = @t["s"] : f16, rank 0
tai.field @b = @t["b"] : bf16, rank 0

// CHECK-LABEL: llvm.func @half_0(
//   CHECK-NOT:   atomicrmw
//       CHECK:   llvm.call @tai_dev_reduce_add_f64(
//   CHECK-NOT:   atomicrmw
// CHECK-LABEL: llvm.func @half_1(
//       CHECK:   llvm.fptrunc %{{.+}} : f64 to f16
//       CHECK:   llvm.atomicrmw fadd %{{.+}} : !llvm.ptr, f16
tai.kernel @half() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f16
    %0 = tai.atomic add %v, @s[] : f16
  }
  tai.return
}

// CHECK-LABEL: llvm.func @brain_0(
//       CHECK:   llvm.call @tai_dev_reduce_add_f64(
// CHECK-LABEL: llvm.func @brain_1(
//       CHECK:   llvm.fptrunc %{{.+}} : f64 to bf16
tai.kernel @brain() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @y[%i] : bf16
    %0 = tai.atomic add %v, @b[] : bf16
  }
  tai.return
}

// A few are added one by one.
// CHECK-LABEL: llvm.func @few_0(
//   CHECK-NOT:   reduce
//       CHECK:   llvm.atomicrmw fadd %{{.+}} : !llvm.ptr, f16
tai.kernel @few() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %v = tai.load @x[%i] : f16
    %0 = tai.atomic add %v, @s[] : f16
  }
  tai.return
}
