// The address of a sum in an array of the kernel is that before its loop, whose
// function has its own name for it.
//
// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s
// RUN: tai-opt %s --tai-to-llvm | FileCheck %s --check-prefix=CODE

// CODE-NOT: atomicrmw
//   CHECK-LABEL: llvm.func @sum(
//         CHECK:   %[[ARRAY:.+]] = llvm.alloca %{{.+}} x f32
//         CHECK:   llvm.call @tai_rt_parallel_for
//         CHECK:   %[[OLD:.+]] = llvm.load %[[ARRAY]]
//         CHECK:   %[[NEW:.+]] = {{(arith.addf|llvm.fadd)}} %[[OLD]]
//         CHECK:   llvm.store %[[NEW]], %[[ARRAY]]
tai.tree @t : !tai.root<dense<[i: 100000], {x: f32}>, {y: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 0
tai.kernel @sum() {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f32
  %array = memref.alloca() : memref<1xf32>
  memref.store %zero, %array[%c0] : memref<1xf32>
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f32
    %s = math.sin %v : f32
    %old = memref.atomic_rmw addf %s, %array[%c0] : (f32, memref<1xf32>) -> f32
  }
  %r = memref.load %array[%c0] : memref<1xf32>
  tai.store %r, @y[] : f32
  tai.return
}
