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

// -----

// Reads of what another iteration writes.

!t = !tai.root<dense<[i: 64], {x: f32, y: f32}>, dense<[i: 8, j: 8], {z: f32}>, {o: f32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @z = @t["z"] : f32, rank 2
tai.field @o = @t["o"] : f32, rank 0

// CHECK-LABEL: tai.kernel @shift
// CHECK: serialize
tai.kernel @shift() {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  // expected-note @+1 {{run this loop on one thread ('serialize'), or write to another field and copy it in a later loop}}
  tai.parallel_for (%i) = (%c1) to (%c64) {
    %0 = arith.subi %i, %c1 : index
    // expected-error @+1 {{an element of field '@x' is read here by one iteration of a parallel loop, while another one writes it, and the result would depend on which of them comes first}}
    %1 = tai.load @x[%0] : f32
    // expected-note @+1 {{written here: iteration 2 reads what iteration 1 writes}}
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @transpose
// CHECK: serialize
tai.kernel @transpose() {
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i, %j) in @z {
    // expected-error @+1 {{an element of field '@z' is read here by one iteration}}
    %0 = tai.load @z[%j, %i] : f32
    // expected-note @+1 {{written here: iteration (1, 0) reads what iteration (0, 1) writes}}
    tai.store %0, @z[%i, %j] : f32
  }
  tai.return
}

// A sum with an element of the iteration's own is a store in another form.
// CHECK-LABEL: tai.kernel @prefix
// CHECK: serialize
tai.kernel @prefix() {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) = (%c1) to (%c64) {
    %0 = arith.subi %i, %c1 : index
    // expected-error @+1 {{an element of field '@x' is read here by one iteration}}
    %1 = tai.load @x[%0] : f32
    // expected-note @+1 {{written here}}
    %2 = tai.atomic add %1, @x[%i] : f32
  }
  tai.return
}

// A sum to which all iterations add, and its value so far.
// CHECK-LABEL: tai.kernel @total_so_far
// CHECK: serialize
tai.kernel @total_so_far() {
  // expected-note @+1 {{run this loop on one thread ('serialize'), or use the value that the update returns, or read the element in a later loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-note @+1 {{updated here: iteration 1 reads what iteration 0 writes}}
    %1 = tai.atomic add %0, @o[] : f32
    // expected-error @+1 {{an element of field '@o' is read here by one iteration of a parallel loop, while another one updates it, and the result would depend on which of them comes first}}
    %2 = tai.load @o[] : f32
    %3 = arith.mulf %2, %0 : f32
    tai.store %3, @y[%i] : f32
  }
  tai.return
}

// All iterations store to one element, and read it.
// CHECK-LABEL: tai.kernel @scratch
// CHECK: serialize
tai.kernel @scratch() {
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-note @+1 {{written here}}
    tai.store %0, @o[] : f32
    // expected-error @+1 {{an element of field '@o' is read here by one iteration}}
    %1 = tai.load @o[] : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// Under conditions that indices decide, and in a serial loop.
// CHECK-LABEL: tai.kernel @conditions
// CHECK: serialize
tai.kernel @conditions() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c60 = arith.constant 60 : index
  // expected-note @+1 {{run this loop}}
  tai.parallel_for (%i) = (%c0) to (%c60) {
    %0 = arith.remsi %i, %c2 : index
    %1 = arith.cmpi eq, %0, %c0 : index
    scf.if %1 {
      scf.for %k = %c0 to %c3 step %c1 {
        %2 = arith.addi %i, %k : index
        // expected-error @+1 {{an element of field '@x' is read here by one iteration}}
        %3 = tai.load @x[%2] : f32
        // expected-note @+1 {{written here: iteration 0 reads what iteration 2 writes}}
        tai.store %3, @x[%i] : f32
      }
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 8], {x: f64, gx: f64, y: f64, gy: f64}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f64, rank 1, adjoint @gx
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @gy = @t["gy"] : f64, rank 1

// An equality of floats may hold for one iteration alone, and is left to the
// checks of a run; another comparison, or an inequality, may not.
tai.kernel @oeq_t(%n: f64) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf oeq, %0, %n : f64
    scf.if %1 {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
tai.kernel @ueq_t(%n: f64) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf ueq, %0, %n : f64
    scf.if %1 {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
tai.kernel @une_e(%n: f64) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf une, %0, %n : f64
    scf.if %1 {
    } else {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
tai.kernel @one_e(%n: f64) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf one, %0, %n : f64
    scf.if %1 {
    } else {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
tai.kernel @une_t(%n: f64) {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{run this loop on one thread ('serialize')}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf une, %0, %n : f64
    scf.if %1 {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      // expected-error @+2 {{an element of field '@y' is read and written by the iterations}}
      // expected-note @+1 {{or update it by one operation whose order does not matter}}
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
tai.kernel @oeq_e(%n: f64) {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{run this loop on one thread ('serialize')}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf oeq, %0, %n : f64
    scf.if %1 {
    } else {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      // expected-error @+2 {{an element of field '@y' is read and written by the iterations}}
      // expected-note @+1 {{or update it by one operation whose order does not matter}}
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
tai.kernel @olt_t(%n: f64) {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{run this loop on one thread ('serialize')}}
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f64
    %1 = arith.cmpf olt, %0, %n : f64
    scf.if %1 {
      %2 = tai.load @y[%c0] : f64
      %3 = math.sin %2 : f64
      %4 = arith.subf %0, %3 : f64
      // expected-error @+2 {{an element of field '@y' is read and written by the iterations}}
      // expected-note @+1 {{or update it by one operation whose order does not matter}}
      tai.store %4, @y[%c0] : f64
    }
  }
  tai.return
}
