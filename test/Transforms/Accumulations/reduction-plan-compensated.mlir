// RUN: tai-opt %s --tai-relax-atomics | FileCheck %s
// RUN: tai-opt %s --tai-relax-atomics=on-device=true | FileCheck %s --check-prefix=GPU

!t = !tai.root<dense<[i: 100000], {x: f32, d: f64}>, dense<[k: 100], {wide: f64}>, {loss: f32, total: f64}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @wide = @t["wide"] : f64, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.field @total = @t["total"] : f64, rank 0

// Compensated: f32 goes to f64, f64 to pairs, whose terms are stored where each
// iteration makes them once.
// CHECK-LABEL: tai.kernel @compensated
//       CHECK:   @loss[] reduction <register wide any> : f32
//       CHECK:   @total[] reduction <register pair any block 1024> : f64
//       CHECK:   @total[] reduction <register pair any> : f64
//       CHECK:   @wide[{{.+}}] reduction <buffer pair any buffer 0> : f64
//   GPU-LABEL: tai.kernel @compensated
//         GPU:   @loss[] reduction <register wide any> : f32
//         GPU:   @total[] reduction <buffer pair any buffer 0> : f64
tai.kernel @compensated() attributes {modes = {sums = "compensated"}} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c100 = arith.constant 100 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @d[%i] : f64
    %2 = tai.atomic add %0, @loss[] : f32
    %3 = tai.atomic add %1, @total[] : f64
  }
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @d[%i] : f64
    scf.for %j = %c0 to %c4 step %c1 {
      %2 = tai.atomic add %0, @total[] : f64
    }
  }
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @d[%i] : f64
    %b = arith.remui %i, %c100 : index
    %2 = tai.atomic add %0, @wide[%b] : f64
  }
  tai.return
}
