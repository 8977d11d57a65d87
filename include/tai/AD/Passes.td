//===- Passes.td - Differentiation passes ------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_PASSES_TD
#define TAI_AD_PASSES_TD

include "mlir/Pass/PassBase.td"

def MakeAdjoint : Pass<"tai-make-adjoint", "::mlir::ModuleOp"> {
  let summary = "make kernels that accumulate the gradients of kernels";
  let description = [{
    For a kernel `@k`, makes the kernel `@k_grad` that reads the adjoints of what
    `@k` writes and accumulates the adjoints of what it reads (paper, section
    3.1 and appendix B), and names it in the `adjoint` attribute of `@k`.

    Parallel loops stay parallel, serial loops run backwards, branches are
    mirrored. The adjoint recomputes the primal values that its partial
    derivatives need and no others; it stores nothing but adjoints. Fields
    without an adjoint, and what cannot reach both a read and a written field
    that have one, get no code. Values that a serial loop carries and the
    gradient needs are had in the cheapest way that is exact: computed, where they
    are a formula of the number of the iteration (`i += 2`); carried backwards,
    where the next value gives the value (integers, swaps, a change of sign); or
    recorded by running the loop forward. What no rule asks for is not recorded:
    a sum is linear. A loop whose record takes more than `history-bytes` keeps
    what every chunk of about sqrt(n) iterations began with, and runs each chunk
    once more before it reverses it.

    A zero adjoint contributes zero, whatever the partial derivative is, so that
    no infinity or NaN enters a gradient from where the loss does not depend on
    it. See `docs/derivatives.md` for the rules.

    A store ends the life of the value before it: its adjoint takes the adjoint
    of the element and leaves zero, where an access before the store may have
    used the element in the same kernel; with the option `zero-overwritten`, always. A tape
    asks for this form, which has the attribute `zeroes_adjoint`, where an earlier
    launch has used the elements.

    With `stored-outputs`, an adjoint that computes at length what its kernel
    has stored, as the `tanh` of a layer, gets a second form, `@k_grad_stored`,
    which loads that; the attribute `stored_form` of `@k_grad` names it. It
    is right only while the elements that the launch has stored hold what it
    stored, as a tape can tell.

    Without the skip `inactive-values`, values that do not depend on what is
    differentiated by get adjoints too, as far as that can be. Without
    `unneeded-records`, all values that loops carry are recorded.

    Without options, takes the kernels launched in a `tai.tape` or
    `tai_check.gradient`, or all kernels of a module that has none of these, and
    the functions with the unit attribute `tai.differentiate`. A function takes
    its float memref arguments as both inputs and outputs; `@f_grad` has one
    more memref for each of them, at the end, in the same order. So has the
    adjoint of a kernel with float memref arguments, unless `array-adjoints` is
    off: then what a kernel reads from its arrays is constant. The adjoint of an
    array of vectors is an array of their components:
    `memref<?x3xf32>` for `memref<?xvector<3xf32>>`. The adjoint of a store to
    an array takes the adjoint of the element and leaves zero: that of the value
    before starts from there.

    The attribute `gradients` of a kernel, or `tai.gradients` of a function,
    says instead by what it is differentiated besides fields: it lists positions
    of arguments and, counted on from these, of results. The adjoint has one more memref for each. It adds
    to the adjoints of numbers and vectors among the arguments, and reads those
    of results: `memref<f32>` for `f32`, `memref<3xf32>` for `vector<3xf32>`.
    What is not listed is constant. What iterations of a parallel loop
    contribute to a number is summed in registers. Two arguments must not be
    memrefs that overlap.

    ```mlir
    tai.kernel @scaled(%a: f32, %x: memref<?xf32>) -> f32
        attributes {gradients = array<i64: 0, 2>} {
      %i = arith.constant 0 : index
      %e = memref.load %x[%i] : memref<?xf32>
      %y = arith.mulf %a, %e : f32
      tai.return %y : f32
    }
    ```

    has the adjoint, by `%a` and the result,

    ```mlir
    tai.kernel @scaled_grad(%a: f32, %x: memref<?xf32>,
                            %a_adjoint: memref<f32>, %adjoint: memref<f32>)
    ```

    Host programs have no arrays to pass: they cannot launch such a kernel under
    a tape.

    ```mlir
    tai.kernel @square() {
      tai.parallel_for (%i) in @x {
        %0 = tai.load @x[%i] : f32
        %1 = arith.mulf %0, %0 : f32
        tai.store %1, @y[%i] : f32
      }
      tai.return
    }
    ```

    becomes, after `canonicalize` and `cse`,

    ```mlir
    tai.kernel @square_grad() {
      tai.parallel_for (%i) in @x {
        %0 = tai.load @x[%i] : f32
        %1 = tai.load @y_grad[%i] : f32
        %2 = arith.mulf %1, %0 : f32
        %3 = arith.addf %2, %2 : f32
        %4 = tai.atomic add %3, @x_grad[%i] exclusive : f32
      }
      tai.return
    }
    ```
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::func::FuncDialect",
    "::mlir::math::MathDialect",
    "::mlir::memref::MemRefDialect", "::mlir::scf::SCFDialect",
    "::mlir::vector::VectorDialect", "::mlir::tai::TaiDialect"
  ];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions to differentiate">,
    Option<"arrayAdjoints", "array-adjoints", "bool", /*default=*/"true",
           "Give the adjoint of a kernel the adjoints of its float memrefs">,
    Option<"historyBytes", "history-bytes", "int64_t",
           /*default=*/"::mlir::tai::kDefaultHistoryBytes",
           "Bytes that a loop may record at once; where it takes more, parts of "
           "the loop are run once more">,
    Option<"zeroOverwritten", "zero-overwritten", "bool", /*default=*/"false",
           "Leave zero in the adjoints of all that a kernel stores">,
    Option<"takes", "takes", "bool", /*default=*/"false",
           "The former name of zero-overwritten">,
    Option<"storedOutputs", "stored-outputs", "bool", /*default=*/"false",
           "Make the forms of adjoints that load what kernels have stored">,
    Option<"deterministic", "deterministic", "bool", /*default=*/"false",
           "Let how loops are cut not depend on what they record">,
    Option<"skip", "skip", "::mlir::tai::SkipSet",
           /*default=*/"::mlir::tai::SkipSet::all()",
           "What to leave out where it is not needed: all, none, or names">,
  ];
}

