// RUN: tai-opt %s --tai-choose-writers | FileCheck %s
// RUN: tai-opt %s --tai-choose-writers --tai-make-adjoint=kernel=scatter | \
// RUN:   FileCheck %s --check-prefix=ADJOINT
// RUN: tai-opt %s --tai-choose-writers --tai-make-adjoint=kernel=steps | \
// RUN:   FileCheck %s --check-prefix=STEPS
// RUN: tai-opt %s --tai-choose-writers --tai-choose-writers | FileCheck %s

!t = !tai.root<dense<[i: 64], {x: f32, x_grad: f32, x_dual: f32, z: f32}>,
               dense<[i: 16], {y: f32, y_grad: f32}>,
               dense<[i: 64], {p: i32}>,
               dense<[i: 2, j: 8, k: 4], {cube: f32, cube_grad: f32}>,
               dense<[i: 8, j: 8], {square: f32, square_grad: f32}>,
               dense<[i: 16], {v: vector<2xf32>, v_grad: vector<2xf32>}>,
               dense<[i: 32768, j: 16384], {huge: f32, huge_grad: f32}>,
               {one: f32, one_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @z = @t["z"] : f32, rank 1
tai.field @cube_grad = @t["cube_grad"] : f32, rank 3
tai.field @cube = @t["cube"] : f32, rank 3, adjoint @cube_grad
tai.field @square_grad = @t["square_grad"] : f32, rank 2
tai.field @square = @t["square"] : f32, rank 2, adjoint @square_grad
tai.field @p = @t["p"] : i32, rank 1
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @huge_grad = @t["huge_grad"] : f32, rank 2
tai.field @huge = @t["huge"] : f32, rank 2, adjoint @huge_grad
tai.field @one_grad = @t["one_grad"] : f32, rank 0
tai.field @one = @t["one"] : f32, rank 0, adjoint @one_grad

// The kernel stays, and its form for tapes has owners.
// CHECK-LABEL: tai.kernel @scatter() {
//   CHECK-NOT:   memref.alloc
// CHECK-LABEL: tai.kernel @scatter.0()
//  CHECK-SAME:   part_of = @scatter
//       CHECK:   %[[OWNERS:.+]] = memref.alloc() : memref<16xi32>
//       CHECK:   memref.store %c-1_i32, %[[OWNERS]]
//       CHECK:   tai.parallel_for (%{{.+}}) in @x
//   CHECK-NOT:     tai.load @x
//       CHECK:     tai.load @p
//       CHECK:     memref.atomic_rmw maxs %{{.+}}, %[[OWNERS]]
//   CHECK-NOT:     tai.store
//       CHECK:   tai.parallel_for (%{{.+}}) in @x
//       CHECK:     %[[OWNER:.+]] = memref.load %[[OWNERS]]
//       CHECK:     %[[MINE:.+]] = arith.cmpi eq, %[[OWNER]]
//       CHECK:     scf.if
//  CHECK-NEXT:       tai.store
//       CHECK:   memref.dealloc %[[OWNERS]]
//
// ADJOINT-LABEL: tai.kernel @scatter.0_grad(
//       ADJOINT:   %[[OWNERS:.+]] = memref.alloc
//       ADJOINT:   memref.atomic_rmw maxs %{{.+}}, %[[OWNERS]]
//       ADJOINT:   tai.parallel_for
//       ADJOINT:     memref.load %[[OWNERS]]
//       ADJOINT:     scf.if
//       ADJOINT:       tai.load @y_grad
//       ADJOINT:   memref.dealloc %[[OWNERS]]
tai.kernel @scatter() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// Each iteration has its own element; nobody asks for the derivative.
// CHECK-NOT: tai.kernel @own.0
// CHECK-NOT: tai.kernel @constant.0
tai.kernel @own() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
tai.kernel @constant() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @z[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// One iteration has no other to meet.
// CHECK-NOT: tai.kernel @once.0
tai.kernel @once() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%c1) {
    %0 = tai.load @x[%c1] : f32
    tai.store %0, @y[%c1] : f32
  }
  tai.return
}

