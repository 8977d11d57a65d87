// RUN: tai-opt %s --split-input-file --tai-shard | FileCheck %s

!t = !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32}>>, {loss: f32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0

// The owner of the stored row runs an iteration, and fetches the rows that it
// reads.
// CHECK-LABEL: tai.kernel @stencil(
//       CHECK:   tai_mesh.exchange fetch @x before 1 after 2 {digest = {{.*}} : i64}
//       CHECK:   %[[RANK:.*]] = tai_mesh.rank of 4
//   CHECK-DAG:   %[[BLOCK:.*]] = arith.constant 16 : index
//       CHECK:   %[[ROW:.*]] = arith.muli %[[RANK]], %[[BLOCK]]
//       CHECK:   %[[FIRST:.*]] = arith.subi %[[ROW]], %{{.*}}
//       CHECK:   %[[END:.*]] = arith.addi %[[FIRST]], %[[BLOCK]]
//       CHECK:   %[[LOW:.*]] = arith.maxsi %[[LOWER:.*]], %[[FIRST]]
//       CHECK:   %[[A:.*]] = arith.select %{{.*}}, %[[LOWER]], %[[LOW]]
//       CHECK:   %[[HIGH:.*]] = arith.minsi %[[UPPER:.*]], %[[END]]
//       CHECK:   %[[B:.*]] = arith.select %{{.*}}, %[[UPPER]], %[[HIGH]]
//       CHECK:   tai.parallel_for (%{{.*}}) = (%[[A]]) to (%[[B]])
//       CHECK:   }
//  CHECK-NEXT:   tai_mesh.exchange stale @y
//   CHECK-NOT:   tai_mesh.exchange
tai.kernel @stencil() {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c1) to (%c62) {
    %h = arith.subi %i, %c1 : index
    %k = arith.addi %i, %c2 : index
    %0 = tai.load @x[%h] : f32
    %1 = tai.load @x[%k] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @y[%i] : f32
  }
  tai.return
}

// A loop over the field becomes a loop over its box; no row travels.
// CHECK-LABEL: tai.kernel @own(
//   CHECK-NOT:   tai_mesh.exchange
//       CHECK:   tai_mesh.rank of 4
//       CHECK:   tai.parallel_for (%{{.*}}) = (%{{.*}}) to (%{{.*}}) {
//       CHECK:   tai_mesh.exchange stale @y
tai.kernel @own() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// Additions to rows of other ranks are collected in cleared halos.
// CHECK-LABEL: tai.kernel @scatter(
//       CHECK:   tai_mesh.exchange clear @y before 1 after 1
//       CHECK:   tai.parallel_for
//       CHECK:   }
//  CHECK-NEXT:   tai_mesh.exchange collect @y before 1 after 1
//  CHECK-NEXT:   tai_mesh.exchange stale @y
tai.kernel @scatter() {
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c1) to (%c63) {
    %0 = tai.load @x[%i] : f32
    %h = arith.subi %i, %c1 : index
    %k = arith.addi %i, %c1 : index
    %1 = tai.atomic add %0, @y[%i] : f32
    %2 = tai.atomic add %0, @y[%h] : f32
    %3 = tai.atomic sub %0, @y[%k] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @reduce(
//       CHECK:   tai_mesh.exchange open @loss
//       CHECK:   tai.parallel_for
//       CHECK:   tai_mesh.exchange sum @loss
tai.kernel @reduce() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.atomic add %0, @loss[] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @most(
//   CHECK-NOT:   tai_mesh.exchange open
//       CHECK:   tai_mesh.exchange max @loss
tai.kernel @most() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.atomic max %0, @loss[] : f32
  }
  tai.return
}

// Every rank adds up all terms, in the order of one process.
// CHECK-LABEL: tai.kernel @fixed(
//       CHECK:   tai_mesh.exchange gather @x
//   CHECK-NOT:   tai_mesh.rank
//   CHECK-NOT:   tai_mesh.exchange
//       CHECK:   tai.parallel_for (%{{.*}}) in @x
//   CHECK-NOT:   tai_mesh.exchange
tai.kernel @fixed() attributes {modes = {sums = "deterministic"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.atomic add %0, @loss[] : f32
  }
  tai.return
}

// Later loops read memory of the kernel that all iterations fill.
// CHECK-LABEL: tai.kernel @buffer(
//       CHECK:   tai_mesh.exchange gather @x
//   CHECK-NOT:   tai_mesh.rank
//       CHECK:   tai.parallel_for (%{{.*}}) in @x
//       CHECK:   tai_mesh.rank of 4
//       CHECK:   tai.parallel_for (%{{.*}}) = (%{{.*}}) to (%{{.*}}) {
tai.kernel @buffer() {
  %c63 = arith.constant 63 : index
  %m = memref.alloc() : memref<64xf32>
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    memref.store %0, %m[%i] : memref<64xf32>
  }
  tai.parallel_for (%i) in @y {
    %k = arith.subi %c63, %i : index
    %0 = memref.load %m[%k] : memref<64xf32>
    tai.store %0, @y[%i] : f32
  }
  memref.dealloc %m : memref<64xf32>
  tai.return
}

// The loop is the same for all ranks.
// CHECK-LABEL: tai.kernel @copies(
//   CHECK-NOT:   tai_mesh.rank
//   CHECK-NOT:   tai_mesh.exchange
tai.kernel @copies() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c1) {
    tai.store %zero, @loss[] : f32
  }
  tai.return
}

