// RUN: tai-opt %s --tai-fuse-launches --canonicalize --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-fix-sum-order --tai-fuse-launches --canonicalize --split-input-file | FileCheck %s --check-prefix=DET
// RUN: tai-opt %s --tai-fuse-launches=max-accesses=3 --canonicalize --split-input-file | FileCheck %s --check-prefix=SMALL
// RUN: tai-opt %s --tai-to-llvm --split-input-file | FileCheck %s --check-prefix=PIPELINE
// RUN: tai-opt %s --tai-to-llvm=fuse-launches=false --split-input-file | FileCheck %s --check-prefix=OFF

// The second kernel reads stores of the same iteration of the first one, one
// row further on; the third one goes on with that. Stored values stay stored.

tai.tree @tree : !tai.root<dense<[i: 8, j: 16], {x: f32}>, dense<[i: 8, j: 16], {y: f32}>, dense<[i: 16], {z: f32}>>
tai.field @x = @tree["x"] : f32, rank 2
tai.field @y = @tree["y"] : f32, rank 2
tai.field @z = @tree["z"] : f32, rank 1

tai.kernel @f(%t: i32) {
  %c0 = arith.constant 0 : index
  %c16 = arith.constant 16 : index
  %c1 = arith.constant 1 : i32
  %next = arith.addi %t, %c1 : i32
  %from = arith.index_cast %t : i32 to index
  %to = arith.index_cast %next : i32 to index
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %0 = tai.load @x[%from, %i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @y[%to, %i] : f32
  }
  tai.return
}
tai.kernel @g(%t: i32, %a: f32) {
  %at = arith.index_cast %t : i32 to index
  tai.parallel_for (%i) in @z {
    %0 = tai.load @y[%at, %i] : f32
    %1 = arith.mulf %0, %a : f32
    tai.store %1, @z[%i] : f32
  }
  tai.return
}

//      CHECK-LABEL: tai.kernel @f_g_g(
//       CHECK-SAME: %[[T:[a-z0-9]+]]: i32, %[[A:[a-z0-9]+]]: f32, %[[B:[a-z0-9]+]]: f32)
//            CHECK:   tai.parallel_for
//            CHECK:     tai.load @x
//            CHECK:     %[[E:.+]] = math.exp
//            CHECK:     tai.store %[[E]], @y
//        CHECK-NOT:     tai.load
//            CHECK:     arith.mulf %[[E]], %[[A]]
//            CHECK:     tai.store %{{.+}}, @z
//            CHECK:     arith.mulf %[[E]], %[[B]]
//            CHECK:     tai.store %{{.+}}, @z
//        CHECK-NOT:   tai.parallel_for
//            CHECK:   tai.return
//        CHECK-NOT: @f_g(
//      CHECK-LABEL: func.func @main
//            CHECK:   tai.launch @f_g_g(%{{.+}}, %{{.+}}, %{{.+}})
//        CHECK-NOT:   tai.launch
//            CHECK:   return
//      SMALL-LABEL: func.func @main
//            SMALL:   tai.launch @f(
//            SMALL:   tai.launch @g(
//         PIPELINE: llvm.func @f_g_g(
//   PIPELINE-LABEL: llvm.func @main
// PIPELINE-COUNT-1:   llvm.call @tai_rt_host_launch
//     PIPELINE-NOT:   llvm.call @tai_rt_host_launch
//         PIPELINE:   llvm.return
//          OFF-NOT: @f_g
//        OFF-LABEL: llvm.func @main
//      OFF-COUNT-3:   llvm.call @tai_rt_host_launch
func.func @main(%t: i32) {
  %a = arith.constant 2.0 : f32
  %b = arith.constant 3.0 : f32
  tai.launch @f(%t) : (i32) -> ()
  %c1 = arith.constant 1 : i32
  %next = arith.addi %t, %c1 : i32
  tai.launch @g(%next, %a) : (i32, f32) -> ()
  tai.launch @g(%next, %b) : (i32, f32) -> ()
  return
}

// -----

// Sums into one element may be mixed where bits do not count. Rows by constants
// are apart, and a loop of the host has its launches fused inside.

tai.tree @tree : !tai.root<dense<[i: 8, j: 16], {x: f32}>, {loss: f32, loss_grad: f32, count: i32}>
tai.field @x = @tree["x"] : f32, rank 2
tai.field @loss_grad = @tree["loss_grad"] : f32, rank 0
tai.field @loss = @tree["loss"] : f32, rank 0, adjoint @loss_grad
tai.field @count = @tree["count"] : i32, rank 0

