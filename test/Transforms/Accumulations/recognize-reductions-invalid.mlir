// RUN: tai-opt %s --tai-recognize-reductions --split-input-file --verify-diagnostics
// RUN: tai-opt %s --tai-recognize-reductions=one-thread --split-input-file | FileCheck %s

// An element that all iterations update, by what is no reduction. A program of
// one thread has the iterations in order.

!t = !tai.root<dense<[i: 64], {x: f32, y: f32, n: i32}>, {o: f32, c: i32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1
tai.field @o = @t["o"] : f32, rank 0
tai.field @c = @t["c"] : i32, rank 0

// CHECK-LABEL: tai.kernel @recurrence
// CHECK: tai.parallel_for (%{{.*}}) in @x serialize
tai.kernel @recurrence() {
  %half = arith.constant 0.5 : f32
  // expected-note @+1 {{run this loop on one thread ('serialize')}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @o[] : f32
    %1 = arith.mulf %0, %half : f32
    %2 = tai.load @x[%i] : f32
    %3 = arith.addf %1, %2 : f32
    // expected-error @+2 {{an element of field '@o' is read and written by the iterations of a parallel loop, and the result would depend on which of them comes first}}
    // expected-note @+1 {{or update it by one operation whose order does not matter}}
    tai.store %3, @o[] : f32
  }
  tai.return
}

// x - old changes its sign each time.
// CHECK-LABEL: tai.kernel @reversed
// CHECK: serialize
tai.kernel @reversed() {
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @o[] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.subf %1, %0 : f32
    // expected-error @+2 {{an element of field '@o' is read and written}}
    // expected-note @+1 {{or update it}}
    tai.store %2, @o[] : f32
  }
  tai.return
}

// The value that is added depends on the element.
// CHECK-LABEL: tai.kernel @square
// CHECK: serialize
tai.kernel @square() {
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @o[] : f32
    %1 = arith.mulf %0, %0 : f32
    // expected-error @+2 {{an element of field '@o' is read and written}}
    // expected-note @+1 {{or update it}}
    tai.store %1, @o[] : f32
  }
  tai.return
}

// A counter that is read and then set.
// CHECK-LABEL: tai.kernel @counter
// CHECK: serialize
tai.kernel @counter() {
  %one = arith.constant 1 : i32
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @c[] : i32
    tai.store %0, @n[%i] : i32
    %1 = arith.addi %0, %one : i32
    // expected-error @+2 {{an element of field '@c' is read and written}}
    // expected-note @+1 {{or update it}}
    tai.store %1, @c[] : i32
  }
  tai.return
}

// The greatest, and which it is.
// CHECK-LABEL: tai.kernel @greatest
// CHECK: serialize
tai.kernel @greatest() {
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @o[] : f32
    %2 = arith.cmpf ogt, %0, %1 : f32
    scf.if %2 {
      // expected-error @+2 {{an element of field '@o' is read and written}}
      // expected-note @+1 {{or update it}}
      tai.store %0, @o[] : f32
      %3 = arith.index_cast %i : index to i32
      tai.store %3, @c[] : i32
    }
  }
  tai.return
}

// Sums and products of one element.
// CHECK-LABEL: tai.kernel @mixed
// CHECK: serialize
tai.kernel @mixed(%a: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = memref.load %a[%c0] : memref<?xf32>
    %2 = arith.addf %1, %0 : f32
    // expected-error @+2 {{an element of an array is read and written}}
    // expected-note @+1 {{or update it}}
    memref.store %2, %a[%c0] : memref<?xf32>
    %3 = memref.load %a[%c0] : memref<?xf32>
    %4 = arith.mulf %3, %0 : f32
    // expected-error @+2 {{an element of an array is read and written}}
    // expected-note @+1 {{or update it}}
    memref.store %4, %a[%c0] : memref<?xf32>
  }
  tai.return
}