// The element of the border has no other iteration.
// CHECK-NOT: tai.kernel @border.0
tai.kernel @border(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %two = arith.constant 2.0 : f32
  %last = arith.subi %n, %c1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %first = arith.cmpi eq, %i, %c0 : index
    scf.if %first {
      tai.store %0, @y[%c0] : f32
    } else {
      %isLast = arith.cmpi ne, %i, %last : index
      %1 = arith.mulf %0, %two : f32
      scf.if %isLast {
        tai.store %1, @y[%i] : f32
      } else {
        tai.store %0, @y[%last] : f32
      }
    }
  }
  tai.return
}

// Digits of a number determine it. These are those of Python, rounded down.
// CHECK-NOT: tai.kernel @digits.0
// CHECK-NOT: tai.kernel @quotient_and_rest.0
// CHECK-NOT: tai.kernel @two_numbers.0
tai.kernel @digits() {
  %c4 = arith.constant 4 : index
  %c8 = arith.constant 8 : index
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %q = arith.floordivsi %i, %c8 : index
    %q4 = arith.floordivsi %i, %c4 : index
    %c2 = arith.constant 2 : index
    %r0 = arith.remsi %q4, %c2 : index
    %neg0 = arith.cmpi slt, %r0, %c0 : index
    %up0 = arith.addi %r0, %c2 : index
    %middle = arith.select %neg0, %up0, %r0 : index
    %r1 = arith.remsi %i, %c4 : index
    %neg1 = arith.cmpi slt, %r1, %c0 : index
    %up1 = arith.addi %r1, %c4 : index
    %low = arith.select %neg1, %up1, %r1 : index
    tai.store %0, @cube[%middle, %q, %low] : f32
  }
  tai.return
}
tai.kernel @quotient_and_rest(%m: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %q = arith.divsi %i, %m : index
    %r = arith.remsi %i, %m : index
    tai.store %0, @square[%q, %r] : f32
  }
  tai.return
}
tai.kernel @two_numbers() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %0 = tai.load @x[%i] : f32
    %q = arith.floordivsi %i, %c8 : index
    %r = arith.remsi %i, %c8 : index
    tai.store %0, @square[%q, %r] : f32
    %other = arith.addi %i, %c32 : index
    %oq = arith.floordivsi %other, %c8 : index
    %or = arith.remsi %other, %c8 : index
    tai.store %0, @square[%oq, %or] : f32
  }
  tai.return
}

// Some digits do not, nor a quotient and a remainder of different divisions; and
// the numbers of two stores must not meet.
// CHECK-LABEL: tai.kernel @gap.0(
// CHECK-LABEL: tai.kernel @mixed.0(
// CHECK-LABEL: tai.kernel @near_numbers.0(
tai.kernel @gap() {
  %c4 = arith.constant 4 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %q = arith.floordivsi %i, %c8 : index
    %r = arith.remsi %i, %c4 : index
    tai.store %0, @square[%q, %r] : f32
  }
  tai.return
}
tai.kernel @mixed(%m: index, %n: index) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %q = arith.divsi %i, %m : index
    %r = arith.remsi %i, %n : index
    tai.store %0, @square[%q, %r] : f32
  }
  tai.return
}
tai.kernel @near_numbers() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c20 = arith.constant 20 : index
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %0 = tai.load @x[%i] : f32
    %q = arith.floordivsi %i, %c8 : index
    %r = arith.remsi %i, %c8 : index
    tai.store %0, @square[%q, %r] : f32
    %other = arith.addi %i, %c20 : index
    %oq = arith.floordivsi %other, %c8 : index
    %or = arith.remsi %other, %c8 : index
    tai.store %0, @square[%oq, %or] : f32
  }
  tai.return
}

// Whether the slots are one is known when it runs: nothing is looked for.
// CHECK-NOT: tai.kernel @slots.0
tai.kernel @slots(%s: index, %d: index) {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %j = arith.addi %i, %c1 : index
    %0 = tai.load @square[%s, %j] : f32
    tai.store %0, @square[%d, %i] : f32
  }
  tai.return
}

