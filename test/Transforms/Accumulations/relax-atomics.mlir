// RUN: tai-opt %s --tai-relax-atomics | FileCheck %s --check-prefixes=CHECK,FREE
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics | FileCheck %s --check-prefixes=CHECK,DET

tai.tree @t : !tai.root<dense<[i: 100000], {x: f32}>, dense<[i: 100000], {y: f32}>,
                        dense<[i: 16], dense<[j: 100, k: 100], {grid: f32}>>,
                        dense<[i: 1000000], {huge: f32}>, {loss: f32, count: i32},
                        dense<[i: 100], {bins: i32}>, dense<[i: 100], {narrow: i16}>>
tai.field @bins = @t["bins"] : i32, rank 1
tai.field @narrow = @t["narrow"] : i16, rank 1
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @grid = @t["grid"] : f32, rank 3
tai.field @huge = @t["huge"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.field @count = @t["count"] : i32, rank 0

// Each iteration has an element of its own: a plain update.
// CHECK-LABEL: tai.kernel @own
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic add %{{.+}}, @y[%{{.+}}] exclusive : f32
//       CHECK:   } {{{.*}}tai.independent}
tai.kernel @own() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 99999 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = tai.atomic add %0, @y[%1] : f32
  }
  tai.return
}

// Two different elements: the neighbour's iteration updates this one too.
// CHECK-LABEL: tai.kernel @neighbours
//       CHECK:     tai.atomic add %{{.+}}, @y[%{{.+}}] reduction <buffer {{own|wide}} any buffer 0> : f32
//       CHECK:     tai.atomic add %{{.+}}, @y[%{{.+}}] reduction <buffer {{own|wide}} any buffer 0> : f32
//       CHECK:   }
//   CHECK-NOT:   tai.independent
//       CHECK:   tai.return
tai.kernel @neighbours() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 99999 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = tai.atomic add %0, @y[%1] : f32
    %3 = tai.atomic add %0, @y[%i] : f32
  }
  tai.return
}

// All iterations share one element: sums in registers.
// CHECK-LABEL: tai.kernel @reduction
//       CHECK:     tai.atomic add %{{.+}}, @loss[] reduction <register own any block 8192> : f32
//       CHECK:     tai.atomic add %{{.+}}, @count[] reduction <register own any> : i32
//       CHECK:   } {{{.*}}tai.independent}
tai.kernel @reduction() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.atomic add %0, @loss[] : f32
    %2 = tai.atomic add %one, @count[] : i32
  }
  tai.return
}

// The time slot is the same for all iterations, computed before the loop, and
// the read slot is another one: the slice that is updated gets buffers.
// CHECK-LABEL: tai.kernel @slice(
//  CHECK-SAME:     %[[T:.+]]: index
//       CHECK:   %[[NEXT:.+]] = arith.addi %[[T]], %{{.+}} : index
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic add %{{.+}}, @grid[%[[NEXT]], {{.+}}] reduction <buffer {{own|wide}} any buffer 0> : f32
tai.kernel @slice(%t: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : i32
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %next = arith.addi %t, %c1 : index
    %0 = tai.load @grid[%t, %c0, %c0] : f32
    %1 = arith.index_cast %i : index to i32
    %2 = arith.remui %1, %c100 : i32
    %j = arith.index_cast %2 : i32 to index
    %3 = tai.atomic add %0, @grid[%next, %j, %j] : f32
  }
  tai.return
}

// The updated field is read as well: the updates stay in memory. Deterministic
// mode runs such a loop on one thread.
// CHECK-LABEL: tai.kernel @reads
//        FREE:     tai.atomic add %{{.+}}, @y[%{{[^]]+}}] : f32
//         DET:   tai.parallel_for {{.+}} serialize
//         DET:     tai.atomic add %{{.+}}, @y[%{{[^]]+}}] exclusive : f32
tai.kernel @reads() {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @y[%i] : f32
    %1 = arith.remui %i, %c7 : index
    %2 = tai.atomic add %0, @y[%1] : f32
  }
  tai.return
}

