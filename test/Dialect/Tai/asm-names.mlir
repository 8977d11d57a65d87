// RUN: tai-opt %s | FileCheck %s

// Values have the names of what they are.
tai.tree @t : !tai.root<dense<[i: 4, j: 4], {x: vector<2x2xf32>, a_very_long_field: f32}>>
tai.field @x = @t["x"] : vector<2x2xf32>, rank 2
tai.field @a_very_long_field = @t["a_very_long_field"] : f32, rank 2
// CHECK-LABEL: tai.kernel @names(
tai.kernel @names() {
  // CHECK: tai.parallel_for (%i, %j) in @x
  tai.parallel_for (%0, %1) in @x {
    // CHECK-NEXT: %x = tai.load @x[%i, %j]
    %2 = tai.load @x[%0, %1] : vector<2x2xf32>
    // CHECK-NEXT: %x_0 = tai.load @x[%j, %i]
    %3 = tai.load @x[%1, %0] : vector<2x2xf32>
    // CHECK-NEXT: %rotation, %stretch = tai.polar %x
    %4, %5 = tai.polar %2 : vector<2x2xf32>
    // CHECK-NEXT: %u, %sigma, %v = tai.svd %x_0
    %6, %7, %8 = tai.svd %3 : vector<2x2xf32>
    // CHECK-NEXT: %values, %vectors = tai.sym_eig %stretch
    %9, %10 = tai.sym_eig %5 : vector<2x2xf32> -> vector<2xf32>
    // CHECK-NEXT: %local = tai.alloca
    %11 = tai.alloca : !tai.local<f32>
    // CHECK-NEXT: %stack = tai.stack_create
    %12 = tai.stack_create : !tai.stack<f32>
    // CHECK-NEXT: %0 = tai.load @a_very_long_field
    %13 = tai.load @a_very_long_field[%0, %1] : f32
    // CHECK-NEXT: %old = tai.atomic add %0
    %14 = tai.atomic add %13, @a_very_long_field[%0, %1] : f32
    // CHECK-NEXT: tai.local_store %old, %local
    tai.local_store %14, %11 : f32
    tai.stack_destroy %12 : !tai.stack<f32>
  }
  tai.return
}
