// RUN: tai-opt %s --tai-relax-atomics | FileCheck %s --check-prefixes=CHECK,FREE
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics | FileCheck %s --check-prefixes=CHECK,DET
// RUN: tai-opt %s --tai-relax-atomics=on-device=true | FileCheck %s --check-prefix=GPU
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics=on-device=true | FileCheck %s --check-prefix=GPUDET
// RUN: tai-opt %s --tai-relax-atomics --remark-format=emitRemark --remarks-filter=tai-reductions -o /dev/null 2>&1 | FileCheck %s --check-prefix=REMARK

// The digits, the order and the blocks of sums, by mode and target.
!t = !tai.root<dense<[i: 100000], {x: f32, d: f64, h: f16}>, dense<[k: 100], {bins: f32, halves: f16, wide: f64}>,
               {loss: f32, total: f64, half: f16, count: i32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @h = @t["h"] : f16, rank 1
tai.field @bins = @t["bins"] : f32, rank 1
tai.field @halves = @t["halves"] : f16, rank 1
tai.field @wide = @t["wide"] : f64, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.field @total = @t["total"] : f64, rank 0
tai.field @half = @t["half"] : f16, rank 0
tai.field @count = @t["count"] : i32, rank 0

// f64 is not widened by WidenSums: the blocks of all sums are the short ones.
// REMARK: remark: [Passed] register | {{.*}} Digits=own, Field=loss, Order=any
// REMARK: remark: [Passed] register | {{.*}} Digits=own, Field=total, Order=any
// CHECK-LABEL: tai.kernel @totals
//       CHECK:   @loss[] reduction <register own any block 2048> : f32
//       CHECK:   @total[] reduction <register own any block 2048> : f64
//       CHECK:   @count[] reduction <register own any> : i32
//        FREE:   } {tai.independent}
//         DET:   } {order = #tai.loop_order<fixed>, tai.independent}
//   GPU-LABEL: tai.kernel @totals
//         GPU:   @loss[] reduction <register wide any> : f32
//         GPU:   @total[] reduction <register own any> : f64
// GPUDET-LABEL: tai.kernel @totals
//      GPUDET:   @loss[] reduction <register own lanes> : f32
//      GPUDET:   @total[] reduction <register own lanes> : f64
//      GPUDET:   @count[] reduction <register own any> : i32
tai.kernel @totals() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1 : i32
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @d[%i] : f64
    %2 = tai.atomic add %0, @loss[] : f32
    %3 = tai.atomic sub %1, @total[] : f64
    %4 = tai.atomic add %one, @count[] : i32
  }
  tai.return
}

// f32 and 16 bits have the long blocks if all updates are in the loop itself;
// a loop that is shorter than a block has none.
// CHECK-LABEL: tai.kernel @blocks
//       CHECK:   @loss[] reduction <register own any block 8192> : f32
//       CHECK:   @half[] reduction <register own any block 8192> : f16
//       CHECK:   @loss[] reduction <register own any block 2048> : f32
//       CHECK:   @loss[] reduction <register own any> : f32
tai.kernel @blocks() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %short = arith.constant 2048 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @h[%i] : f16
    %2 = tai.atomic add %0, @loss[] : f32
    %3 = tai.atomic add %1, @half[] : f16
  }
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    scf.for %j = %c0 to %c4 step %c1 {
      %2 = tai.atomic add %0, @loss[] : f32
    }
  }
  tai.parallel_for (%i) = (%c0) to (%short) {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    %2 = math.sin %1 : f32
    %3 = math.sin %2 : f32
    %4 = tai.atomic add %3, @loss[] : f32
  }
  tai.return
}

// A loop with a fixed cost whose body has a loop: LLVM would see another loop
// where something has been left out of it.
// CHECK-LABEL: tai.kernel @kept_order
//       CHECK:   @loss[] reduction <register own iterations block 2048> : f32
tai.kernel @kept_order() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    scf.for %j = %c0 to %c4 step %c1 {
      tai.store %0, @x[%i] : f32
    }
    %2 = tai.atomic add %0, @loss[] : f32
  } {fixed_cost = 2.0 : f64}
  tai.return
}

// Buffers: 16 bits and many updates of an element go to f64.
// CHECK-LABEL: tai.kernel @buffers
//       CHECK:   @bins[{{.+}}] reduction <buffer wide any buffer 0> : f32
//       CHECK:   @halves[{{.+}}] reduction <buffer wide any buffer 1> : f16
//       CHECK:   @wide[{{.+}}] reduction <buffer own any buffer 2> : f64
//       CHECK:   @bins[{{.+}}] reduction <buffer own any buffer 0> : f32
// GPUDET-LABEL: tai.kernel @buffers
//      GPUDET:   @bins[{{.+}}] reduction <fixed own any buffer 0> : f32
tai.kernel @buffers() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  %few = arith.constant 20000 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @h[%i] : f16
    %2 = tai.load @d[%i] : f64
    %b = arith.remui %i, %c100 : index
    %3 = tai.atomic add %0, @bins[%b] : f32
    %4 = tai.atomic add %1, @halves[%b] : f16
    %5 = tai.atomic add %2, @wide[%b] : f64
  }
  tai.parallel_for (%i) = (%c0) to (%few) {
    %0 = tai.load @x[%i] : f32
    %b = arith.remui %i, %c100 : index
    %3 = tai.atomic add %0, @bins[%b] : f32
  }
  tai.return
}

// Strict and deterministic: the order of all targets, and of the loop as well.
// DET-LABEL: tai.kernel @strict
//       DET:   @loss[] reduction <register own common> : f32
//       DET:   } {order = #tai.loop_order<common>, tai.independent}
// GPUDET-LABEL: tai.kernel @strict
//      GPUDET:   @loss[] reduction <register own common> : f32
tai.kernel @strict() attributes {modes = {math = "strict"}} {
  %c0 = arith.constant 0 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %2 = tai.atomic add %0, @loss[] : f32
  }
  tai.return
}

// REMARK: remark: [Missed] atomic | {{.*}} Field=count, Reason="the value before an update is used"
// REMARK: remark: [Missed] atomic | {{.*}} Field=x, Reason="the loop has other accesses to the field"
// REMARK: remark: [Missed] atomic | {{.*}} Field=d, Reason="buffers would cost more than the updates"
// REMARK: remark: [Passed] exclusive | {{.*}} Field=h
tai.kernel @reasons() {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : index
  %one = arith.constant 1 : i32
  %n = arith.constant 9000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @h[%i] : f16
    %b = arith.muli %i, %i : index
    %at = arith.remui %b, %c7 : index
    %old = tai.atomic add %one, @count[] : i32
    %f = arith.sitofp %old : i32 to f64
    %2 = tai.atomic add %0, @x[%at] : f32
    %3 = tai.atomic add %f, @d[%at] : f64
    %4 = tai.atomic add %1, @h[%i] : f16
  }
  tai.return
}
