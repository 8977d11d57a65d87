//===- Checks.td - Passes that check and guard -------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Checks of indices, divisions and accesses, and versions without guards: the
// passes of lib/Transforms/Checks. Passes.td includes it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_CHECKS_TD
#define TAI_TRANSFORMS_CHECKS_TD

include "mlir/Pass/PassBase.td"

def InstrumentAccesses : Pass<"tai-instrument-accesses", "::mlir::ModuleOp"> {
  let summary = "instrument kernels to check the global data access rules";
  let description = [{
    Gives each kernel additional arguments at the end: a shadow array
    (`memref<?xi32>`) for each field of the module that has an adjoint, in the
    order of the module, a log (`memref<?xi64>`), and a number (`i32`), which is
    added to the numbers of its accesses. Each access to such a field then
    stores its number in the shadow array, and logs violations: a write to an
    element that was read, a second store, a read of an element that another
    iteration of the loop writes. See `tai/ABI/AccessLog.h` for the layout of
    both. The results of the kernel do not change.

    The attribute `checked_accesses` lists field, use and location of each
    access.

    Calls hide accesses: run `inline` first. A store of a constant before all
    others counts as clearing, and not as the first of two stores.

    ```mlir
    tai.kernel @k() {
      tai.parallel_for (%i) in @x {
        %0 = tai.load @x[%i] : f32
      }
      tai.return
    }
    ```

    becomes

    ```mlir
    tai.kernel @k(%shadow: memref<?xi32>, %log: memref<?xi64>, %base: i32) {
      tai.parallel_for (%i) in @x {
        %id = arith.addi %base, %c1_i32 : i32
        // Has another iteration written x[i]? Then that goes into the log.
        %before = memref.atomic_rmw assign %id, %shadow[%i] : (i32, memref<?xi32>) -> i32
        %0 = tai.load @x[%i] : f32
      }
      tai.return
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::memref::MemRefDialect",
                           "::mlir::scf::SCFDialect"];
}

def CheckBounds : Pass<"tai-check-bounds"> {
  let summary = "check indices before launches, and mark those that need no check";
  let description = [{
    Analyses the indices of all accesses of a kernel. Indices that depend on the
    arguments of the kernel, constants and loop indices alone are checked before
    the kernel runs: if the affine indices of an access leave the field (or
    array) in an iteration that is certain to run, a `tai.precondition` refuses
    the launch and names the first such element. If all these numbers are
    constants, the condition folds.

    An access is certain to run if all conditions around it are affine in loop
    indices and arguments of the launch, as in `if i > 0`: they are part of the
    precondition. Below any other condition, and in the body of `scf.while`,
    nothing is certain, and no launch is refused for the access.

    `bounds` selects the semantics of all other indices, which depend on data:

    - `off`: nothing. The behaviour of an index that is out of range is
      undefined.
    - `check`: accesses that are known to lie in range get the attribute
      `tai.in_range`, by which `tai-lower-layout` leaves out their check. A
      kernel that needs checks gets `checks_indices`, and no pass changes its
      indices.
    - `clamp`: an index that is not known to lie in range becomes the nearest
      one that does. That is another program, so it is done first of all, before
      differentiation, and by itself: no preconditions are made.

    ```mlir
    tai.kernel @next(%n: index) {
      %c0 = arith.constant 0 : index
      %c1 = arith.constant 1 : index
      tai.parallel_for (%i) = (%c0) to (%n) {
        %0 = arith.addi %i, %c1 : index
        %1 = tai.load @x[%0] : f32   // of shape [8]
        tai.store %1, @y[%i] : f32   // of shape [8]
      }
      tai.return
    }
    ```

    begins, in effect, with

    ```mlir
    %0 = arith.cmpi slt, %n, %c8 : index
    tai.precondition %0, "index {} is out of range ..."(%c8) : index
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::memref::MemRefDialect",
                           "::mlir::tai::TaiDialect"];
  let options = [
    Option<"bounds", "bounds", "::mlir::tai::BoundsMode",
           /*default=*/"::mlir::tai::BoundsMode::Off",
           "What happens to indices that depend on data",
           [{::llvm::cl::values(
             clEnumValN(::mlir::tai::BoundsMode::Off, "off", "Nothing"),
             clEnumValN(::mlir::tai::BoundsMode::Clamp, "clamp",
                        "They become the nearest ones in range"),
             clEnumValN(::mlir::tai::BoundsMode::Check, "check",
                        "They are checked"))}]>,
  ];
}

def GuardDivisions : Pass<"tai-guard-divisions"> {
  let summary = "define integer division by zero";
  let description = [{
    The `arith` dialect leaves the result of a division of integers by zero
    undefined, and that of the smallest integer by -1. In kernels, and in host
    functions that hold ops of this dialect, both get a result: the quotient and
    the remainder by zero are 0, the smallest integer divided by -1 is itself,
    and leaves 0.

    ```mlir
    %q = arith.divsi %a, %n : i32
    // becomes, for %a that is not negative
    %zero = arith.cmpi eq, %n, %c0 : i32
    %d = arith.select %zero, %c1, %n : i32
    %d_q = arith.divsi %a, %d : i32
    %q = arith.select %zero, %c0, %d_q : i32
    ```

    A division that cannot do either, by the ranges of its operands, stays as it
    is; one that always does is an error. With `debug`, a `tai.assert` reports
    it too.
  }];
  let options = [
    Option<"debug", "debug", "bool", /*default=*/"false",
           "Report divisions by zero and those that overflow">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::vector::VectorDialect"];
}

def VersionGuards : Pass<"tai-version-guards"> {
  let summary = "compute adjoints without guards first, and with them if need be";
  let description = [{
    A guard of a derivative is a select: of zero where an adjoint is zero,
    whatever the partial derivative is (`tai.guard`), or where an infinite
    adjoint meets a partial derivative of zero (`tai.guard_infinite`). Guards
    matter where something is not finite, which is rare. This pass computes a
    block without them, if a test says that they would have no effect, and else
    with them.

    If possible, the test comes first, and checks the operands of partial
    derivatives: quotients, logarithms, exponentials and the like are finite,
    divisors are clear of zero, and so are loop-carried and loaded values, as
    far as a tested result does not tell about them. Results
    that tell about several values are tested in their place. Products of finite
    numbers count as finite.

    ```mlir
    %quotient = arith.divf %y, %x : f64
    %product = arith.mulf %g, %quotient : f64
    %guarded = arith.select %zero, %c0, %product {tai.guard} : f64
    %old = tai.atomic add %guarded, @gx[%i] : f64
    // becomes
    %quotient = arith.divf %y, %x : f64
    %test = arith.mulf %quotient, %c0 : f64
    %finite = arith.cmpf ord, %test, %test : f64
    %likely = llvm.intr.expect %finite, %true : i1
    scf.if %likely {
      %product = arith.mulf %g, %quotient : f64
      %old = tai.atomic add %product, @gx[%i] : f64
    } else {
      %product = arith.mulf %g, %quotient : f64
      %guarded = arith.select %zero, %c0, %product {tai.guard} : f64
      %old = tai.atomic add %guarded, @gx[%i] : f64
    }
    ```

    Elsewhere what follows from guards is computed without them, and tested.

    ```mlir
    %zero = arith.cmpf oeq, %g, %c0 : f64
    %product = arith.mulf %g, %partial : f64
    %guarded = arith.select %zero, %c0, %product {tai.guard} : f64
    %d = arith.addf %guarded, %h : f64
    %old = tai.atomic add %d, @gx[%i] : f64
    // becomes
    %product = arith.mulf %g, %partial : f64
    %bare = arith.addf %product, %h : f64
    %test = arith.mulf %bare, %c0 : f64
    %finite = arith.cmpf ord, %test, %test : f64
    scf.if %finite {
      %old = tai.atomic add %bare, @gx[%i] : f64
    } else {
      %zero = arith.cmpf oeq, %g, %c0 : f64
      %guarded = arith.select %zero, %c0, %product {tai.guard} : f64
      %d = arith.addf %guarded, %h : f64
      %old = tai.atomic add %d, @gx[%i] : f64
    }
    ```

    This test is of the results, or of the products that guards select and the
    adjoints behind guards against infinity, whichever are fewer. Both branches
    give the same: a result without guards that is finite has met no product of
    zero and a factor that is not finite, since sums and products pass those on.
    So only sums, products, quotients whose divisor does not depend on a guard,
    and moves of components may stand between a guard and a result; elsewhere
    guards stay. They stay, too, in parallel loops that may be vectorised, where
    a branch costs more than selects, where fewer ops would be saved than are
    tested, and where more than 2,000 ops would be there twice, or 300 or a loop
    behind them.
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::math::MathDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::vector::VectorDialect"];
}

def VerifyInlinable : Pass<"tai-verify-inlinable", "::mlir::ModuleOp"> {
  let summary = "report ops that calls cannot be inlined beside";
  let description = [{
    Changes nothing. MLIR's inliner ends the process at an op that holds a region
    and whose dialect is not loaded: such an op is an error, which pipelines
    report before they inline.
  }];
}

def TestFailure : Pass<"tai-test-failure", "::mlir::ModuleOp"> {
  let summary = "fail, for tests of error handling";
  let description = [{
    Fails without a diagnostic, or leaves an invalid module. Only in pipelines
    of tests.
  }];
  let options = [
    Option<"invalid", "invalid", "bool", /*default=*/"false",
           "Succeed, and leave an op that is not valid">,
  ];
}

#endif // TAI_TRANSFORMS_CHECKS_TD