tai.kernel @add(%t: i32) {
  %at = arith.index_cast %t : i32 to index
  %c0 = arith.constant 0 : index
  %c15 = arith.constant 15 : index
  %c16 = arith.constant 16 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %mirrored = arith.subi %c15, %i : index
    %0 = tai.load @x[%at, %i] : f32
    %1 = tai.atomic add %0, @loss[] : f32
    %2 = tai.atomic add %one, @count[] : i32
  }
  tai.return
}
tai.kernel @write(%t: i32) {
  %at = arith.index_cast %t : i32 to index
  %c0 = arith.constant 0 : index
  %c15 = arith.constant 15 : index
  %c16 = arith.constant 16 : index
  %v = arith.constant 1.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %mirrored = arith.subi %c15, %i : index
    tai.store %v, @x[%at, %mirrored] : f32
  }
  tai.return
}

// CHECK-LABEL: func.func @sums
//       CHECK:   scf.for
//       CHECK:     tai.launch @add_add(
//   CHECK-NOT:     tai.launch
//       CHECK:   }
//   DET-LABEL: func.func @sums
//         DET:     tai.launch @add(
//         DET:     tai.launch @add(
func.func @sums(%n: index, %t: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %k = %c0 to %n step %c1 {
    tai.launch @add(%t) : (i32) -> ()
    tai.launch @add(%t) : (i32) -> ()
  }
  return
}

// CHECK-LABEL: func.func @rows
//       CHECK:   tai.launch @add_write(
//   CHECK-NOT:   tai.launch
//       CHECK:   return
func.func @rows() {
  %t = arith.constant 3 : i32
  %u = arith.constant 4 : i32
  tai.launch @add(%t) : (i32) -> ()
  tai.launch @write(%u) : (i32) -> ()
  return
}

// An iteration would overwrite what another one still reads.
// CHECK-LABEL: func.func @same_row
//       CHECK:   tai.launch @add(
//       CHECK:   tai.launch @write(
func.func @same_row(%t: i32) {
  tai.launch @add(%t) : (i32) -> ()
  tai.launch @write(%t) : (i32) -> ()
  return
}

// Nothing is known of two arguments.
// CHECK-LABEL: func.func @unknown_rows
//       CHECK:   tai.launch @add(
//       CHECK:   tai.launch @write(
func.func @unknown_rows(%t: i32, %u: i32) {
  tai.launch @add(%t) : (i32) -> ()
  tai.launch @write(%u) : (i32) -> ()
  return
}

// Launches under a tape stay, and an op between launches is a barrier.
// CHECK-LABEL: func.func @between
//       CHECK:   tai.launch @add(
//       CHECK:   tai.store
//       CHECK:   tai.launch @add(
//       CHECK:   tai.tape
//       CHECK:     tai.launch @add(
//       CHECK:     tai.launch @add(
func.func @between(%t: i32) {
  %v = arith.constant 1.0 : f32
  tai.launch @add(%t) : (i32) -> ()
  tai.store %v, @loss[] : f32
  tai.launch @add(%t) : (i32) -> ()
  tai.tape loss(@loss) {
    tai.launch @add(%t) : (i32) -> ()
    tai.launch @add(%t) : (i32) -> ()
  }
  return
}

// -----

// Neighbours, other boxes, transposed elements, serial code, sparse fields and
// effects that are no accesses.

tai.tree @tree : !tai.root<dense<[i: 16, j: 16], {x: f32, y: f32}>, bitmasked<[i: 16], {s: f32}>>
tai.field @x = @tree["x"] : f32, rank 2
tai.field @y = @tree["y"] : f32, rank 2
tai.field @s = @tree["s"] : f32, rank 1

tai.kernel @map() {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}
tai.kernel @shift() {
  %c1 = arith.constant 1 : index
  %c15 = arith.constant 15 : index
  tai.parallel_for (%i, %j) in @x {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.minsi %0, %c15 : index
    %2 = tai.load @y[%1, %j] : f32
    tai.store %2, @x[%i, %j] : f32
  }
  tai.return
}
tai.kernel @transpose() {
  tai.parallel_for (%i, %j) in @x {
    %2 = tai.load @y[%j, %i] : f32
    %3 = arith.addf %2, %2 : f32
    tai.store %3, @x[%i, %j] : f32
  }
  tai.return
}
tai.kernel @smaller() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c8) {
    %0 = tai.load @y[%i, %j] : f32
    tai.store %0, @x[%i, %j] : f32
  }
  tai.return
}
tai.kernel @serial() {
  %c0 = arith.constant 0 : index
  %0 = tai.load @y[%c0, %c0] : f32
  tai.parallel_for (%i, %j) in @x {
    tai.store %0, @x[%i, %j] : f32
  }
  tai.return
}
tai.kernel @active() {
  tai.parallel_for (%i) in @s {
    %0 = tai.load @s[%i] : f32
    tai.store %0, @s[%i] : f32
  }
  tai.return
}
tai.kernel @says() {
  tai.parallel_for (%i, %j) in @x {
    tai.print "{}"(%i) : index
  }
  tai.return
}

