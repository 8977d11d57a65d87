//===- Passes.td - Passes on kernels -----------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_PASSES_TD
#define TAI_TRANSFORMS_PASSES_TD

include "mlir/Pass/PassBase.td"
include "tai/Transforms/Checks.td"
include "tai/Transforms/Versions.td"

def EliminateLocals : Pass<"tai-eliminate-locals"> {
  let summary = "turn mutable local variables into values";
  let description = [{
    Replaces each `tai.local_load` by the value that the last `tai.local_store`
    wrote, or zero before the first (paper, figure 4, right). Values written in
    a branch or a loop become its results; those carried from one iteration to
    the next become `iter_args`.

    A variable that is used in a parallel loop nested in its scope, or in an op
    that is not `scf.if`, `scf.for` or `scf.while`, is an error: iterations that
    run at the same time cannot share it.

    ```mlir
    %a = tai.alloca : !tai.local<f32>
    tai.local_store %x, %a : f32
    scf.if %c {
      tai.local_store %y, %a : f32
    }
    %r = tai.local_load %a : f32
    ```

    becomes

    ```mlir
    %r = scf.if %c -> (f32) {
      scf.yield %y : f32
    } else {
      scf.yield %x : f32
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::tai::TaiDialect"];
}

def SimplifyHugeBodies : Pass<"tai-simplify-huge-bodies"> {
  let summary = "canonicalise the bodies of huge loops separately";
  let description = [{
    Canonicalises each body with at least `min-ops` operations and its nested
    ops, and eliminates common subexpressions in it, including reads without a
    write in between. Runs before `canonicalize` and `cse`, which then have
    little to do: their time is quadratic in the size of a body, because the
    former visits the whole body again after each rewrite, to see whether the
    loop is dead, and the latter scans all ops between two equal reads.

    Example: with `min-ops=3`,

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%n) {
      %s = arith.addf %a, %zero : f32
      %t = arith.select %true, %s, %b : f32
      tai.store %t, @x[%i] : f32
    }
    ```

    becomes the same as by `canonicalize` and `cse`. Smaller bodies are not
    changed.
  }];
  let options = [
    Option<"minOps", "min-ops", "unsigned", /*default=*/"2000",
           "Least number of operations of a body that is huge">,
  ];
}

