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
    as analyses of indices see. `a` is the slot of the first access.

    Loops with other open pairs, with more than `max-ops` operations, and in
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

#endif // TAI_TRANSFORMS_VERSIONS_TD
