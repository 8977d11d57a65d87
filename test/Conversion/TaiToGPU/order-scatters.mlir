// RUN: tai-opt %s --tai-fix-sum-order --tai-scalarize --tai-lower-struct-for --tai-relax-atomics=on-device=true -o %t.relaxed.mlir
// RUN: FileCheck %s --check-prefix=RELAX < %t.relaxed.mlir
// RUN: tai-opt %t.relaxed.mlir --tai-lower-layout=on-device=true --convert-tai-to-gpu | FileCheck %s --check-prefix=GPU
// RUN: tai-opt %t.relaxed.mlir --tai-lower-layout="on-device=true bounds-check=true" --convert-tai-to-gpu | FileCheck %s --check-prefix=CHECKED
// RUN: tai-opt %s --tai-fix-sum-order --tai-scalarize --tai-lower-struct-for --tai-relax-atomics | FileCheck %s --check-prefix=CPU

// Loops whose additions meet in memory, in deterministic mode on a GPU. One
// warp runs those whose threads can come to the additions together, and one
// thread the rest.

// CPU-NOT: in_warp

tai.tree @t : !tai.root<dense<[i: 100], {at: i32, v: f32}>, dense<[i: 8, j: 8], {m: vector<2xf32>, mass: f32}>, dense<[i: 8], {h: f16, d: f64, seen: i32}>, {total: f32}>
tai.tree @s : !tai.root<pointer<[i: 16], dense<[i: 16], {p: f32}>>>
tai.field @at = @t["at"] : i32, rank 1
tai.field @v = @t["v"] : f32, rank 1
tai.field @m = @t["m"] : vector<2xf32>, rank 2
tai.field @mass = @t["mass"] : f32, rank 2
tai.field @h = @t["h"] : f16, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @seen = @t["seen"] : i32, rank 1
tai.field @total = @t["total"] : f32, rank 0
tai.field @p = @s["p"] : f32, rank 1

// Components and neighbours share a plan; the sum of all iterations stays in
// registers, of which there are 32 and others that hold nothing.
// RELAX-LABEL: tai.kernel @neighbours
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
//   GPU-LABEL: llvm.func @neighbours_0(
//    GPU-SAME: passthrough = {{\["tai.lowered", \["tai.block_size", "32"\], \["tai.modes", "sums=deterministic"\]\]}}
//       GPU:   %[[LANES:.+]] = llvm.call @tai_dev_ordered_lanes() : () -> i32
//       GPU:   scf.if
//       GPU:     llvm.call @tai_dev_ordered_meet()
//       GPU:   scf.for %[[FIRST:.+]] =
//       GPU:     %[[MINE:.+]] = arith.addi %[[FIRST]], %{{.+}}
//       GPU:     %[[ACTIVE:.+]] = arith.cmpi slt, %[[MINE]], %[[N:.+]] : index
//       GPU:     arith.minsi %[[MINE]],
//       GPU:     %[[ALL:.+]]:5 = scf.if %[[ACTIVE]] -> (!llvm.ptr, f32, f32, f32, f32) {
//       GPU:       llvm.store
//       GPU:       scf.yield
//       GPU:     } else {
//       GPU:       %[[NULL:.+]] = llvm.mlir.zero : !llvm.ptr
//       GPU:       scf.yield %[[NULL]],
//       GPU:     %[[PLAN:.+]] = llvm.call @tai_dev_ordered_plan(%[[ALL]]#0)
//       GPU:     llvm.call @tai_dev_ordered_add_f32(%[[PLAN]], %[[ALL]]#0, %[[ALL]]#1)
//       GPU:     llvm.call @tai_dev_ordered_add_f32(%[[PLAN]], %{{.+}}, %[[ALL]]#2)
//       GPU:     llvm.call @tai_dev_ordered_add_f32(%[[PLAN]], %{{.+}}, %[[ALL]]#3)
//       GPU:     llvm.call @tai_dev_ordered_add_f32(%[[PLAN]], %{{.+}}, %[[ALL]]#4)
//   GPU-NOT:     atomicrmw
//       GPU:   scf.if
//       GPU:     llvm.call @tai_dev_ordered_meet()
//       GPU:   scf.for %{{.+}} = %{{.+}} to %c256
//       GPU:     arith.select %{{.+}} : f64
//       GPU:     llvm.store
//       GPU:   llvm.return
tai.kernel @neighbours() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %k = arith.addi %j, %c1 : index
    %v = tai.load @v[%i] : f32
    %vv = vector.broadcast %v : f32 to vector<2xf32>
    tai.atomic add %vv, @m[%j, %j] : vector<2xf32>
    tai.atomic sub %v, @mass[%j, %j] : f32
    tai.atomic add %v, @mass[%k, %j] : f32
    tai.atomic add %v, @total[] : f32
  }
  tai.return
}