// Somebody looks at the old value.
// CHECK-LABEL: tai.kernel @old
//        FREE:     %[[OLD:.+]] = tai.atomic add %{{.+}}, @count[] : i32
//         DET:   tai.parallel_for {{.+}} serialize
tai.kernel @old() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.atomic add %one, @count[] : i32
    %1 = arith.sitofp %0 : i32 to f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// A million elements for some thousand updates: buffers would cost more.
// CHECK-LABEL: tai.kernel @sparse_updates
//        FREE:   tai.parallel_for
//    FREE-NOT:   serialize
//        FREE:     tai.atomic add %{{.+}}, @huge[%{{[^]]+}}] : f32
//         DET:   tai.parallel_for {{.+}} serialize
tai.kernel @sparse_updates() {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : index
  %n = arith.constant 10000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.muli %i, %i : index
    %2 = arith.remui %1, %c7 : index
    %3 = tai.atomic add %0, @huge[%2] : f32
  }
  tai.return
}

// Integer sums do not depend on the order.
// CHECK-LABEL: tai.kernel @histogram(
//   CHECK-NOT:   serialize
//       CHECK:   tai.atomic min %{{.+}}, @y[%{{[^]]+}}] : f32
tai.kernel @histogram() {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.remui %i, %c7 : index
    %2 = tai.atomic min %0, @y[%1] : f32
  }
  tai.return
}

// Too small to pay for a fork: in place, where all updates are plain. They may
// still meet: the iterations are not independent.
// CHECK-LABEL: tai.kernel @small
//       CHECK:   tai.parallel_for {{.+}} serialize
//       CHECK:     tai.atomic add %{{.+}}, @loss[] exclusive : f32
//       CHECK:   }
//   CHECK-NOT:   tai.independent
//       CHECK:   tai.return
tai.kernel @small() {
  %c0 = arith.constant 0 : index
  %n = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.atomic add %0, @loss[] : f32
  }
  tai.return
}

// Serial code of a kernel has no rivals.
// CHECK-LABEL: tai.kernel @serial
//       CHECK:   tai.atomic add %{{.+}}, @loss[] exclusive : f32
tai.kernel @serial(%x: f32) {
  %0 = tai.atomic add %x, @loss[] : f32
  tai.return
}

// Sums into an array of the caller stay atomic.
// CHECK-LABEL: tai.kernel @array(
//        FREE:   tai.parallel_for
//    FREE-NOT:   serialize
//         DET:   tai.parallel_for {{.+}} serialize
//       CHECK:     memref.atomic_rmw addf
//       CHECK:   }
//   CHECK-NOT:   tai.independent
//       CHECK:   tai.return
tai.kernel @array(%m: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.remui %i, %c7 : index
    %2 = memref.atomic_rmw addf %0, %m[%1] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// Many sums of one field are neighbours: they share a buffer.
// CHECK-LABEL: tai.kernel @row
//  CHECK-SAME:     %[[T:.+]]: index
// CHECK-COUNT-9:   tai.atomic add %{{.+}}, @grid[%[[T]], {{.+}}] reduction <buffer {{own|wide}} any buffer 0> : f32
tai.kernel @row(%t: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %x = tai.load @x[%i] : f32
    %a = tai.atomic add %x, @grid[%t, %c0, %c0] : f32
    %b = tai.atomic add %x, @grid[%t, %c0, %c1] : f32
    %c = tai.atomic add %x, @grid[%t, %c0, %c2] : f32
    %d = tai.atomic add %x, @grid[%t, %c0, %c3] : f32
    %e = tai.atomic add %x, @grid[%t, %c0, %c4] : f32
    %f = tai.atomic add %x, @grid[%t, %c0, %c5] : f32
    %g = tai.atomic add %x, @grid[%t, %c0, %c6] : f32
    %h = tai.atomic add %x, @grid[%t, %c0, %c7] : f32
    %j = tai.atomic add %x, @grid[%t, %c0, %c8] : f32
  }
  tai.return
}

