//===- Versions.td - Passes that make versions of loops ----*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_VERSIONS_TD
#define TAI_TRANSFORMS_VERSIONS_TD

include "mlir/Pass/PassBase.td"

def VersionExtents : Pass<"tai-version-extents"> {
  let summary = "give a loop a version for whole fields";
  let description = [{
    A loop to a bound that one argument of the kernel determines gets a version
    for the argument with which the loop just reaches the end of the fields that
    it accesses, chosen where the loop begins. In this version, the bounds and
    all integers that the body computes from the argument are constants.

    Loops in which constants cannot help stay as they are: a loop has to add to
    elements other than that of the iteration, or compute with the argument.
    So do loops with more than `max-ops` operations, and loops in kernels whose
    sums have one order for all targets.

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%m) {
      %0 = tai.load @y[%i] : f32
      %1 = arith.addi %i, %c1 : index
      %2 = arith.remsi %1, %m : index
      %3 = tai.atomic add %0, @x[%2] : f32
    }
    // becomes, for fields of 64 elements
    %whole = arith.cmpi eq, %m, %c64 : index
    scf.if %whole {
      // the loop, with %c64 in the place of %m
    } else {
      // the loop
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect"];
  let options = [
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"256",
           "Most operations of a loop that gets versions">,
  ];
}

def UnrollStencils : Pass<"tai-unroll-stencils"> {
  let summary = "write out short loops over the neighbours of an element";
  let description = [{
    Unrolls a serial loop of at most `max-trips` iterations in a parallel loop
    if it accesses a field at an index that is made of both loop indices:
    `x[i + k]` is a shift of `i` for each `k`. Then `tai-scatter-to-gather` and
    `tai-version-interior` treat it as a stencil. Loops that hold others, and
    bodies that would grow beyond `max-ops` operations, stay as they are, and
    so do kernels whose sums have one order for all targets.

    ```mlir
    scf.for %k = %c0 to %c2 step %c1 {
      %0 = arith.addi %i, %k : index
      %1 = tai.atomic add %v, @x[%0] : f32
    }
    // becomes
    %0 = arith.addi %i, %c0 : index
    %1 = tai.atomic add %v, @x[%0] : f32
    %2 = arith.addi %i, %c1 : index
    %3 = tai.atomic add %v, @x[%2] : f32
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect"];
  let options = [
    Option<"maxTrips", "max-trips", "unsigned", /*default=*/"9",
           "Most iterations of a loop that is unrolled">,
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"320",
           "Most operations of the body of the parallel loop afterwards">,
  ];
}

def VersionSlots : Pass<"tai-version-slots"> {
  let summary = "give a loop versions for slots that differ";
  let description = [{
    A loop that adds to a field and accesses it at two indices `a` and `b` from
    outside of the loop, which may be equal or not, becomes three: for `b > a`,
    for `b < a`, and for equal indices, chosen where the loop begins. In the
    first, `b` is `a + max(b - a, 1)`, which is the same number and never `a`,
    as analyses of indices see. `a` is the slot of the first access. The slots
    `a`, `b` and `c` of a wave equation have six orders, with a version each, in
    which both higher slots are such sums.

    Loops with more slots, with more than `max-ops` operations (a third as many
    for three slots), and in
    kernels whose sums have one order for all targets stay as they are.

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%c7) {
      %0 = tai.load @x[%b, %i] : f32
      %1 = arith.addi %i, %c1 : index
      %2 = tai.atomic add %0, @x[%a, %1] : f32
    }
    // becomes
    %d = arith.subi %a, %b : index
    %above = arith.cmpi slt, %c0, %d : index
    scf.if %above {
      %m = arith.maxsi %d, %c1 : index
      %s = arith.addi %b, %m : index
      // the loop, with %s in the place of %a
    } else {
      // the other two
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect"];
  let options = [
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"256",
           "Most operations of a loop that gets versions">,
  ];
}

def VersionRanges : Pass<"tai-version-ranges"> {
  let summary = "give a loop to bounds of the launch an interior";
  let description = [{
    In a loop whose bounds are known at the launch, decides comparisons, minima,
    maxima and remainders of indices that have one answer for all iterations but
    a few at both ends of a range: `(i + 1) % n` is `i + 1` there, and `max(i - 1,
    0)` is `i - 1`. The loop becomes one over the interior, in which they are
    decided, and for each index one over the iterations near both ends, which is
    the loop as it was. The launch takes these if its ranges are long enough and
    no array that the loop writes overlaps with another one.

    Loops whose iterations may meet in memory, with more than `max-ops`
    operations, or with random numbers stay as they are.

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%n) {
      %1 = arith.addi %i, %c1 : index
      %2 = arith.remsi %1, %n : index
      %3 = memref.load %x[%2] : memref<?xf32>
      memref.store %3, %y[%i] : memref<?xf32>
    }
    // becomes, where n is at least 3, and the arrays are apart
    tai.parallel_for (%i) = (%c1) to (%m) {
      %1 = arith.addi %i, %c1 : index
      %3 = memref.load %x[%1] : memref<?xf32>
      memref.store %3, %y[%i] : memref<?xf32>
    }
    // and a loop of two iterations
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::memref::MemRefDialect",
                           "::mlir::scf::SCFDialect"];
  let options = [
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"160",
           "Most operations of a loop that gets versions">,
  ];
}

def GatherRanges : Pass<"tai-gather-ranges"> {
  let summary = "gather additions over ranges and arrays of the launch";
  let description = [{
    Does for loops whose bounds are known at the launch, and for additions to
    array arguments, what `tai-scatter-to-gather` does for fields and constant
    bounds: the iteration that owns an element makes all additions to it. Each
    addition has to be at a constant distance from the iteration along each
    index of the loop.

    The loop becomes several: one over the elements for which all terms exist;
    for each index, one over the elements near the ends of its range, with
    tests; and a copy of the loop without the additions. The launch takes them if
    the range is as long as the stencil is wide, and no array that the loop
    writes overlaps with another one. Otherwise it takes the loop as it was.

    The pass leaves alone: additions to elements that the loop also reads,
    values that read what other iterations write, loops with more than `max-ops`
    operations to compute again, and kernels whose sums are compensated or have
    one order for all targets.

    ```mlir
    tai.parallel_for (%i) = (%c1) to (%n) {
      %0 = memref.load %y[%i] : memref<?xf32>
      %1 = arith.subi %i, %c1 : index
      %2 = memref.atomic_rmw addf %0, %x[%1] : (f32, memref<?xf32>) -> f32
    }
    // becomes, where %x and %y do not overlap
    tai.parallel_for (%i) = (%c0) to (%m) {
      %1 = arith.addi %i, %c1 : index
      %0 = memref.load %y[%1] : memref<?xf32>
      %2 = memref.load %x[%i] : memref<?xf32>
      %3 = arith.addf %2, %0 : f32
      memref.store %3, %x[%i] : memref<?xf32>
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::memref::MemRefDialect",
                           "::mlir::scf::SCFDialect"];
  let options = [
    Option<"maxOps", "max-ops", "unsigned", /*default=*/"128",
           "Largest number of operations computed again">,
  ];
}

#endif // TAI_TRANSFORMS_VERSIONS_TD