// Additions leave the branches in which they stand. All else is done by threads
// that have an iteration.
// RELAX-LABEL: tai.kernel @conditions
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
//   GPU-LABEL: llvm.func @conditions_0(
//       GPU:   scf.for
//       GPU:     %[[ACTIVE:.+]] = arith.cmpi slt
//       GPU:     %[[ALL:.+]]:4 = scf.if %[[ACTIVE]] -> (!llvm.ptr, f64, !llvm.ptr, f32) {
//       GPU:       %[[OUT:.+]]:4 = scf.if %{{.+}} -> (!llvm.ptr, f64, !llvm.ptr, f32) {
//       GPU:         llvm.store
//       GPU:         scf.yield %{{.+}}, %{{.+}}, %[[NULL:.+]], %[[ZERO:.+]] : !llvm.ptr, f64, !llvm.ptr, f32
//       GPU:       } else {
//       GPU:         scf.yield
//       GPU:       scf.yield %[[OUT]]#0, %[[OUT]]#1, %[[OUT]]#2, %[[OUT]]#3
//       GPU:     } else {
//   GPU-NOT:       llvm.load
//       GPU:     llvm.call @tai_dev_ordered_add_f64(%{{.+}}, %[[ALL]]#0, %[[ALL]]#1)
//       GPU:     llvm.call @tai_dev_ordered_add_f32(%{{.+}}, %[[ALL]]#2, %[[ALL]]#3)
// CHECKED-LABEL: llvm.func @conditions_0(
//   CHECKED-NOT:   tai_dev_ordered
//       CHECKED:   llvm.return
tai.kernel @conditions() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %w = arith.extf %v : f32 to f64
    %positive = arith.cmpf ogt, %v, %zero : f32
    scf.if %positive {
      tai.store %zero, @v[%i] : f32
      tai.atomic add %w, @d[%j] : f64
    } else {
      tai.atomic add %v, @mass[%j, %c0] : f32
    }
  }
  tai.return
}

// Loops that all iterations go through alike; integers stay atomic.
// RELAX-LABEL: tai.kernel @loops
//       RELAX: } {in_warp, order = #tai.loop_order<{{fixed|common}}>}
//   GPU-LABEL: llvm.func @loops_0(
//       GPU:   scf.for
//       GPU:     %[[ACTIVE:.+]] = arith.cmpi slt
//       GPU:     scf.if %[[ACTIVE]]
//       GPU:     scf.for
//       GPU:       scf.for
//       GPU:         %[[ONE:.+]]:2 = scf.if %[[ACTIVE]] -> (!llvm.ptr, f32) {
//       GPU:         llvm.call @tai_dev_ordered_add_f32(%{{.+}}, %[[ONE]]#0, %[[ONE]]#1)
//       GPU:       }
//       GPU:       scf.if %[[ACTIVE]] {
//       GPU:         llvm.atomicrmw add
tai.kernel @loops(%steps: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    scf.for %a = %c0 to %steps step %c1 {
      scf.for %b = %c0 to %a step %c1 {
        tai.atomic add %v, @mass[%j, %b] : f32
      }
      tai.atomic add %one, @seen[%j] : i32
    }
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @uneven_trips
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @uneven_trips() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    scf.for %a = %c0 to %j step %c1 {
      tai.atomic add %v, @mass[%j, %a] : f32
    }
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @loop_under_condition
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @loop_under_condition() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c100 = arith.constant 100 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %v = tai.load @v[%i] : f32
    %positive = arith.cmpf ogt, %v, %zero : f32
    scf.if %positive {
      scf.for %a = %c0 to %c3 step %c1 {
        tai.atomic add %v, @mass[%a, %a] : f32
      }
    }
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @reads_what_it_adds_to
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @reads_what_it_adds_to() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @mass[%c0, %j] : f32
    tai.atomic add %v, @mass[%j, %j] : f32
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @uses_what_was_there
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @uses_what_was_there() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %old = tai.atomic add %v, @mass[%j, %j] : f32
    tai.store %old, @v[%i] : f32
  }
  tai.return
}

// A store to what other iterations store to, too: the last one stays.
// RELAX-LABEL: tai.kernel @stores_meet
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @stores_meet() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %w = arith.extf %v : f32 to f64
    tai.store %w, @d[%j] : f64
    tai.atomic add %v, @mass[%j, %j] : f32
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @products
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @products() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    tai.atomic mul %v, @mass[%j, %j] : f32
  }
  tai.return
}

// In fixed point, so that it is rounded once.
// RELAX-LABEL: tai.kernel @half_precision
//   RELAX-NOT: serialize
//       RELAX: tai.atomic add {{.+}}, @h[{{.+}}] reduction <fixed own any buffer 0> : f16
tai.kernel @half_precision() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    %h = arith.truncf %v : f32 to f16
    tai.atomic add %h, @h[%j] : f16
  }
  tai.return
}

// RELAX-LABEL: tai.kernel @makes_cells_active
//       RELAX: tai.parallel_for {{.+}} serialize {
tai.kernel @makes_cells_active() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  tai.parallel_for (%i) = (%c0) to (%c100) {
    %j32 = tai.load @at[%i] : i32
    %j = arith.index_cast %j32 : i32 to index
    %v = tai.load @v[%i] : f32
    tai.atomic add %v, @p[%j] : f32
  }
  tai.return
}