// The indices of a 32-bit program; a reach that a loop in the iteration bounds;
// an index that stops at the border.
// CHECK-LABEL: tai.kernel @bounded(
//       CHECK:   tai_mesh.exchange fetch @x before 3 after 2
tai.kernel @bounded() {
  %c1 = arith.constant 1 : i32
  %zero = arith.constant 0 : i32
  %a = arith.constant -2 : index
  %b = arith.constant 3 : index
  %one = arith.constant 1 : index
  %none = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @y {
    %n = arith.index_cast %i : index to i32
    %m = arith.subi %n, %c1 : i32
    %p = arith.maxsi %m, %zero : i32
    %q = arith.index_cast %p : i32 to index
    %0 = tai.load @x[%q] : f32
    %s = scf.for %k = %a to %b step %one iter_args(%t = %none) -> (f32) {
      %j = arith.addi %i, %k : index
      %l = arith.subi %j, %one : index
      %u = tai.load @x[%j] : f32
      %v = tai.load @x[%l] : f32
      %w = arith.addf %u, %v : f32
      %x = arith.addf %t, %w : f32
      scf.yield %x : f32
    }
    %1 = arith.addf %0, %s : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// -----

// A field over time: an exchange is about the step that the loop reads.
!t = !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 10, j: 32, k: 8], {u: f32, g: f32}>>>
tai.tree @t : !t
tai.field @u = @t["u"] : f32, rank 3
tai.field @g = @t["g"] : f32, rank 3, offset [0, 4, 0]

// CHECK-LABEL: tai.kernel @step(
//  CHECK-SAME:   %[[T:.*]]: index
//       CHECK:   %[[P:.*]] = arith.subi %[[T]], %{{.*}} : index
//       CHECK:   tai_mesh.exchange fetch @u before 1 after 1 at[%[[P]]] dims [0]
//       CHECK:   tai.parallel_for (%{{.*}}, %{{.*}}) = (%[[A:.*]], %{{.*}}) to (%[[B:.*]], %{{.*}})
tai.kernel @step(%t: index) {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  %c31 = arith.constant 31 : index
  tai.parallel_for (%j, %k) = (%c1, %c1) to (%c31, %c7) {
    %p = arith.subi %t, %c1 : index
    %a = arith.subi %j, %c1 : index
    %b = arith.addi %j, %c1 : index
    %0 = tai.load @u[%p, %a, %k] : f32
    %1 = tai.load @u[%p, %b, %k] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @u[%t, %j, %k] : f32
  }
  tai.return
}

// Reads and additions of different steps do not disturb each other.
// CHECK-LABEL: tai.kernel @back(
//       CHECK:   tai_mesh.exchange fetch @u after 1 at[%{{.*}}] dims [0]
//       CHECK:   tai_mesh.exchange clear @u after 1 at[%{{.*}}] dims [0]
//       CHECK:   tai_mesh.exchange collect @u after 1 at[%{{.*}}] dims [0]
tai.kernel @back(%t: index) {
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c0 = arith.constant 0 : index
  %c31 = arith.constant 31 : index
  tai.parallel_for (%j, %k) = (%c0, %c0) to (%c31, %c8) {
    %p = arith.subi %t, %c1 : index
    %b = arith.addi %j, %c1 : index
    %0 = tai.load @u[%t, %b, %k] : f32
    %1 = tai.load @u[%t, %j, %k] : f32
    %2 = arith.addf %0, %1 : f32
    %3 = tai.atomic add %2, @u[%p, %j, %k] : f32
    %4 = tai.atomic add %2, @u[%p, %b, %k] : f32
  }
  tai.return
}

// Indices that begin at 4: row 0 is index 4.
// CHECK-LABEL: tai.kernel @offset(
//       CHECK:   %[[O:.*]] = arith.constant -4 : index
//       CHECK:   arith.subi %{{.*}}, %[[O]]
tai.kernel @offset() {
  tai.parallel_for (%t, %j, %k) in @g {
    %0 = tai.load @g[%t, %j, %k] : f32
    tai.store %0, @g[%t, %j, %k] : f32
  }
  tai.return
}

// -----

// A program without shards is left alone.
tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
// CHECK-LABEL: tai.kernel @whole(
//  CHECK-NEXT:   tai.parallel_for (%{{.*}}) in @x
tai.kernel @whole() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}

// -----

// The process is known: bounds of loops are constants. The op stays, and checks
// the number of ranks.
module attributes {tai_mesh.rank_of_process = 3 : i64} {
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1

// CHECK-NOT: rank_of_process
// CHECK-LABEL: tai.kernel @last(
//   CHECK-DAG:   %[[LOW:.*]] = arith.constant 48 : index
//   CHECK-DAG:   %[[HIGH:.*]] = arith.constant 62 : index
//   CHECK-DAG:   tai_mesh.rank of 4
//       CHECK:   tai.parallel_for (%{{.*}}) = (%[[LOW]]) to (%[[HIGH]])
//   CHECK-NOT:   arith.maxsi
tai.kernel @last() {
  %c1 = arith.constant 1 : index
  %c62 = arith.constant 62 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) = (%c1) to (%c62) {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}
}
