// A loop that says how many threads its blocks have on a GPU keeps saying so,
// whatever becomes of it, and its function tells the runtime and the driver.
//
// RUN: tai-opt %s --tai-to-nvvm | FileCheck %s --check-prefix=NVVM
// RUN: tai-opt %s --tai-to-nvvm=emulated=true | FileCheck %s --check-prefix=EMULATED
// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-ptx | FileCheck %s --check-prefix=PTX
// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-device-llvmir | FileCheck %s --check-prefix=LLVM
// RUN: tai-opt %s --tai-make-adjoint --tai-version-interior | FileCheck %s --check-prefix=ADJOINT
// RUN: tai-opt %s --tai-make-adjoint --tai-version-interior --tai-mark-exclusive --tai-scatter-to-gather | FileCheck %s --check-prefix=ADJOINT
// RUN: tai-opt %s --tai-forward-diff | FileCheck %s --check-prefix=TANGENT
// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device --tai-lower-layout --convert-tai-to-gpu | FileCheck %s --check-prefix=LAUNCH

!t = !tai.root<dense<[i: 100], {x: f32, x_grad: f32, x_dual: f32, y: f32, y_grad: f32, y_dual: f32}>, pointer<[i: 64], {z: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x_dual = @t["x_dual"] : f32, rank 1
tai.field @y_dual = @t["y_dual"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad, dual @x_dual
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad, dual @y_dual
tai.field @z = @t["z"] : f32, rank 1

// Each loop of a kernel has its own.
//     NVVM-LABEL: llvm.func @two_0(
//      NVVM-SAME:   nvvm.kernel, nvvm.maxntid = array<i32: 64>
//      NVVM-SAME:   passthrough = {{\[\["tai.block_size", "64"\]\]}}
//     NVVM-LABEL: llvm.func @two_1(
//      NVVM-SAME:   nvvm.kernel, tai.accesses
//       NVVM-NOT:   maxntid
//     NVVM-LABEL: llvm.func @two_2(
//      NVVM-SAME:   nvvm.maxntid = array<i32: 1024>
//      NVVM-SAME:   passthrough = {{\["tai.few_iterations", \["tai.block_size", "1024"\]\]}}
//   EMULATED-NOT: maxntid
// EMULATED-LABEL: llvm.func @two_0(
//  EMULATED-SAME:   passthrough = {{\[\["tai.block_size", "64"\]\]}}
//   EMULATED-NOT: maxntid

// The assembler is told; passes are not, since the code runs in programs with
// blocks of other sizes, too.
//      PTX-LABEL: .entry two_0(
//            PTX: .maxntid 64
//      PTX-LABEL: .entry two_1(
//        PTX-NOT: .maxntid
//      PTX-LABEL: .entry two_2(
//            PTX: .maxntid 1024
//     LLVM-LABEL: define {{.*}}@two_0(
//       LLVM-NOT: call range(i32 {{[01]}}, 6{{[45]}})
//       LLVM-NOT: nvvm.maxntid

// The number of iterations, rounded up to blocks.
//   LAUNCH-LABEL: llvm.func @two(
//         LAUNCH:   gpu.launch_func @kernels::@two_0 blocks in (%c2{{[^ ]*}}, %{{.+}}) threads in (%c64
//         LAUNCH:   gpu.launch_func @kernels::@two_1 blocks in (%c1{{[^ ]*}}, %{{.+}}) threads in (%c256
//         LAUNCH:   gpu.launch_func @kernels::@two_2 blocks in (%c1{{[^ ]*}}, %{{.+}}) threads in (%c1024
tai.kernel @two() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x block_dim 64 {
    tai.store %one, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    tai.store %one, @y[%i] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c1) block_dim 1024 {
    tai.store %one, @y[%i] : f32
  }
  tai.return
}

// The active cells of a sparse field.
//     NVVM-LABEL: llvm.func @cells_0(
//      NVVM-SAME:   passthrough = {{\[\["tai.block_size", "96"\]\]}}
//      PTX-LABEL: .entry cells_0(
//            PTX: .maxntid 96
tai.kernel @cells() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @z block_dim 96 {
    tai.store %one, @z[%i] : f32
  }
  tai.return
}

// A stencil, its two adjoint loops, and its tangent.
//  ADJOINT-LABEL: tai.kernel @stencil_grad(
//        ADJOINT:   tai.parallel_for {{.*}} block_dim 128 {
//        ADJOINT:     tai.atomic add %{{.+}}, @x_grad
//    ADJOINT-NOT:   tai.parallel_for {{.*}}) {
//  TANGENT-LABEL: tai.kernel @stencil_fwd(
//        TANGENT:   tai.parallel_for {{.*}} block_dim 128 {
//        TANGENT:     tai.store %{{.+}}, @y_dual
tai.kernel @stencil() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c99 = arith.constant 99 : index
  tai.parallel_for (%i) in @x block_dim 128 {
    %next = arith.addi %i, %c1 : index
    %last = arith.cmpi eq, %i, %c99 : index
    %wrapped = arith.select %last, %c0, %next : index
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @x[%wrapped] : f32
    %2 = arith.mulf %0, %1 : f32
    tai.store %2, @y[%i] : f32
  }
  tai.return
}

// Sizes that no GPU has are no matter where a loop runs on one thread.
//     NVVM-LABEL: llvm.func @serial(
tai.kernel @serial() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x serialize block_dim 7 {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}
