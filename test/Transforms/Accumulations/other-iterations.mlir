// RUN: tai-opt %s --tai-recognize-reductions --canonicalize | FileCheck %s
// RUN: tai-opt %s --tai-recognize-reductions=checks --canonicalize | FileCheck %s --check-prefix=CHECKS
// RUN: tai-opt %s --tai-recognize-reductions="checks one-thread" --canonicalize | FileCheck %s --check-prefix=ONE

// Iterations that read what other iterations may write: launches are refused
// where bounds and arguments decide, and the rest is looked for as it runs.

// CHECK-NOT: tai.precondition
// CHECK-NOT: tai.assert
// ONE-NOT: tai.precondition
// ONE-NOT: tai.assert

tai.tree @t : !tai.root<dense<[i: 64], {x: f32, y: f32, b: i32}>, dense<[i: 8, j: 8], {z: f32}>, {o: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @o = @t["o"] : f32, rank 0
tai.field @z = @t["z"] : f32, rank 2

// The value of a shared sum that only decides, of a shared minimum, the value
// that an update returns, and a sum of the iteration's own.
// CHECK-LABEL: tai.kernel @hints
// CHECK-NOT: serialize
tai.kernel @hints() {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1.0 : f32
  %most = arith.constant 9.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @z[%c0, %c0] : f32
    %1 = arith.cmpf olt, %0, %most : f32
    scf.if %1 {
      %2 = tai.atomic add %one, @z[%c0, %c0] : f32
      tai.store %2, @y[%i] : f32
    }
    %3 = tai.atomic min %one, @o[] : f32
    %4 = tai.load @o[] : f32
    %5 = tai.atomic add %4, @x[%i] : f32
    %6 = tai.load @x[%i] : f32
    tai.store %6, @y[%i] : f32
  }
  tai.return
}

// CHECKS-LABEL: tai.kernel @long
// CHECKS-SAME: %[[N:.*]]: index
// CHECKS: %[[WIDE:.*]] = arith.index_cast %[[N]] : index to i64
// CHECKS: tai.precondition %{{.*}}, "an element of field '@x' is read here by one iteration of a parallel loop, while another iteration writes it
// CHECKS: tai.parallel_for
tai.kernel @long(%n: index) {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c1) to (%n) {
    %0 = arith.subi %i, %c1 : index
    %1 = tai.load @x[%0] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// CHECKS-LABEL: tai.kernel @slots
// CHECKS-SAME: (%[[TO:.*]]: index, %[[OF:.*]]: index)
// CHECKS-DAG: arith.index_cast %[[TO]]
// CHECKS-DAG: arith.index_cast %[[OF]]
// CHECKS: tai.precondition
tai.kernel @slots(%to: index, %of: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %0 = arith.addi %i, %c1 : index
    %1 = tai.load @z[%of, %0] : f32
    tai.store %1, @z[%to, %i] : f32
  }
  tai.return
}

// Two arrays that may be one.
// CHECKS-LABEL: tai.kernel @arrays
// CHECKS-SAME: (%[[A:.*]]: memref<?xf32>, %[[B:.*]]: memref<?xf32>
// CHECKS-DAG: memref.extract_aligned_pointer_as_index %[[A]]
// CHECKS-DAG: memref.extract_aligned_pointer_as_index %[[B]]
// CHECKS: tai.precondition %{{.*}}, "two arguments of the kernel are one array
tai.kernel @arrays(%a: memref<?xf32>, %b: memref<?xf32>, %n: index) {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c1) to (%n) {
    %0 = arith.subi %i, %c1 : index
    %1 = memref.load %b[%0] : memref<?xf32>
    memref.store %1, %a[%i] : memref<?xf32>
  }
  tai.return
}

