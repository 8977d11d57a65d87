// RUN: tai-opt %s --tai-autodiff --remark-format=emitRemark --remarks-filter=tai-.* -o /dev/null 2>&1 | FileCheck %s
// RUN: tai-opt %s --tai-autodiff=history-bytes=100 --remark-format=emitRemark --remarks-filter=tai-loops -o /dev/null 2>&1 | FileCheck %s --check-prefix=TIGHT
// RUN: tai-opt %s --tai-autodiff --remark-format=emitRemark --remarks-filter-missed=tai-loops -o /dev/null 2>&1 | FileCheck %s --check-prefix=MISSED
// RUN: tai-opt %s --tai-autodiff -o /dev/null 2>&1 | FileCheck %s --check-prefix=SILENT --allow-empty

// Without the flags nothing is said.
// SILENT-NOT: remark

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad

// The start of a chunk counts, too: %seed decides the next %v.
// CHECK:      loop-remarks.mlir:[[# @LINE + 27]]:{{.*}}[Passed] flattened | Category:tai-branches | Function=each
// CHECK:      loop-remarks.mlir:[[# @LINE + 24]]:{{.*}}[Analysis] reversed | Category:tai-loops | Function=each | History="4 bytes for each iteration", Iterations=100, Remark="the for loop runs backwards"
// CHECK:      [Missed] carried | Category:tai-loops | Function=each | BytesPerChunk=0, BytesPerIteration=4, Class=trajectory, Type=f32, Value=#0
// CHECK:      [Passed] carried {{.*}} BytesPerIteration=0, Class=linear, Type=f32, Value=#1
// CHECK:      [Passed] carried {{.*}} BytesPerIteration=0, Class="closed form", Type=i32, Value=#2
// CHECK:      [Passed] carried {{.*}} BytesPerIteration=0, Class=invertible, Type=i32, Value=#3

// TIGHT:      History="4 bytes for each iteration; chunks of about sqrt(n) iterations, each run once more, where all take more than 100 bytes", Iterations=100
// TIGHT:      BytesPerChunk=4, BytesPerIteration=4, Class=trajectory, Type=f32, Value=#0
// TIGHT:      BytesPerChunk=0, BytesPerIteration=0, Class=linear, Type=f32, Value=#1
// TIGHT:      BytesPerChunk=4, {{.*}} Class="closed form"
// TIGHT:      BytesPerChunk=4, {{.*}} Class=invertible

// MISSED-NOT: Passed
// MISSED:     [Missed] carried {{.*}} Class=trajectory
// MISSED-NOT: Passed
tai.kernel @each(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %c3 = arith.constant 3 : i32
  %one = arith.constant 1.0 : f32
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:4 = scf.for %j = %c0 to %c100 step %c1 iter_args(%v = %x, %sum = %zero, %at = %c3, %seed = %c3) -> (f32, f32, i32, i32) {
      %big = arith.cmpf ogt, %x, %one : f32
      %w = scf.if %big -> (f32) {
        %m = arith.mulf %x, %v : f32
        scf.yield %m : f32
      } else {
        scf.yield %v : f32
      }
      %fat = arith.sitofp %at : i32 to f32
      %fseed = arith.sitofp %seed : i32 to f32
      %p = arith.mulf %w, %fat : f32
      %s = math.sin %p : f32
      %q = arith.mulf %s, %fseed : f32
      %t = arith.addf %sum, %q : f32
      %at1 = arith.addi %at, %c3 : i32
      %k = arith.muli %seed, %c3 : i32
      %jj = arith.index_cast %j : index to i32
      %seed1 = arith.addi %k, %jj : i32
      scf.yield %q, %t, %at1, %seed1 : f32, f32, i32, i32
    }
    tai.store %r#1, @y[%i] : f32
  }
  tai.return
}

// CHECK: [Analysis] reversed {{.*}} Function=counted | History="4 bytes for each iteration; chunks {{.*}} Iterations="counted by a run of the loop", Remark="the while loop runs backwards"
// CHECK: [Missed] carried {{.*}} Function=counted {{.*}} Class=trajectory
tai.kernel @counted() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r = scf.while (%v = %x) : (f32) -> f32 {
      %more = arith.cmpf ogt, %v, %one : f32
      scf.condition(%more) %v : f32
    } do {
    ^bb0(%v: f32):
      %s = math.sin %v : f32
      scf.yield %s : f32
    }
    tai.store %r, @y[%i] : f32
  }
  tai.return
}