// A read must not find what another iteration writes.
// CHECK-LABEL: tai.kernel @recurrence.0(
//       CHECK:   memref.atomic_rmw maxs
//       CHECK:   tai.parallel_for
//       CHECK:     tai.assert %{{.+}}, "an iteration of a parallel loop uses an element of field 'x' here that another iteration writes
//       CHECK:     tai.load @x
//   CHECK-NOT:     scf.if
//       CHECK:     tai.store %{{.+}}, @x
tai.kernel @recurrence(%n: index) {
  %c1 = arith.constant 1 : index
  %half = arith.constant 0.5 : f32
  tai.parallel_for (%i) = (%c1) to (%n) {
    %j = arith.subi %i, %c1 : index
    %0 = tai.load @x[%j] : f32
    %1 = arith.mulf %0, %half : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// What decides is changed by the loop: in order on one thread.
// CHECK-LABEL: tai.kernel @changes.0(
//       CHECK:   tai.parallel_for {{.*}} serialize
tai.kernel @changes() {
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @x {
    %half = arith.divsi %i, %c2 : index
    %n = arith.index_cast %i : index to i32
    tai.store %n, @p[%half] : i32
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// A function is changed itself: its gradient is not asked for by a tape.
// CHECK-LABEL: func.func @function(
//       CHECK:   memref.atomic_rmw maxs
//       CHECK:   scf.if
//  CHECK-NEXT:     memref.store
func.func @function(%from: memref<64xf32>, %at: memref<64xi32>,
                    %to: memref<16xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %k = memref.load %at[%i] : memref<64xi32>
    %j = arith.index_cast %k : i32 to index
    %0 = memref.load %from[%i] : memref<64xf32>
    memref.store %0, %to[%j] : memref<16xf32>
  }
  return
}

// Each time step decides for itself, in the adjoint too.
// CHECK-LABEL: tai.kernel @steps.0(
//       CHECK:   scf.for
//       CHECK:     memref.alloc
//       CHECK:     memref.dealloc
//
// STEPS-LABEL: tai.kernel @steps.0_grad(
//       STEPS:   scf.for
//       STEPS:     memref.alloc
//       STEPS:     memref.atomic_rmw maxs
//       STEPS:     memref.dealloc
tai.kernel @steps(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %t = %c0 to %n step %c1 {
    tai.parallel_for (%i) in @x {
      %k = tai.load @p[%i] : i32
      %j = arith.index_cast %k : i32 to index
      %0 = tai.load @x[%i] : f32
      tai.store %0, @square[%t, %j] : f32
    }
  }
  tai.return
}

// Memory of the iteration itself is no effect: the copy keeps it and gives it
// back.
// CHECK-LABEL: tai.kernel @scatter_of_list.0()
//       CHECK:   %[[OWNERS:.+]] = memref.alloc() : memref<16xi32>
//       CHECK:   tai.parallel_for (%{{.+}}) in @x
//       CHECK:     %[[M:.+]] = memref.alloc() : memref<2xi32>
//       CHECK:     memref.store %{{.+}}, %[[M]]
//       CHECK:     memref.dealloc %[[M]]
//   CHECK-NOT:     tai.load @x
//       CHECK:     memref.atomic_rmw maxs %{{.+}}, %[[OWNERS]]
//       CHECK:   tai.parallel_for (%{{.+}}) in @x
//       CHECK:     memref.dealloc
//       CHECK:     tai.store
tai.kernel @scatter_of_list() {
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %m = memref.alloc() : memref<2xi32>
    %k = tai.load @p[%i] : i32
    memref.store %k, %m[%c1] : memref<2xi32>
    %h = memref.load %m[%c1] : memref<2xi32>
    memref.dealloc %m : memref<2xi32>
    %j = arith.index_cast %h : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// So are variables and stacks. A function of several blocks is left alone.
// CHECK-LABEL: func.func @variables(
//       CHECK:   memref.alloc
//       CHECK:   tai.parallel_for
//       CHECK:     tai.stack_destroy
//       CHECK:     tai.local_load
//       CHECK:     memref.atomic_rmw maxs
//       CHECK:   tai.parallel_for
//       CHECK:     scf.if
// CHECK-LABEL: func.func @blocks(
//   CHECK-NOT:   memref.alloc
//       CHECK:   return
func.func @variables(%from: memref<64xf32>, %at: memref<64xi32>, %to: memref<16xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %k = memref.load %at[%i] : memref<64xi32>
    %s = tai.stack_create : !tai.stack<i32>
    tai.stack_push %k, %s : i32
    %l = tai.stack_pop %s : i32
    tai.stack_destroy %s : !tai.stack<i32>
    %a = tai.alloca : !tai.local<i32>
    tai.local_store %l, %a : i32
    %n = tai.local_load %a : i32
    %j = arith.index_cast %n : i32 to index
    %0 = memref.load %from[%i] : memref<64xf32>
    memref.store %0, %to[%j] : memref<16xf32>
  }
  return
}
func.func @blocks(%from: memref<64xf32>, %at: memref<64xi32>, %to: memref<16xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  cf.br ^next
^next:
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %k = memref.load %at[%i] : memref<64xi32>
    %j = arith.index_cast %k : i32 to index
    %0 = memref.load %from[%i] : memref<64xf32>
    memref.store %0, %to[%j] : memref<16xf32>
  }
  return
}

// A condition on two indices of the loop lets either stand for the other; it
// leaves one iteration for each element. So does a loop of one iteration.
// CHECK-NOT: tai.kernel @diagonal.0
// CHECK-NOT: tai.kernel @of_one.0
tai.kernel @diagonal() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8, %c8) {
    %0 = tai.load @x[%i] : f32
    %same = arith.cmpi eq, %i, %j : index
    scf.if %same {
      tai.store %0, @y[%j] : f32
    }
  }
  tai.return
}
tai.kernel @of_one() {
  tai.parallel_for () in @one {
    %c0 = arith.constant 0 : index
    %0 = tai.load @one[] : f32
    tai.store %0, @y[%c0] : f32
  }
  tai.return
}

