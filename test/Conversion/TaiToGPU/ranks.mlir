// RUN: tai-opt %s --tai-lower-layout --convert-tai-to-gpu | FileCheck %s

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// The host asks for the rank and exchanges rows between launches, by the
// address that the tree has on the device.
// CHECK-LABEL: llvm.func @blur(
//  CHECK-SAME:   %[[FRAME:.*]]: !llvm.ptr
//       CHECK:   llvm.call @tai_rt_exchange(%[[FRAME]], %{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}, %{{.*}})
//       CHECK:   llvm.call @tai_rt_rank(%[[FRAME]],
//       CHECK:   gpu.launch_func
//       CHECK:   llvm.call @tai_rt_exchange(%[[FRAME]],
//       CHECK:   llvm.call @tai_rt_failed(%[[FRAME]])
tai.kernel @blur() {
  %c1 = arith.constant 1 : index
  %c16 = arith.constant 16 : index
  tai_mesh.exchange fetch @x before 1
  %rank = tai_mesh.rank of 4
  %low = arith.muli %rank, %c16 : index
  %high = arith.addi %low, %c16 : index
  tai.parallel_for (%i) = (%low) to (%high) {
    %h = arith.subi %i, %c1 : index
    %0 = tai.load @x[%h] : f32
    tai.store %0, @y[%i] : f32
  }
  tai_mesh.exchange stale @y
  tai.return
}
