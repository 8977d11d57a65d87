// RUN: tai-opt %s --tai-to-nvvm | FileCheck %s
// RUN: tai-opt %s --tai-to-nvvm="emulated=true" | FileCheck %s --check-prefix=EMULATED
// RUN: tai-opt %s --tai-to-nvvm="debug=true" | FileCheck %s --check-prefix=DEBUG

// From a kernel to device functions and a part for the host in one pipeline.

tai.tree @flat : !tai.root<dense<[i: 128, j: 64], {x: vector<2xf32>}>, dense<[i: 128, j: 64], {y: f32}>, {loss: f32}>
tai.field @x = @flat["x"] : vector<2xf32>, rank 2
tai.field @y = @flat["y"] : f32, rank 2
tai.field @loss = @flat["loss"] : f32, rank 0

// CHECK-LABEL: gpu.module @kernels
//   CHECK-NOT: {{ (arith|scf|cf|vector|math|tai|func)[.]}}
//   Accesses of both components, of the norm, and of the sum.
//       CHECK: llvm.func @norms_0({{.+}}) attributes {gpu.kernel, no_unwind, nvvm.kernel,
//  CHECK-SAME:   tai.accesses = array<i64: 1, 2, 128, 64,
//  CHECK-SAME:   0, 0, 0, 4, 8, 4, 0, 512, 8, 0, 0, 0, 4, 4, 8, 4, 0, 512, 8, 0,
//  CHECK-SAME:   1, 2, 0, 4, 4, 4, 0, 256, 4, 0, 2, 3, 0, 4, 0, 4, 0, 0, 0, 0>}
//   Small trees have small indices.
//       CHECK:   nvvm.read.ptx.sreg.tid.x : i32
//       CHECK:   llvm.call @__nv_expf
//       CHECK:   llvm.call @tai_dev_reduce_add_f32
// CHECK-LABEL: llvm.func @norms(%{{.+}}: !llvm.ptr) -> i32
//       CHECK:   llvm.call @tai_rt_device_launch
//   CHECK-NOT: {{ (arith|scf|cf|vector|math|tai|func)[.]}}
// EMULATED-NOT: nvvm
//     EMULATED: llvm.call @tai_dev_thread_id
//     EMULATED: llvm.intr.exp
//  Indices known to be in range are not checked, but data-dependent ones are.
//  DEBUG-LABEL: llvm.func @norms_0(
//    DEBUG-NOT: tai_rt_fail
//  DEBUG-LABEL: llvm.func @pick_0(
//        DEBUG: llvm.call @tai_rt_fail(%{{.+}}
//        DEBUG: llvm.call @tai_rt_device_state
tai.kernel @norms(%scale: f32) {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : vector<2xf32>
    %1 = tai.norm %0 : vector<2xf32>
    %2 = math.exp %1 : f32
    %3 = arith.mulf %2, %scale : f32
    tai.store %3, @y[%i, %j] : f32
    %4 = tai.atomic add %3, @loss[] : f32
  }
  tai.return
}

tai.tree @ints : !tai.root<dense<[i: 128], {k: i32}>>
tai.field @k = @ints["k"] : i32, rank 1
tai.kernel @pick() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @k {
    %0 = tai.load @k[%i] : i32
    %at = arith.index_cast %0 : i32 to index
    %1 = tai.load @y[%at, %c0] : f32
    tai.store %1, @y[%i, %c0] : f32
  }
  tai.return
}

func.func @main() {
  %0 = arith.constant 2.0 : f32
  tai.launch @norms(%0) : (f32) -> ()
  return
}