def FoldAngles : Pass<"tai-fold-angles"> {
  let summary = "guard what upstream folds wrongly";
  let description = [{
    Replaces `math.atan2` of two zero constants by its value, 0 or π with the
    signs of the operands, as at run time. Runs before constant folding, because
    the folder of the op yields NaN. Operands that are computed from constants
    count as constants. A cast of an index to fewer than 64 bits, which may lose
    some, becomes one to i64 and a truncation: upstream drops a cast and the one
    back to index.

    ```mlir
    %a = math.atan2 %zero, %zero : f64
    ```

    becomes

    ```mlir
    %a = arith.constant 0.0 : f64
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect"];
}

def FlattenBranches : Pass<"tai-flatten-branches"> {
  let summary = "turn cheap and safe branches into selects";
  let description = [{
    Replaces an `scf.if` by the operations of both arms, followed by one
    `arith.select` for each result (paper, figure 4, middle), where

    - neither arm has a side effect or can fault: a `tai.load` counts as safe
      where its indices are known to lie in the field;
    - neither arm can produce a non-finite value or derivative from finite
      values: a division, root or logarithm stays under its condition unless its
      operand is known to be safe. (Flattening these is how NaN enters the
      gradients of untaken branches.)
    - the arms together have at most `max-ops` operations.

    Other branches are not changed, and the adjoint mirrors them. With `force`,
    only side effects, faults and loops keep a branch.

    ```mlir
    %r = scf.if %c -> (f32) {
      scf.yield %a : f32
    } else {
      %2 = arith.mulf %a, %b : f32
      scf.yield %2 : f32
    }
    ```

    becomes

    ```mlir
    %2 = arith.mulf %a, %b : f32
    %r = arith.select %c, %a, %2 : f32
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect"];
  let options = [
    Option<"force", "force", "bool", /*default=*/"false",
           "Flatten branches of any size that have no effects and cannot fault">,
    Option<"maxOps", "max-ops", "unsigned", /*default=*/"16",
           "Largest number of operations in both arms of a branch together">,
  ];
}

def SinkAdjoints : Pass<"tai-sink-adjoints"> {
  let summary = "move what only one arm of a branch contributes into that arm";
  let description = [{
    The reverse of `if contact: f += g(x)` is a branch that returns adjoints,
    zeros where the branch was not taken, and behind it the reverse of what
    computed `x`, which then adds zeros up. This pass moves that code into the
    arm that is not zero, if all that it does is to contribute to adjoints.

    Applies to branches that the reverse of a branch has marked, in kernels with
    guards: a zero adjoint contributes zero there, whatever the partial
    derivative is. Loops that LLVM may vectorise stay as they are.

    ```mlir
    %g = scf.if %c -> (f64) {
      %0 = "some.adjoint"() : () -> f64
      scf.yield %0 : f64
    } else {
      scf.yield %c0 : f64
    } {tai.adjoint_branch}
    %1 = arith.mulf %g, %partial : f64
    %2 = tai.atomic add %1, @gx[%i] : f64
    // becomes
    scf.if %c {
      %g = "some.adjoint"() : () -> f64
      %1 = arith.mulf %g, %partial : f64
      %2 = tai.atomic add %1, @gx[%i] : f64
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect"];
}

def SummarizeKernels : Pass<"tai-summarize-kernels"> {
  let summary = "list the accesses of each kernel to fields";
  let description = [{
    Sets the `summary` attribute of each kernel: one `#tai.access` for each
    field, kind of access and index map, in the order of the first such access.
    Where indices are affine, the map takes the induction variables of the loops
    around the access (dimensions, from the outermost) and the integer arguments
    of the kernel (symbols) to the indices. A kernel that touches part of a
    field in a way that is not affine has an entry without a map.

    ```mlir
    tai.kernel @step(%t: i32) attributes {summary = [
        #tai.access<read @x, affine_map<(d0)[s0] -> (s0 - 1, d0)>>,
        #tai.access<write @x, affine_map<(d0)[s0] -> (s0, d0)>>]}
    ```
  }];
}

def MarkExclusive : Pass<"tai-mark-exclusive"> {
  let summary = "find atomics on elements that no other iteration reaches";
  let description = [{
    Marks a `tai.atomic` as `exclusive` where no other iteration of the parallel
    loop around it writes the same element: all writes of the loop to that field
    agree in indices that differ between iterations. The mark is removed where
    that does not hold.
  }];
}

//===----------------------------------------------------------------------===//
// Loops
//===----------------------------------------------------------------------===//

def NormalizeIndices : Pass<"tai-normalize-indices"> {
  let summary = "normalise shifted and wrapped indices";
  let description = [{
    Replaces an index of an access that is a shift of one index of the parallel
    loop, wrapped around its range or not, by an addition and at most one select
    on `index`. The expression is recognised by evaluating it for each value of
    the loop index, so the bounds of the loop must be constants.

    ```mlir
    // x[(i - 1) mod 8], in 32 bits, with the sign of the divisor
    %0 = arith.index_cast %i : index to i32
    %1 = arith.subi %0, %c1 : i32
    %2 = arith.floordivsi %1, %c8 : i32
    %3 = arith.muli %2, %c8 : i32
    %4 = arith.subi %1, %3 : i32
    %5 = arith.index_cast %4 : i32 to index
    %6 = tai.load @x[%5] : f32
    // becomes
    %0 = arith.addi %i, %cm1 : index
    %1 = arith.cmpi slt, %0, %c0 : index
    %2 = arith.addi %i, %c7 : index
    %3 = arith.select %1, %2, %0 : index
    %4 = tai.load @x[%3] : f32
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect"];
}

def ScatterToGather : Pass<"tai-scatter-to-gather"> {
  let summary = "turn scatters to shifted indices into gathers";
  let description = [{
    In a parallel loop over all elements of a field, additions to shifted
    elements (`x[i + 1] += f(i)`, wrapped around the end of the field or left
    out there) are replaced by one addition to the element of the iteration's
    own index: `x[i] += f(i - 1)`. It is the adjoint of a stencil, written as a
    stencil. The addition is `exclusive`, so that it needs no atomic operation,
    its order is fixed, and the loop vectorises.

    A loop over the interior of a field, if that is more than half of it,
    becomes a loop over the whole field, whose body tests whether it is in the
    interior.

    A loop that loads an element and stores a constant to it, as the adjoint of
    a step in time does, stores in a second loop where other iterations have to
    load the element as well. On a GPU, where that is a second launch, this
    happens in deterministic kernels only.

    The pass leaves alone: additions at an index that is no shift of a loop
    index, loops over less of the field, values that cannot be computed twice or
    that read what the loop writes, and more than `max-ops` operations to
    compute again.

    In a kernel with compensated sums the terms of an iteration are summed with
    twice the digits: f32 in f64, f64 with its rounding errors beside it.

    ```mlir
    tai.parallel_for (%i) in @x {
      %0 = tai.load @y[%i] : f32
      %1 = arith.addi %i, %c1 : index
      %2 = arith.remui %1, %c8 : index
      %3 = tai.atomic add %0, @x[%2] : f32
    }
    // becomes, with %s = %i - 1 wrapped into [0, 8)
    tai.parallel_for (%i) in @x {
      %0 = tai.load @y[%s] : f32
      %1 = tai.atomic add %0, @x[%i] exclusive : f32
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect"];
  let options = [
    Option<"maxOps", "max-ops", "unsigned", /*default=*/"256",
           "Largest number of operations computed again for one field">,
    Option<"pairSums", "pair-sums", "bool", /*default=*/"true",
           "Gather compensated sums of f64 as well; not for a target that "
           "fuses products into several of the additions that use them">,
    Option<"onDevice", "on-device", "bool", /*default=*/"false",
           "The loops become launches of a GPU">,
  ];
}

def KeepOrder : Pass<"tai-keep-order"> {
  let summary = "keep the order of iterations where it matters";
  let description = [{
    For one thread, on which a loop runs as if its iterations followed one
    another: marks each parallel loop whose iterations may meet in memory as
    `in_order`. Later passes reorder the reads and writes of different
    iterations, or tell LLVM that it may, only in loops without the mark.

    Iterations meet if one of them stores to an element that another one reads
    or stores to, unless the indices prove that it does not. Atomic updates of
    one kind do not count where nothing reads what they update, nor do stores of
    one value.

    ```mlir
    tai.parallel_for (%i) = (%c1) to (%c9) {
      %j = arith.subi %i, %c1 : index
      %0 = tai.load @x[%j] : f32
      tai.store %0, @x[%i] : f32
    }
    // becomes
    tai.parallel_for (%i) = (%c1) to (%c9) {
      // the same
    } {in_order}
    ```
  }];
}

def VersionInterior : Pass<"tai-version-interior"> {
  let summary = "give a loop a second body for its interior";
  let description = [{
    Where all conditions of a body on the innermost loop index (is this a
    border, does an index wrap) are constant on most of its range, wraps the
    body in an `scf.if` on that range, with constants for these conditions. The
    branch carries the range as `tai.interior` for `tai-split-index-sets`.

    ```mlir
    tai.parallel_for (%i) in @x {
      %0 = arith.cmpi eq, %i, %c0 : index
      %1 = arith.select %0, %c7, %im1 : index
      "some.work"(%1) : (index) -> ()
    }
    // becomes
    tai.parallel_for (%i) in @x {
      %inside = arith.cmpi sge, %i, %c1 : index
      scf.if %inside {
        "some.work"(%im1) : (index) -> ()
      } else {
        %0 = arith.cmpi eq, %i, %c0 : index
        %1 = arith.select %0, %c7, %im1 : index
        "some.work"(%1) : (index) -> ()
      } {tai.interior = array<i64: 1, 8>}
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect"];
  let options = [
    Option<"minLength", "min-length", "int64_t", /*default=*/"16",
           "Shortest range of the innermost index that is split">,
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"400",
           "Largest body that is copied, in operations">,
  ];
}

def SplitIndexSets : Pass<"tai-split-index-sets"> {
  let summary = "split a loop into its interior and its borders";
  let description = [{
    Splits a serial loop whose body is a branch marked `tai.interior` into a
    loop over the interior, without the branch, and loops over the borders.

    ```mlir
    scf.for %i = %lo to %hi step %c1 {
      scf.if %inside {
        "in.interior"(%i) : (index) -> ()
      } else {
        "at.border"(%i) : (index) -> ()
      } {tai.interior = array<i64: 1, 8>}
    }
    // becomes, with lo <= a <= b <= hi
    scf.for %i = %a to %b step %c1 {
      "in.interior"(%i) : (index) -> ()
    }
    scf.for %side = %c0 to %c2 step %c1 {
      // [lo, a), then [b, hi)
      scf.for %i = %first to %end step %c1 {
        "at.border"(%i) : (index) -> ()
      }
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect"];
}

def UnrollAndJam : Pass<"tai-unroll-and-jam"> {
  let summary = "unroll and jam loops around serial reductions";
  let description = [{
    Unrolls a loop that is annotated as parallel, and jams the serial loops in
    it: each carries the sums of all unrolled iterations, up to 512 bits. Each
    sum keeps its order, but the additions of different sums are independent.
    Where bounds differ, the common part is jammed and each continues alone;
    branches without effects become selects.

    ```mlir
    scf.for %i = %lo to %hi step %c1 { // sixteen of these, with sixteen sums
      %sum = scf.for %j = %c0 to %n step %c1 iter_args(%s = %x) -> (f32) {
        %u = arith.addf %s, %s : f32
        scf.yield %u : f32
      }
    } {llvm.loop_annotation = #llvm.loop_annotation<
        parallelAccesses = #llvm.access_group<id = distinct[0]<>>>}
    ```
  }];
  let options = [Option<"reassociate", "reassociate", "bool", "false", "sums "
                        "may be added up in any order: jam where LLVM gathers">];
  let dependentDialects = ["arith::ArithDialect", "scf::SCFDialect"];
}

def FuseLaunches : Pass<"tai-fuse-launches", "::mlir::ModuleOp"> {
  let summary = "fuse kernels that are launched one after another";
  let description = [{
    Where a host function launches two kernels in a row (with nothing but
    arithmetic between), each of one parallel loop over the same constant box,
    and no iteration of the second meets what another iteration of the first
    wrote, or overwrites what another one reads, launches one kernel with one
    loop that runs both bodies. Loads of an element that the same iteration has
    just stored become that value; the stores stay. Longer runs of launches
    become one likewise. The kernels themselves stay for others that launch
    them.

    Indices are compared as sums of induction variables and of operands of the
    host. An argument that differs by a constant from one of the other launch is
    computed from that.

    ```mlir
    tai.launch @f(%t) : (i32) -> ()   // y[t + 1, i] = f(x[t, i])
    %t1 = arith.addi %t, %c1 : i32
    tai.launch @g(%t1) : (i32) -> ()  // z[t, i] = g(y[t, i])
    // becomes
    tai.launch @f_g(%t) : (i32) -> ()
    ```

    The float sums of deterministic kernels into the same elements are not mixed.

    Not fused: launches under a tape, which are differentiated one by one, and
    kernels that return values, have array arguments, draw random numbers,
    print, assert, or access sparse fields.
  }];
  let options = [
    Option<"maxAccesses", "max-accesses", "int64_t", /*default=*/"128",
           "Most accesses to fields in a kernel that is made">,
  ];
  let statistics = [
    Statistic<"numFused", "num-fused", "Launches that became part of another">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect"];
}

def VectorsToMemory : Pass<"tai-vectors-to-memory"> {
  let summary = "put vectors that are indexed at run time into memory";
  let description = [{
    Vectors whose components `vector.extract` and `vector.insert` name by
    numbers that are known when the code runs become arrays on the stack: an
    access is a load or a store there, and as scalars, which `tai-scalarize`
    makes of the others, a select for each component. Selects are kept for up to
    6 components in loops and 16 elsewhere.

    Vectors that loops and branches connect share an array if none is needed
    after another is written. Where one is, upstream's one-shot bufferization
    makes arrays and copies, of up to 200 accesses in a function. A vector that
    comes from outside of a parallel loop is copied for each iteration. All
    others stay vectors, as do those of a function beyond 32 KiB.

    ```mlir
    %v = scf.for %i = %c0 to %n step %c1 iter_args(%w = %u) -> vector<64xf32> {
      %x = vector.insert %a, %w[%i] : f32 into vector<64xf32>
      scf.yield %x : vector<64xf32>
    }
    // becomes
    %v = memref.alloca() : memref<64xf32>
    scf.for %i = %c0 to %n step %c1 {
      memref.store %a, %v[%i] : memref<64xf32>
    }
    ```
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect",
    "::mlir::bufferization::BufferizationDialect",
    "::mlir::memref::MemRefDialect", "::mlir::scf::SCFDialect",
    "::mlir::tensor::TensorDialect", "::mlir::vector::VectorDialect"];
}

def Scalarize : Pass<"tai-scalarize"> {
  let summary = "turn small vectors and matrices into scalars";
  let description = [{
    Replaces each value of vector type in kernels and host functions by one
    scalar for each component: elementwise operations, the matrix operations of
    the dialect, accesses to fields, and the values that loops and branches
    carry. LLVM vectorises over the iterations of a loop, which it cannot do
    where the values are vectors already.

    Arguments and results of a kernel keep their types: arguments are split by
    `vector.to_elements` on entry, and results built by `vector.from_elements`
    on return.

    ```mlir
    %a = tai.load @v[%i] : vector<2xf32>
    %b = arith.mulf %a, %a : vector<2xf32>
    %n = tai.sum %b : vector<2xf32>
    // becomes
    %a0 = tai.load @v[%i] component [%c0] : f32
    %a1 = tai.load @v[%i] component [%c1] : f32
    %b0 = arith.mulf %a0, %a0 : f32
    %b1 = arith.mulf %a1, %a1 : f32
    %n = arith.addf %b0, %b1 : f32
    ```
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::LLVM::LLVMDialect",
    "::mlir::math::MathDialect", "::mlir::scf::SCFDialect",
    "::mlir::vector::VectorDialect", "::mlir::tai::TaiRTDialect"];
}

def VectorizeBlocks : Pass<"tai-vectorize-blocks"> {
  let summary = "run loops over blocked fields a row at a time";
  let description = [{
    Where the innermost level of a field is dense and cuts the index space into
    blocks, the neighbours of an element may lie in another block, and the
    address is no affine function of the index. This pass turns a loop over the
    elements of such a field into one over its blocks. In the interior, where
    every question about the indices has the same answer for all elements, each
    row of a block becomes operations on vectors: neighbours across a border are
    a shuffle of two rows. Other blocks run element by element.

    Applies to loops that read elements at constant distances, compute with
    elementwise operations and write to the iteration's own elements.

    ```mlir
    tai.parallel_for (%i, %j) in @x {
      "some.work"(%i, %j) : (index, index) -> ()
    }
    // becomes, for a layout pointer<[i: 4, j: 4], dense<[i: 8, j: 8], {x: f32}>>
    tai.parallel_for (%i, %j) in @x level 2 {
      scf.if %inside {
        "on.a.row"(%i, %j, %row) : (index, index, vector<8xf32>) -> ()
      } else {
        scf.for %k = %c0 to %c64 step %c1 {
          "some.work"(%i, %k) : (index, index) -> ()
        }
      }
    }
    ```
  }];
  let options = [
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"512",
           "Unroll rows of a block into at most so many operations">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::LLVM::LLVMDialect",
                           "::mlir::tai::TaiRTDialect"];
}

def RecognizeReductions : Pass<"tai-recognize-reductions", "::mlir::ModuleOp"> {
  let summary = "make updates of elements that iterations share atomic";
  let description = [{
    Where an iteration of a parallel loop loads an element, combines it with a
    value and stores it, and other iterations may do so with the same element,
    the load and the store become a `tai.atomic` (`memref.atomic_rmw` in an
    array), if the combination is one of those that atomics have: sums and
    differences, products, minima, maxima, `and`, `or`, `xor`. It may be written
    in several steps, under a condition, by a select, by a branch that yields
    the new value, and, for minima and maxima, by a comparison of the value with
    the element and a branch around the store. Elements that no other iteration
    reaches keep their loads and stores.

    ```mlir
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      %1 = tai.load @most[] : f32
      %2 = arith.cmpf ogt, %0, %1 : f32
      scf.if %2 {
        tai.store %0, @most[] : f32
      }
    }
    // becomes
    tai.parallel_for (%i) in @x {
      %0 = tai.load @x[%i] : f32
      %1 = tai.atomic max %0, @most[] : f32
    }
    ```

    The pass fails at a store that remains although all iterations of a loop, or
    all that satisfy a condition other than an equality, update the same
    element: the result would depend on their order. It fails as well at a load
    of an element that another iteration certainly stores to. With `one-thread`,
    the loop runs in order instead (`serialize`). Stores to elements of which
    that is not certain, because their indices depend on data, remain as they
    are. With `checks`, a kernel gets a `tai.precondition` where its arguments
    decide; in kernels with the attribute `tai.check_updates`, the rest gets a
    `tai.assert` that no two iterations come to one element, and an array of the
    kernel with the number of an iteration for each element.

    Calls hide accesses: run `inline` first. Kernels that are adjoints or
    tangents of others are left alone.
  }];
  let options = [
    Option<"oneThread", "one-thread", "bool", /*default=*/"false",
           "Run loops whose updates depend on the order of iterations in order">,
    Option<"checks", "checks", "bool", /*default=*/"false",
           "Check at run time what is not certain, in kernels that ask for it">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::memref::MemRefDialect",
                           "::mlir::scf::SCFDialect"];
}

def FixSumOrder : Pass<"tai-fix-sum-order", "::mlir::ModuleOp"> {
  let summary = "make the kernels of a deterministic context deterministic";
  let description = [{
    Adds `sums = "deterministic"` to the modes of kernels, and of functions with
    parallel loops, that do not say how their sums are kept, and
    `"compensated+deterministic"` where they say `"compensated"`. Later passes
    read the modes, and not the context's option.

    ```mlir
    tai.kernel @k() {
      tai.return
    }
    // becomes
    tai.kernel @k() attributes {modes = {sums = "deterministic"}} {
      tai.return
    }
    ```
  }];
}

def RelaxAtomics : Pass<"tai-relax-atomics"> {
  let summary = "choose how parallel loops do each of their updates";
  let description = [{
    An atomic update in a parallel loop is
    * a plain read and write (`exclusive`), where each iteration has elements of
      its own;
    * a sum in a register (`reduction <register ...>`), one for each
      partition, where all iterations update one element of a field, or of a
      small array (`memref.alloca`) that the kernel makes for such sums;
    * an addition to a buffer of the partition (`reduction <buffer ...>`),
      where the updated part of the field is small against the number of
      updates; on a GPU to sums beside the field, in f64 or in fixed point;
    * atomic otherwise.

    `#tai.reduction` also has the digits of a sum and the order of its terms.
    Partial sums and buffers are combined in the order of the partitions, which
    makes the result independent of timing. In a deterministic kernel, a loop has
    an `order`, and no float accumulation stays atomic: a loop whose accumulations
    cannot be made independent of timing runs on one thread, or in one warp.

    A remark of the category `tai-reductions` names the form of each update, and
    for one that stays atomic the reason.
  }];
  let options = [
    Option<"onDevice", "on-device", "bool", /*default=*/"false",
           "Choose for a GPU: atomics are fast, threads are many, and no loop "
           "is too small to be parallel">,
  ];
  let dependentDialects = ["::mlir::LLVM::LLVMDialect"];
}

def StoreFirst : Pass<"tai-store-first"> {
  let summary = "start adjoints at zero where the launch says so";
  let description = [{
    Finds the adjoint fields of which the first access of a kernel is an
    addition to each element, made once in a parallel loop over all of the
    field. The addition starts at zero if `tai_rt.starts_at_zero` is true, so a
    tape need not clear the field before the launch. The attribute
    `tai.stores_first` of the kernel lists the fields.

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%c64) {
      %old = tai.atomic add %v, @x_grad[%i] exclusive : f32
    }
    ```

    becomes

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%c64) {
      %known = tai_rt.starts_at_zero 0
      %old = tai.load @x_grad[%i] : f32
      %start = arith.select %known, %zero, %old : f32
      %sum = arith.addf %start, %v : f32
      tai.store %sum, @x_grad[%i] : f32
    }
    ```
  }];
  let options = [
    Option<"minBytes", "min-bytes", "int64_t", /*default=*/"16384",
           "The least size of a field, in bytes">,
  ];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::LLVM::LLVMDialect",
    "::mlir::tai::TaiRTDialect"];
}

def RerollAccumulations : Pass<"tai-reroll-accumulations"> {
  let summary = "reroll unrolled additions into iterations, on a GPU";
  let description = [{
    In a loop with few iterations and a long body that only adds to fields, such
    as the adjoint of a dense layer whose sum is written out, additions that
    differ in constant indices alone become iterations, if these indices take
    even steps. One additional iteration does the rest.

    ```mlir
    tai.parallel_for (%i) = (%c0) to (%c32) {
      %g = "some.value"(%i) : (index) -> f32
      tai.atomic add %g, @w[%i, %c0] exclusive : f32
      // and so on, to
      tai.atomic add %g, @w[%i, %c99] exclusive : f32
    }
    // becomes
    tai.parallel_for (%m, %i) = (%c0, %c0) to (%c100, %c32) {
      %g = "some.value"(%i) : (index) -> f32
      tai.atomic add %g, @w[%i, %m] exclusive : f32
    }
    ```

    Additions to one element that are not atomic stay in one iteration. Terms of
    a long sum that is added atomically are added one by one, so in another
    order. Bodies that read the elements that they add to, store, or use former
    values are not changed.
  }];
  let options = [
    Option<"maxIterations", "max-iterations", "int64_t", /*default=*/"512",
           "Leave loops with more iterations as they are: they have work for "
           "enough threads">,
    Option<"minAdditions", "min-additions", "int64_t", /*default=*/"16",
           "Leave bodies with fewer additions as they are">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::LLVM::LLVMDialect"];
}

def CoarsenThreads : Pass<"tai-coarsen-threads"> {
  let summary = "process several neighbouring elements in each thread, on a GPU";
  let description = [{
    If the accesses of a loop over a large box are adjacent in memory along the
    innermost index, each iteration gets a strip of as many elements as 16
    bytes hold. Inside of the borders, where every question about a single index
    has one answer, their operations are interleaved, so that adjacent elements
    are read and written at once; at borders they follow one another. If rows
    read elements of other rows, the iterations of a block are those of a tile.

    ```mlir
    tai.parallel_for (%i, %j) = (%c0, %c0) to (%c8192, %c8192) {
      "some.work"(%i, %j) : (index, index) -> ()
    }
    // becomes, with i = 8 a + r and j = 4 (32 b + s)
    tai.parallel_for (%a, %b, %r, %s) = (%c0, %c0, %c0, %c0)
                                     to (%c1024, %c64, %c8, %c32) {
      %i, %j = "some.sums"(%a, %b, %r, %s)
          : (index, index, index, index) -> (index, index)
      scf.if %inside {
        "some.work"(%i, %j) : (index, index) -> ()
        // four times, for j, j + 1, j + 2 and j + 3
      } else {
        scf.for %k = %c0 to %left step %c1 {
          "some.work"(%i, %k) : (index, index) -> ()
        }
      }
    }
    ```

    Expects loops over boxes whose accumulations are decided
    (`tai-relax-atomics`). Loops with updates of shared elements, inner loops,
    random numbers or failures stay as they are.
  }];
  let options = [
    Option<"minIterations", "min-iterations", "int64_t",
           /*default=*/"int64_t(1) << 21",
           "Leave loops with fewer iterations as they are: all threads of a GPU "
           "are needed first">,
    Option<"maxOps", "max-ops", "int64_t", /*default=*/"160",
           "Leave larger bodies as they are">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::LLVM::LLVMDialect"];
}

def HoistAllocations : Pass<"tai-hoist-allocations"> {
  let summary = "allocate memory of loop iterations once";
  let description = [{
    Moves a call of `malloc` in the body of an `scf.for` before the loop, and the
    `free` of the same block behind it, if the size does not change. Adjoints
    record what loops carry in such memory; after `convert-tai-to-scf` every
    thread that runs a part of a parallel loop then allocates once.
  }];
}

#endif // TAI_TRANSFORMS_PASSES_TD