// A product of 32 bits may wrap: two iterations may meet.
// CHECK-LABEL: tai.kernel @wraps
//   CHECK-NOT:   exclusive
//       CHECK:   tai.return
tai.kernel @wraps(%n: index) {
  %c0 = arith.constant 0 : index
  %f = arith.constant 65536 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.index_cast %i : index to i32
    %2 = arith.muli %1, %f : i32
    %3 = arith.index_cast %2 : i32 to index
    %4 = tai.atomic add %0, @huge[%3] : f32
  }
  tai.return
}

// A small array of the kernel that iterations only add to: sums in registers,
// whatever the mode.
// CHECK-LABEL: tai.kernel @local_sums
//       CHECK:   tai.parallel_for
//       CHECK:     memref.atomic_rmw addf {{.+}} {tai.accumulate = #tai.reduction<register own any block 8192>}
//       CHECK:     memref.atomic_rmw addf {{.+}} {tai.accumulate = #tai.reduction<register own any block 8192>}
//       CHECK:   } {{{.*}}tai.independent}
tai.kernel @local_sums() -> f32 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 99999 : index
  %zero = arith.constant 0.0 : f32
  %sums = memref.alloca() : memref<2xf32>
  memref.store %zero, %sums[%c0] : memref<2xf32>
  memref.store %zero, %sums[%c1] : memref<2xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = memref.atomic_rmw addf %0, %sums[%c0] : (f32, memref<2xf32>) -> f32
    %2 = tai.load @y[%i] : f32
    %3 = memref.atomic_rmw addf %2, %sums[%c1] : (f32, memref<2xf32>) -> f32
  }
  %4 = memref.load %sums[%c1] : memref<2xf32>
  tai.return %4 : f32
}

// One that is read in the loop, or indexed by it, is added to in memory.
// CHECK-LABEL: tai.kernel @local_array
//  FREE:   tai.parallel_for
//   CHECK-NOT: {{reduction|tai.accumulate}}
//  DET:    serialize
tai.kernel @local_array() -> f32 {
  %c0 = arith.constant 0 : index
  %n = arith.constant 99999 : index
  %zero = arith.constant 0.0 : f32
  %sum = memref.alloca() : memref<1xf32>
  memref.store %zero, %sum[%c0] : memref<1xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %sum[%c0] : memref<1xf32>
    %1 = memref.atomic_rmw addf %0, %sum[%c0] : (f32, memref<1xf32>) -> f32
  }
  %4 = memref.load %sum[%c0] : memref<1xf32>
  tai.return %4 : f32
}

// Counts of few bins have buffers of their own, too, in any mode: the order of
// whole numbers does not matter. Not so maxima, and numbers of 16 bits.
// CHECK-LABEL: tai.kernel @counts
//       CHECK:     tai.atomic add %{{.+}}, @bins[%{{.+}}] reduction <buffer own any buffer 0> : i32
//       CHECK:     tai.atomic add %{{.+}}, @narrow[%{{.+}}] : i16
//       CHECK:   tai.return
tai.kernel @counts() {
  %c0 = arith.constant 0 : index
  %n = arith.constant 100000 : index
  %bins = arith.constant 100 : index
  %one = arith.constant 1 : i32
  %half = arith.constant 1 : i16
  tai.parallel_for (%i) = (%c0) to (%n) {
    %at = arith.remui %i, %bins : index
    %0 = tai.atomic add %one, @bins[%at] : i32
    %1 = tai.atomic add %half, @narrow[%at] : i16
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @largest
//       CHECK:     tai.atomic max %{{.+}}, @bins[%{{.+}}] : i32
//       CHECK:   tai.return
tai.kernel @largest() {
  %c0 = arith.constant 0 : index
  %n = arith.constant 100000 : index
  %bins = arith.constant 100 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %at = arith.remui %i, %bins : index
    %0 = tai.atomic max %one, @bins[%at] : i32
  }
  tai.return
}
