// RUN: tai-opt %s | tai-opt | FileCheck %s
// RUN: tai-opt %s --emit-bytecode | tai-opt | FileCheck %s

// CHECK: tai.tree @t : !tai.root<!tai_mesh.shard<[j: 4], dense<[i: 10, j: 16], {x: f32}>, dense<[j: 8], {y: vector<2xf64>}>>, {loss: f32}>
tai.tree @t : !tai.root<!tai_mesh.shard<[j: 4], dense<[i: 10, j: 16], {x: f32}>, dense<[j: 8], {y: vector<2xf64>}>>, {loss: f32}>
// A level above that divides another axis.
// CHECK: tai.tree @s : !tai.root<dense<[i: 3], !tai_mesh.shard<[j: 2], dense<[j: 4], {z: i32}>>>>
tai.tree @s : !tai.root<dense<[i: 3], !tai_mesh.shard<[j: 2], dense<[j: 4], {z: i32}>>>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : vector<2xf64>, rank 1
tai.field @z = @s["z"] : i32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0

// CHECK-LABEL: tai.kernel @exchanges(
tai.kernel @exchanges(%t: index) {
  // CHECK: tai_mesh.rank of 4
  %rank = tai_mesh.rank of 4
  // CHECK: tai_mesh.exchange fetch @x before 1 after 4 at[%{{.*}}] dims [0]
  tai_mesh.exchange fetch @x before 1 after 4 at[%t] dims [0]
  // CHECK: tai_mesh.exchange clear @y after 2
  tai_mesh.exchange clear @y after 2
  // CHECK: tai_mesh.exchange collect @y before 2 {digest = 7 : i64}
  tai_mesh.exchange collect @y before 2 {digest = 7 : i64}
  // CHECK: tai_mesh.exchange open @loss
  tai_mesh.exchange open @loss
  // CHECK: tai_mesh.exchange sum @loss
  tai_mesh.exchange sum @loss
  // CHECK: tai_mesh.exchange min @loss
  tai_mesh.exchange min @loss
  // CHECK: tai_mesh.exchange max @loss
  tai_mesh.exchange max @loss
  tai.return
}
