// RUN: not tai-opt %s --tai-forward-diff=array-tangents=false 2>&1 | FileCheck %s
// RUN: not tai-opt %s --tai-forward-diff=kernel=nobody 2>&1 | FileCheck %s --check-prefix=NAME
// RUN: tai-opt %s --tai-forward-diff | FileCheck %s --check-prefix=ARRAYS

// Without tangents of arrays, a tangent stored there would be lost in silence.
// CHECK: [[# @LINE + 16]]:5: error: a tangent is lost in an array, which has none
// CHECK: note: store what has a tangent to a field with a dual
// NAME: error: there is no kernel or function '@nobody' to differentiate

// ARRAYS: tai.kernel @k_fwd(%{{.+}}: memref<?xf32>, %[[D:.+]]: memref<?xf32>)
// ARRAYS:   memref.store %{{.+}}, %[[D]]

!t = !tai.root<dense<[i: 4], {x: f32, d: f32}>>
tai.tree @t : !t
tai.field @d = @t["d"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, dual @d
tai.kernel @k(%array: memref<?xf32>) {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %a = memref.load %array[%i] : memref<?xf32>
    %y = arith.mulf %x, %a : f32
    memref.store %y, %array[%i] : memref<?xf32>
  }
  tai.return
}