// Draws are drawn by both loops, those that decide nothing too: the next one
// follows them.
// CHECK-LABEL: tai.kernel @draws.0(
// CHECK-COUNT-2: tai.random
//       CHECK:   memref.atomic_rmw maxs
// CHECK-COUNT-2: tai.random
//       CHECK:   tai.store
tai.kernel @draws() {
  %c16 = arith.constant 16.0 : f32
  tai.parallel_for (%i) in @x {
    %u = tai.random stream 0 : f32
    %w = tai.random stream 0 : f32
    %f = arith.mulf %w, %c16 : f32
    %k = arith.fptosi %f : f32 to i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %u : f32
    tai.store %1, @y[%j] : f32
  }
  tai.return
}

// Two time slots may be one: all slots have owners. The numbers of very many
// iterations are wide, and so are those whose count is beyond all numbers.
// CHECK-LABEL: tai.kernel @two_slots.0(
//       CHECK:   memref.alloc() : memref<8x8xi32>
// CHECK-LABEL: tai.kernel @many_iterations.0(
//       CHECK:   memref.alloc() : memref<16xi64>
// CHECK-LABEL: tai.kernel @endless_iterations.0(
//       CHECK:   memref.alloc() : memref<16xi64>
tai.kernel @two_slots(%s: index, %u: index) {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @square[%s, %j] : f32
    tai.store %0, @square[%u, %j] : f32
  }
  tai.return
}
tai.kernel @many_iterations() {
  %c0 = arith.constant 0 : index
  %c65536 = arith.constant 65536 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i, %h, %g) = (%c0, %c0, %c0) to (%c65536, %c65536, %c64) {
    %k = tai.load @p[%g] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%g] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}
tai.kernel @endless_iterations() {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %most = arith.constant 0x7fffffffffffffff : index
  tai.parallel_for (%g, %h) = (%c0, %c0) to (%c2, %most) {
    %k = tai.load @p[%g] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%g] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// One owner cannot stand for an element and for its components, nor for a store
// and for sums; and there is no room for the owners of very many elements. These
// loops run on one thread, and so does one whose condition is what an update
// finds.
// CHECK-LABEL: tai.kernel @whole_and_part.0(
//       CHECK:   tai.parallel_for {{.*}} serialize
// CHECK-LABEL: tai.kernel @stores_and_sums.0(
//       CHECK:   tai.parallel_for {{.*}} serialize
// CHECK-LABEL: tai.kernel @too_many.0(
//       CHECK:   tai.parallel_for {{.*}} serialize
// CHECK-LABEL: tai.kernel @by_update.0(
//       CHECK:   tai.parallel_for {{.*}} serialize
tai.kernel @whole_and_part() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    %w = vector.broadcast %0 : f32 to vector<2xf32>
    tai.store %w, @v[%j] : vector<2xf32>
    tai.store %0, @v[%j] component [%c0] : f32
  }
  tai.return
}
tai.kernel @stores_and_sums() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @square[%j, %j] : f32
    tai.atomic add %0, @square[%i, %c0] : f32
  }
  tai.return
}
tai.kernel @too_many() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @huge[%j, %j] : f32
  }
  tai.return
}
tai.kernel @by_update() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    %k = tai.atomic add %c1, @p[%c0] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}