def PromoteElements : Pass<"tai-promote-elements", "::mlir::ModuleOp"> {
  let summary = "keep elements that are stored and read again in variables";
  let description = [{
    Where an iteration, or serial code, reads an element that it has stored and
    stores it again, the adjoint would need several states of the field. If all
    its accesses to the element are at the same indices, this pass loads the
    element once into a variable, works on that, and stores it once. Run
    `tai-eliminate-locals` afterwards to have values in place of variables.

    ```mlir
    tai.store %a, @x[%i] : f32
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
    ```

    becomes, after these, `canonicalize` and `cse`,

    ```mlir
    %1 = arith.mulf %a, %a : f32
    tai.store %1, @x[%i] : f32
    ```

    What the adjoint can read as it was before the launch, or as it is after it,
    stays as it is. So does an element that the iteration might not own: one that
    it does not store for certain.
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::tai::TaiDialect"];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions that are differentiated">,
  ];
}

def SplitKernel : Pass<"tai-split-kernel", "::mlir::ModuleOp"> {
  let summary = "make kernels of the loops of kernels, where gradients need it";
  let description = [{
    An adjoint reads each field as it was before the launch, or as it is
    afterwards. Where the loops of a kernel need several states of one field
    between them, as two loops that each scale a field by itself do, this pass
    makes a kernel of each: `@k.0`, `@k.1` and so on, with the arguments of `@k`
    and the attribute `part_of = @k`. What happens between loops is then what
    happens between launches, and a tape records the parts in place of `@k`,
    which stays as it is. The last part has the result.

    Serial code between two loops is a part. Values that several parts use are
    computed in each of them; a value that is read from a field is refused if
    what happens in between may overwrite it.

    Kernels whose adjoint can be made, and those for which a split would not
    help, are left alone.
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::math::MathDialect",
    "::mlir::memref::MemRefDialect", "::mlir::scf::SCFDialect",
    "::mlir::vector::VectorDialect", "::mlir::tai::TaiDialect"
  ];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels to differentiate">,
  ];
}

def ForwardDiff : Pass<"tai-forward-diff", "::mlir::ModuleOp"> {
  let summary = "make kernels that carry tangents along";
  let description = [{
    For a kernel `@k`, makes the kernel `@k_fwd` that does what `@k` does and
    carries tangents (directional derivatives) along: what it reads from a field
    with a dual, it reads together with the dual; what it stores there, it
    stores together with the tangent (forward mode). The attribute `tangent`
    of `@k` names it.

    Every value is at hand when its tangent is computed: overwritten elements,
    all kinds of atomics and what they yield, loops and branches of any depth
    are differentiated as they run. Where iterations of a `tai.parallel_for` may
    meet in an element, and its tangent depends on their order (products,
    extremes, values before the update), the loop of `@k_fwd` runs in order. The
    rules are those of `tai-make-adjoint`: one table, read in two directions.

    An adjoint is a kernel like any other. Applied to `@k_grad`, where the
    adjoint fields have duals, the pass makes `@k_grad_fwd`, which accumulates
    products of the Hessian and a vector in the duals of the adjoints.

    Without options, takes all kernels, and the functions with the unit
    attribute `tai.differentiate`. `@f_fwd` has one more memref for each float
    memref of a function `@f`, at the end, in the same order. So has that of a
    kernel, unless `array-tangents` is off: then what a kernel reads from its
    arrays is constant, and a tangent that is stored there is an error.

    ```mlir
    tai.kernel @square() {
      tai.parallel_for (%i) in @x {
        %0 = tai.load @x[%i] : f32
        %1 = arith.mulf %0, %0 : f32
        tai.store %1, @y[%i] : f32
      }
      tai.return
    }
    ```

    becomes, after `canonicalize` and `cse`,

    ```mlir
    tai.kernel @square_fwd() {
      tai.parallel_for (%i) in @x {
        %0 = tai.load @x[%i] : f32
        %1 = tai.load @x_dual[%i] : f32
        %2 = arith.mulf %0, %0 : f32
        %3 = arith.mulf %1, %0 : f32
        %4 = arith.addf %3, %3 : f32
        tai.store %2, @y[%i] : f32
        tai.store %4, @y_dual[%i] : f32
      }
      tai.return
    }
    ```
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::func::FuncDialect",
    "::mlir::math::MathDialect",
    "::mlir::memref::MemRefDialect", "::mlir::scf::SCFDialect",
    "::mlir::vector::VectorDialect", "::mlir::tai::TaiDialect"
  ];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions to differentiate">,
    Option<"arrayTangents", "array-tangents", "bool", /*default=*/"true",
           "Give the copy of a kernel the tangents of its float memrefs">,
  ];
}

def ExpandAtomics : Pass<"tai-expand-atomics", "::mlir::ModuleOp"> {
  let summary = "write atomics that one iteration alone reaches as load and store";
  let description = [{
    Replaces a `tai.atomic` by a load, the operation and a store where no other
    iteration of a parallel loop writes the element (serial code, or indices that
    tell the iterations apart), so that it is differentiated as these are: `mul`,
    `min` and `max` on fields with an adjoint, and every atomic whose old value
    is used, which is what was loaded. In a tie of `min` and `max`, the new
    contribution wins.

    `mul`, `min` and `max` that iterations do contend for are split into one for
    each component, and what does not change in their loop is moved before it, as
    `tai-make-adjoint` wants them. Sums stay as they are.

    Looks at the kernels that `tai-make-adjoint` would differentiate.

    ```mlir
    tai.parallel_for (%i) in @x {
      %old = tai.atomic mul %a, @x[%i] : f32
    }
    ```

    becomes

    ```mlir
    tai.parallel_for (%i) in @x {
      %old = tai.load @x[%i] : f32
      %new = arith.mulf %old, %a : f32
      tai.store %new, @x[%i] : f32
    }
    ```
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::vector::VectorDialect"];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions to look at">,
  ];
}

def CheckAccessRules : Pass<"tai-check-access-rules", "::mlir::ModuleOp"> {
  let summary = "refuse kernels whose parallel iterations meet in an element";
  let description = [{
    The paper (section 3) asks of a kernel that an element which is written more
    than once is accumulated from the second write on, and that no element is
    read before its accumulation is done. Within one iteration, in serial loops
    and from loop to loop the order of accesses is known, and differentiation
    deals with such programs. What remains is between the iterations of one
    parallel loop: in a field with an adjoint,

    1. two iterations must not store to the same element;
    2. none may read an element that others still accumulate.

    Reports an error where a kernel breaks a rule for certain. What cannot be
    proven is left alone. Changes nothing.

    Looks at the kernels that `tai-make-adjoint` would differentiate: a kernel
    that only runs forward may do as it likes.
  }];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions to check">,
  ];
}

#endif // TAI_AD_PASSES_TD