// A value that the launch does not know.
// CHECKS-LABEL: tai.kernel @by_a_field
// CHECKS: tai.load @b
// CHECKS: tai.assert %{{.*}}, "an element of field '@x' is read here by one iteration
// CHECKS: tai.parallel_for
tai.kernel @by_a_field() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c32 = arith.constant 32 : index
  %0 = tai.load @b[%c0] : i32
  %k = arith.index_cast %0 : i32 to index
  tai.parallel_for (%i) = (%c1) to (%c32) {
    %1 = arith.addi %i, %k : index
    %2 = tai.load @x[%1] : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// A mirrored index: up to floor((m - 0) / 1), from floor((m - n) / 1) + 1 on.
// CHECKS-LABEL: tai.kernel @mirrored
// CHECKS-SAME: (%[[M:.*]]: index, %[[N:.*]]: index)
// CHECKS: arith.maxsi
// CHECKS: arith.minsi
// CHECKS: tai.precondition
// CHECKS: tai.parallel_for
tai.kernel @mirrored(%m: index, %n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.subi %m, %i : index
    %1 = tai.load @x[%0] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// A scaled index is divided.
// CHECKS-LABEL: tai.kernel @scaled
// CHECKS-COUNT-2: arith.floordivsi
// CHECKS: tai.precondition
// CHECKS: tai.parallel_for
tai.kernel @scaled(%m: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.muli %i, %c3 : index
    %1 = arith.addi %0, %m : index
    %2 = tai.load @x[%1] : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// CHECKS-LABEL: tai.kernel @transposed
// CHECKS-SAME: (%[[N:.*]]: index)
// CHECKS: tai.precondition
// CHECKS: tai.parallel_for
tai.kernel @transposed(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) {
    %0 = tai.load @z[%j, %i] : f32
    tai.store %0, @z[%i, %j] : f32
  }
  tai.return
}

// Neither index has the factor 1: no test before the launch.
// CHECKS-LABEL: tai.kernel @two_factors
// CHECKS-NOT: tai.precondition
// CHECKS: tai.parallel_for
tai.kernel @two_factors(%m: index, %n: index) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.muli %i, %c3 : index
    %1 = arith.addi %0, %m : index
    %2 = arith.muli %i, %c2 : index
    %3 = tai.load @x[%1] : f32
    tai.store %3, @x[%2] : f32
  }
  tai.return
}

// CHECKS-LABEL: tai.kernel @permuted
// CHECKS: %[[WRITERS:.*]] = memref.alloc() : memref<64xf64>
// CHECKS: %[[READERS:.*]] = memref.alloc() : memref<64xf64>
// CHECKS: memref.atomic_rmw maximumf %{{.*}}, %[[READERS]]
// CHECKS: memref.atomic_rmw maximumf %{{.*}}, %[[WRITERS]]
// CHECKS: tai.assert %{{.*}}, "an element of field '@x', at [{}], is read by one iteration of a parallel loop and written by another one
// CHECKS-NEXT: tai.load @x
// CHECKS: tai.assert %{{.*}}, "an element of field '@x', at [{}], is read by one iteration
// CHECKS-NEXT: tai.store
tai.kernel @permuted() attributes {tai.check_updates} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%1] : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// Iterations that are apart: red and black cells, halves, time slots, a border,
// a maximum.
// CHECKS-LABEL: tai.kernel @apart
// CHECKS-NOT: tai.precondition
// CHECKS-NOT: tai.assert
tai.kernel @apart(%t: index) attributes {tai.check_updates} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c7 = arith.constant 7 : index
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %0 = arith.muli %i, %c2 : index
    %1 = arith.addi %0, %c1 : index
    %2 = tai.load @x[%1] : f32
    tai.store %2, @x[%0] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %0 = arith.addi %i, %c32 : index
    %1 = tai.load @x[%0] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %0 = arith.addi %i, %c1 : index
    %next = arith.addi %t, %c1 : index
    %1 = tai.load @z[%t, %0] : f32
    tai.store %1, @z[%next, %i] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c7) {
    %0 = tai.load @z[%c1, %i] : f32
    tai.store %0, @z[%c0, %i] : f32
  }
  tai.parallel_for (%i) = (%c1) to (%c32) {
    %0 = arith.subi %i, %c1 : index
    %1 = tai.load @x[%0] : f32
    %2 = tai.atomic max %1, @x[%i] : f32
  }
  tai.return
}

tai.tree @flags : !tai.root<{found: i32, total: i32}>
tai.field @found = @flags["found"] : i32, rank 0
tai.field @total = @flags["total"] : i32, rank 0

// A flag that iterations set, and that others read to save work.
// CHECKS-LABEL: tai.kernel @flag
// CHECKS-NOT: tai.precondition
// CHECKS: tai.parallel_for
tai.kernel @flag(%n: index) {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @found[] : i32
    %1 = arith.cmpi eq, %0, %zero : i32
    scf.if %1 {
      tai.store %one, @found[] : i32
    }
  }
  tai.return
}

// The value of the flag is added to a sum.
// CHECKS-LABEL: tai.kernel @flag_as_data
// CHECKS: tai.precondition %{{.*}}, "an element of field '@found' is read here
// ONE-LABEL: tai.kernel @flag_as_data
tai.kernel @flag_as_data(%n: index) {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @found[] : i32
    %1 = tai.atomic add %0, @total[] : i32
    tai.store %zero, @found[] : i32
  }
  tai.return
}

// The flag decides on an element of the iteration.
// CHECKS-LABEL: tai.kernel @flag_of_stores
// CHECKS: tai.precondition %{{.*}}, "an element of field '@found' is read here
tai.kernel @flag_of_stores(%n: index) {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0 : i32
  %one = arith.constant 1 : i32
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.load @found[] : i32
    %1 = arith.cmpi eq, %0, %zero : i32
    scf.if %1 {
      tai.store %one, @b[%i] : i32
    }
    tai.store %one, @found[] : i32
  }
  tai.return
}
