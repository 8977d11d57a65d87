// The functions that a kernel becomes have its modes, where no pass may drop them.
//
// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s
// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device --tai-lower-layout --convert-tai-to-gpu | FileCheck %s --check-prefix=GPU

tai.tree @s : !tai.root<dense<[i: 4096], {x: f32}>, dense<[i: 1048576], {y: f32}>>
tai.field @x = @s["x"] : f32, rank 1
tai.field @y = @s["y"] : f32, rank 1

// CHECK-LABEL: llvm.func @strict(
//  CHECK-SAME:   passthrough = {{\["tai.lowered", \["tai.modes", "math=strict,ftz=true"\]\]}}
// CHECK-LABEL: llvm.func internal @strict.loop0(
//  CHECK-SAME:   passthrough = {{\["tai.lowered", \["tai.modes", "math=strict,ftz=true"\]\]}}
// CHECK-LABEL: llvm.func @plain(
//   CHECK-NOT:   tai.modes

//   GPU-LABEL: gpu.module @kernels
//         GPU:   llvm.func @strict_0(
//    GPU-SAME:     passthrough = {{\["tai.lowered", \["tai.block_size", "64"\], \["tai.modes", "math=strict,ftz=true"\]\]}}
//         GPU:   llvm.func @plain_0(
//     GPU-NOT:   tai.modes
//         GPU: llvm.func @strict(
//    GPU-SAME:   passthrough = {{\["tai.lowered", \["tai.modes", "math=strict,ftz=true"\]\]}}
//     GPU-NOT: tai.modes
tai.kernel @strict() attributes {modes = {math = "strict", ftz = true}} {
  tai.parallel_for (%i) in @y {
    %0 = tai.load @y[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @y[%i] : f32
  } {block_dim = 64 : i64}
  tai.return
}

tai.kernel @plain() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}
