// RUN: tai-opt %s --tai-make-adjoint | FileCheck %s --check-prefixes=CHECK,ALL
// RUN: tai-opt %s --tai-make-adjoint="skip=all,-unneeded-records" | FileCheck %s --check-prefixes=CHECK,RECORDS
// RUN: tai-opt %s --tai-make-adjoint="skip=all,-inactive-values" | FileCheck %s --check-prefixes=CHECK,ADJOINTS
// RUN: tai-opt %s --tai-autodiff="skip=-unneeded-records" | FileCheck %s --check-prefix=PIPELINE
// RUN: not tai-opt %s --tai-make-adjoint="skip=activity" 2>&1 | FileCheck %s --check-prefix=WRONG
// RUN: not tai-opt %s --tai-autodiff="skip=activity" 2>&1 | FileCheck %s --check-prefix=WRONG

// WRONG: there is no skip 'activity'; the skips are all, none, unchanged-lists,

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, c: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @c = @t["c"] : f32, rank 1

// One of three values that the loop carries is recorded: the sum is linear, and
// the count a formula. Without the analysis, all are.
// CHECK-LABEL: tai.kernel @loop_grad()
//     ALL:     memref.alloc(%{{.+}}) : memref<?xf32>
//     ALL-NOT: memref.alloc
//     ALL:     tai.return
// RECORDS-DAG: memref.alloc(%{{.+}}) : memref<?xf32>
// RECORDS-DAG: memref.alloc(%{{.+}}) : memref<?xf32>
// RECORDS-DAG: memref.alloc(%{{.+}}) : memref<?xi32>
//     RECORDS: tai.return
// PIPELINE-LABEL: tai.kernel @loop_grad()
// PIPELINE-DAG: memref.alloc() : memref<100xf32>
// PIPELINE-DAG: memref.alloc() : memref<100xi32>
//     PIPELINE: tai.return
tai.kernel @loop() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %zero = arith.constant 0.0 : f32
  %begin = arith.constant 3 : i32
  %by = arith.constant 2 : i32
  tai.parallel_for (%i) in @x {
    %a = tai.load @x[%i] : f32
    %r:3 = scf.for %j = %c0 to %c100 step %c1
        iter_args(%v = %a, %s = %zero, %k = %begin) -> (f32, f32, i32) {
      %f = arith.sitofp %k : i32 to f32
      %m = arith.mulf %v, %f : f32
      %w = math.sin %m : f32
      %t = arith.addf %s, %w : f32
      %next = arith.addi %k, %by : i32
      scf.yield %w, %t, %next : f32, f32, i32
    }
    tai.store %r#1, @y[%i] : f32
  }
  tai.return
}

// The factor does not depend on @x, so that it gets no adjoint, and @x is not
// read again to compute it.
// CHECK-LABEL: tai.kernel @scaled_grad()
//     ALL-NOT: tai.load @x[
//    ADJOINTS: tai.load @x[
//       CHECK: tai.return
tai.kernel @scaled() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %c = tai.load @c[%i] : f32
    %cc = arith.mulf %c, %c : f32
    %y = arith.mulf %x, %cc : f32
    tai.store %y, @y[%i] : f32
  }
  tai.return
}
