// RUN: tai-opt %s --tai-lower-layout --convert-tai-to-scf | FileCheck %s

tai.tree @a : !tai.root<{loss: f32}>
tai.tree @t : !tai.root<dense<[i: 2], {z: i64}>, !tai_mesh.shard<[j: 4], dense<[i: 10, j: 64], {x: vector<2xf32>}>>>
tai.field @loss = @a["loss"] : f32, rank 0
tai.field @x = @t["x"] : vector<2xf32>, rank 2, offset [3, 0]

// The plan: kind, element, digest, block, before, after, offset, digits; of
// each digit its role, divisor, extent and stride. The launch may fail.
// CHECK-LABEL: llvm.func @exchanges(
//  CHECK-SAME:   %[[FRAME:.*]]: !llvm.ptr
//       CHECK:   %[[RANK:.*]] = llvm.call @tai_rt_rank(%[[FRAME]], %{{.*}}, %{{.*}}) : (!llvm.ptr, i64, !llvm.ptr) -> i64
//   CHECK-DAG:   arith.constant 16 : i64
//   CHECK-DAG:   arith.constant 64 : i64
//   CHECK-DAG:   arith.constant -32 : i64
//   CHECK-DAG:   arith.constant 99 : i64
//       CHECK:   arith.subi %{{.*}} : i64
//       CHECK:   llvm.call @tai_rt_exchange(%[[FRAME]], %{{.*}}, %{{.*}}, %{{.*}}, %{{.*}}, %{{.*}})
//       CHECK:   llvm.call @tai_rt_exchange(%[[FRAME]],
//       CHECK:   llvm.call @tai_rt_failed(%[[FRAME]])
tai.kernel @exchanges(%t: index) {
  %rank = tai_mesh.rank of 4
  tai_mesh.exchange fetch @x before 1 after 2 at[%t] dims [0] {digest = 99 : i64}
  tai_mesh.exchange sum @loss
  tai.return
}
