// RUN: tai-opt %s --tai-recognize-reductions=checks --canonicalize | FileCheck %s

// What data decide is checked when the kernel runs, if the kernel asks for it:
// the iterations leave their numbers, and the second one sees the first.

tai.tree @t : !tai.root<dense<[i: 64], {x: f32, b: i32}>, dense<[i: 8], {h: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @h = @t["h"] : f32, rank 1

// CHECK-LABEL: tai.kernel @asked
// CHECK: %[[SEEN:.*]] = memref.alloc() : memref<8xf64>
// CHECK: tai.parallel_for
// CHECK: memref.store %{{.*}}, %[[SEEN]]
// CHECK: tai.parallel_for
// CHECK: %[[BEFORE:.*]] = memref.atomic_rmw maximumf %[[OWN:.*]], %[[SEEN]]
// CHECK: arith.cmpf oeq, %[[BEFORE]], %[[OWN]]
// CHECK: tai.assert %{{.*}}, "an element of field '@h', at [{}], is read and written by two iterations
// CHECK-NEXT: tai.store %{{.*}}, @h
// CHECK: memref.dealloc %[[SEEN]]
tai.kernel @asked() attributes {tai.check_updates} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    %3 = tai.load @h[%1] : f32
    %4 = arith.subf %2, %3 : f32
    tai.store %4, @h[%1] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @not_asked
// CHECK-NOT: tai.assert
tai.kernel @not_asked() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    %3 = tai.load @h[%1] : f32
    %4 = arith.subf %2, %3 : f32
    tai.store %4, @h[%1] : f32
  }
  tai.return
}