// CHECK-LABEL: func.func @main
//       CHECK:   tai.launch @map()
//  CHECK-NEXT:   tai.launch @shift()
//  CHECK-NEXT:   tai.launch @map()
//  CHECK-NEXT:   tai.launch @transpose()
//  CHECK-NEXT:   tai.launch @map()
//  CHECK-NEXT:   tai.launch @smaller()
//  CHECK-NEXT:   tai.launch @map()
//  CHECK-NEXT:   tai.launch @serial()
//  CHECK-NEXT:   tai.launch @active()
//  CHECK-NEXT:   tai.launch @active()
//  CHECK-NEXT:   tai.launch @map()
//  CHECK-NEXT:   tai.launch @says()
func.func @main() {
  tai.launch @map() : () -> ()
  tai.launch @shift() : () -> ()
  tai.launch @map() : () -> ()
  tai.launch @transpose() : () -> ()
  tai.launch @map() : () -> ()
  tai.launch @smaller() : () -> ()
  tai.launch @map() : () -> ()
  tai.launch @serial() : () -> ()
  tai.launch @active() : () -> ()
  tai.launch @active() : () -> ()
  tai.launch @map() : () -> ()
  tai.launch @says() : () -> ()
  return
}

// -----

// Loops whose blocks differ in size, or of which one alone says its size, stay
// apart; of the same size they become one loop of that size.

tai.tree @tree : !tai.root<dense<[i: 16], {x: f32, y: f32, z: f32}>>
tai.field @x = @tree["x"] : f32, rank 1
tai.field @y = @tree["y"] : f32, rank 1
tai.field @z = @tree["z"] : f32, rank 1

tai.kernel @narrow(%a: f32) {
  tai.parallel_for (%i) in @x block_dim 64 {
    tai.store %a, @x[%i] : f32
  }
  tai.return
}
tai.kernel @narrow2(%a: f32) {
  tai.parallel_for (%i) in @x block_dim 64 {
    tai.store %a, @y[%i] : f32
  }
  tai.return
}
tai.kernel @wide(%a: f32) {
  tai.parallel_for (%i) in @x block_dim 128 {
    tai.store %a, @z[%i] : f32
  }
  tai.return
}
tai.kernel @any(%a: f32) {
  tai.parallel_for (%i) in @x {
    tai.store %a, @x[%i] : f32
  }
  tai.return
}
// CHECK-LABEL: tai.kernel @narrow_narrow2(
//       CHECK:   tai.parallel_for {{.*}} block_dim 64 {
//       CHECK:     tai.store %{{.+}}, @x
//       CHECK:     tai.store %{{.+}}, @y
// CHECK-LABEL: func.func @main
//       CHECK:   tai.launch @narrow_narrow2(
//       CHECK:   tai.launch @wide(
//       CHECK:   tai.launch @any(
//   CHECK-NOT:   tai.launch
//   DET-LABEL: func.func @main
//         DET:   tai.launch @narrow_narrow2(
// SMALL-LABEL: func.func @main
// PIPELINE-LABEL: llvm.func @main
// OFF-LABEL: llvm.func @main
func.func @main(%a: f32) {
  tai.launch @narrow(%a) : (f32) -> ()
  tai.launch @narrow2(%a) : (f32) -> ()
  tai.launch @wide(%a) : (f32) -> ()
  tai.launch @any(%a) : (f32) -> ()
  return
}

// -----

// A kernel of other modes is not fused; one of the same modes is fused, and
// keeps them.

tai.tree @tree : !tai.root<dense<[i: 16], {x: f32}>, dense<[i: 16], {y: f32}>, dense<[i: 16], {z: f32}>>
tai.field @x = @tree["x"] : f32, rank 1
tai.field @y = @tree["y"] : f32, rank 1
tai.field @z = @tree["z"] : f32, rank 1

tai.kernel @strict_f() attributes {modes = {math = "strict"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}
tai.kernel @strict_g() attributes {modes = {math = "strict"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @y[%i] : f32
    tai.store %0, @z[%i] : f32
  }
  tai.return
}
tai.kernel @fast_g() attributes {modes = {math = "fast"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @y[%i] : f32
    tai.store %0, @z[%i] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @strict_f_strict_g() attributes {modes = {math = "strict"}}
// CHECK-LABEL: func.func @same
//       CHECK:   tai.launch @strict_f_strict_g()
func.func @same() {
  tai.launch @strict_f() : () -> ()
  tai.launch @strict_g() : () -> ()
  return
}
// CHECK-LABEL: func.func @other
//       CHECK:   tai.launch @strict_f()
//       CHECK:   tai.launch @fast_g()
func.func @other() {
  tai.launch @strict_f() : () -> ()
  tai.launch @fast_g() : () -> ()
  return
}
