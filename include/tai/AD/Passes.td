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
    For a kernel `@k`, makes the kernel `@k_grad` that reads the adjoints of the
    elements that `@k` writes and accumulates the adjoints of those that it
    reads (paper, section 3.1 and appendix B), and names it in the `adjoint`
    attribute of `@k`.

    Parallel loops stay parallel, serial loops run backwards, branches are
    mirrored. The adjoint recomputes the primal values that its partial
    derivatives need and no others; it stores nothing but adjoints. Inactive
    values get no code: those that do not depend on a field with an adjoint, or
    on which no stored value with an adjoint depends. Values that a serial loop
    carries and the gradient needs are recovered in the cheapest way that is
    exact: computed, if they have a closed form in the iteration number (`i +=
    2`); carried backwards, if the step has an exact inverse (integers, swaps, a
    change of sign); or recorded by running the loop forward. Values that no
    rule needs are not recorded: a sum is linear. If the record of a loop
    exceeds `history-bytes`, the loop keeps a checkpoint for each chunk of about
    sqrt(n) iterations, and re-runs each chunk before it is reversed.

    A zero adjoint contributes zero, whatever the partial derivative is, so that
    no infinity or NaN enters a gradient from where the loss does not depend on
    it. See `docs/reference/derivatives.md` for the rules.

    A store kills the old value of the element: its adjoint reads the adjoint of
    the element and zeroes it, if an earlier access of the kernel may have used
    the element; with the option `zero-overwritten`, always. A tape uses this
    variant, which has the attribute `zeroes_adjoint`, if an earlier launch has
    used the elements.

    With `stored-outputs`, an adjoint that would recompute costly values which
    its kernel has stored, such as the `tanh` of a layer, gets a second variant,
    `@k_grad_stored`, which loads them; the attribute `stored_form` of `@k_grad`
    names it. It is valid only while the stored elements are not overwritten,
    which a tape tracks.

    Without the skip `inactive-values`, inactive values get adjoints too, where
    rules exist. Without `unneeded-records`, all values that loops carry are
    recorded.

    Without the option `kernel`, applies to the kernels launched in a `tai.tape`
    or `tai_check.gradient`, or to all kernels of a module that has none of
    these, and to the functions with the unit attribute `tai.differentiate`.
    Float memref arguments of a function are both inputs and outputs; `@f_grad`
    has one more memref for each of them, at the end, in the same order. So has
    the adjoint of a kernel with float memref arguments, unless `array-adjoints`
    is off: then values that a kernel reads from its arrays are constant. The
    adjoint of an array of vectors is an array of their components:
    `memref<?x3xf32>` for `memref<?xvector<3xf32>>`. The adjoint of a store to
    an array reads the adjoint of the element and zeroes it, for the value
    before the store.

    The attribute `gradients` of a kernel, or `tai.gradients` of a function,
    selects the variables of the derivative instead, besides fields: positions
    of arguments and results, numbered consecutively. The adjoint has one more
    memref for each. It adds to the adjoints of numbers and vectors among the
    arguments, and reads those of results: `memref<f32>` for `f32`,
    `memref<3xf32>` for `vector<3xf32>`. Other arguments and results are
    constant. Contributions of the iterations of a parallel loop to a number are
    summed in registers. Two arguments must not be memrefs that overlap.

    ```mlir
    tai.kernel @scaled(%a: f32, %x: memref<?xf32>) -> f32
        attributes {gradients = array<i64: 0, 2>} {
      %i = arith.constant 0 : index
      %e = memref.load %x[%i] : memref<?xf32>
      %y = arith.mulf %a, %e : f32
      tai.return %y : f32
    }
    ```

    has the adjoint, with respect to `%a` and the result,

    ```mlir
    tai.kernel @scaled_grad(%a: f32, %x: memref<?xf32>,
                            %a_adjoint: memref<f32>, %adjoint: memref<f32>)
    ```

    A function with the unit attribute `tai.split` gets two functions instead,
    for hosts that keep their own tape: `@f_augmented` does all that `@f` does
    and returns its results and the tape, which is one array for each value that
    the derivative needs and that memory does not keep; `@f_reverse` takes the
    arguments of `@f_grad` and then the tape, which it frees. In between, arrays
    that `@f` writes may change, and others may not. The attribute then names
    both functions.

    ```mlir
    func.func @f(%x: memref<?xf64>)
        attributes {tai.differentiate, tai.split} {
      return
    }
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
    Option<"storedOutputs", "stored-outputs", "bool", /*default=*/"false",
           "Make the forms of adjoints that load what kernels have stored">,
    Option<"skip", "skip", "::mlir::tai::SkipSet",
           /*default=*/"::mlir::tai::SkipSet::all()",
           "The skips that are on: all, none, or names">,
  ];
}

def PrepareForeign : Pass<"tai-prepare-foreign", "::mlir::ModuleOp"> {
  let summary = "lower copies of functions of other dialects for derivatives";
  let description = [{
    Derivatives are made of `scf`, `memref`, `arith`, `math` and parts of
    `vector`. For each function `@f` with `tai.differentiate` that holds more,
    this pass makes a copy `@f_prepared`, of which `tai-make-adjoint` then makes
    `@f_grad`, and `tai-forward-diff` makes `@f_fwd`. Both remove the copy. `@f`
    stays as it is, as does every function that does not ask for a derivative.

    The copy is lowered by upstream patterns: `tensor` is bufferized, `linalg`,
    `affine` and `scf.forall` become loops, several blocks become structured
    control flow, complex numbers become pairs. Then:

    - calls are inlined, except those of functions that call themselves;
    - prints, and calls that hand numbers to functions defined elsewhere and
      return nothing, are left out;
    - vectors in memory are accessed component by component;
    - views and copies become accesses of the arrays themselves; an access of an
      array that a loop carries or a branch chooses becomes a branch over the
      arrays that it can be;
    - updates that are no sums become a load, the operation and a store, and the
      parallel loops around them, like those that reduce by other than sums, run
      serially.

    ```mlir
    func.func @f(%x: memref<8xf64>, %y: memref<4xf64>)
        attributes {tai.differentiate} {
      %v = memref.subview %x[2] [4] [1]
          : memref<8xf64> to memref<4xf64, strided<[1], offset: 2>>
      linalg.map { math.sin }
          ins(%v : memref<4xf64, strided<[1], offset: 2>>)
          outs(%y : memref<4xf64>)
      return
    }
    ```

    has the copy

    ```mlir
    func.func @f_prepared(%x: memref<8xf64>, %y: memref<4xf64>)
        attributes {tai.differentiate, tai.prepared_for = @f} {
      %c0 = arith.constant 0 : index
      %c1 = arith.constant 1 : index
      %c2 = arith.constant 2 : index
      %c4 = arith.constant 4 : index
      scf.for %i = %c0 to %c4 step %c1 {
        %j = arith.addi %i, %c2 : index
        %0 = memref.load %x[%j] : memref<8xf64>
        %1 = math.sin %0 : f64
        memref.store %1, %y[%i] : memref<4xf64>
      }
      return
    }
    ```

    A function of tensors has a copy of memrefs, with one more for each result.
  }];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the functions to prepare">,
  ];
}

def PromoteElements : Pass<"tai-promote-elements"> {
  let summary = "keep elements that are stored and read again in variables";
  let description = [{
    Where an iteration, or serial code, reads an element that it has stored and
    stores it again, the adjoint would need several versions of the field. If
    all its accesses to the element are at the same indices, this pass loads the
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

    Elements whose values the adjoint can read in the version before or after
    the launch are not changed. Neither are elements that the iteration does not
    certainly store, because it may not own them.
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::tai::TaiDialect"];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions that are differentiated">,
  ];
}

def SplitKernel : Pass<"tai-split-kernel", "::mlir::ModuleOp"> {
  let summary = "split kernels into one for each loop, where gradients need it";
  let description = [{
    An adjoint reads each field in the version before or after the launch. If
    the loops of a kernel together need more versions of one field, such as two
    loops that each scale a field in place, this pass makes a kernel of each
    loop: `@k.0`, `@k.1` and so on, with the arguments of `@k` and the attribute
    `part_of = @k`. A tape records the parts as separate launches in place of
    `@k`, which is not changed. The last part has the result.

    Serial code between two loops is a part. Values that several parts use are
    recomputed in each of them; a value that is read from a field is an error if
    the code in between may overwrite it.

    Kernels whose adjoint can be made, and those for which a split would not
    help, are not changed.
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

def ChooseWriters : Pass<"tai-choose-writers", "::mlir::ModuleOp"> {
  let summary = "decide which of several iterations stores to an element";
  let description = [{
    If iterations of a parallel loop store to the same element, its gradient
    belongs to the one whose value remains. Where the indices do not prove that
    no two do, and a derivative passes through a store, this pass makes a kernel
    in which the last iteration stores, in the order of iterations, and the
    others do not: `@k.0` with the attribute `part_of = @k`, which a tape
    launches in place of `@k`. Parts of `tai-split-kernel` are changed
    themselves.

    The last iteration for each element is found by a copy of the loop that
    keeps only what decides on the stores. If that is not known before the loop,
    because the loop changes what it depends on, the loop runs on one thread. An
    access that meets the store of another iteration fails the launch.

    ```mlir
    tai.parallel_for (%i) in @x {
      %k = tai.load @p[%i] : i32
      %j = arith.index_cast %k : i32 to index
      %0 = tai.load @x[%i] : f32
      tai.store %0, @y[%j] : f32
    }
    ```

    becomes, less the treatment of indices out of range,

    ```mlir
    %owners = memref.alloc() : memref<16xi32>
    tai.parallel_for (%e) = (%c0) to (%c16) {
      memref.store %none, %owners[%e] : memref<16xi32>
    }
    tai.parallel_for (%i) in @x {
      %number = arith.index_cast %i : index to i32
      %k = tai.load @p[%i] : i32
      %j = arith.index_cast %k : i32 to index
      %old = memref.atomic_rmw maxs %number, %owners[%j]
          : (i32, memref<16xi32>) -> i32
    }
    tai.parallel_for (%i) in @x {
      %number = arith.index_cast %i : index to i32
      %k = tai.load @p[%i] : i32
      %j = arith.index_cast %k : i32 to index
      %0 = tai.load @x[%i] : f32
      %owner = memref.load %owners[%j] : memref<16xi32>
      %mine = arith.cmpi eq, %owner, %number : i32
      scf.if %mine {
        tai.store %0, @y[%j] : f32
      }
    }
    ```
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::memref::MemRefDialect",
    "::mlir::scf::SCFDialect", "::mlir::tai::TaiDialect"
  ];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels to differentiate">,
  ];
}

def ExpandGradients : Pass<"tai-expand-gradients", "::mlir::ModuleOp"> {
  let summary = "turn tai.grad into calls of derivatives";
  let description = [{
    For each function that a `tai.grad` names, and each choice of active
    arguments and results, makes one derivative by `tai-make-adjoint`, of a copy
    of the function; a function whose attributes name a derivative by the same
    positions keeps that one. The op becomes a call. Gradients of numbers and
    vectors, and derivatives by results, pass through local memrefs, which
    `mem2reg` and `inline` remove.

    A function with a `tai.grad` is not differentiated itself.

    ```mlir
    func.func @force(%x: f64) -> f64 {
      %seed = arith.constant -1.0 : f64
      %0 = tai.grad @energy(%x, %seed) : (f64, f64) -> f64
      return %0 : f64
    }
    func.func @energy(%x: f64) -> f64 {
      %0 = arith.mulf %x, %x : f64
      return %0 : f64
    }
    ```

    becomes

    ```mlir
    func.func @force(%x: f64) -> f64 {
      %g = memref.alloca() : memref<f64>
      %s = memref.alloca() : memref<f64>
      %seed = arith.constant -1.0 : f64
      %zero = arith.constant 0.0 : f64
      memref.store %zero, %g[] : memref<f64>
      memref.store %seed, %s[] : memref<f64>
      func.call @energy_by_0_of_0_grad(%x, %g, %s) : (f64, memref<f64>, memref<f64>) -> ()
      %0 = memref.load %g[] : memref<f64>
      return %0 : f64
    }
    func.func private @energy_by_0_of_0_grad(f64, memref<f64>, memref<f64>)
    ```
  }];
  let dependentDialects = [
    "::mlir::arith::ArithDialect", "::mlir::func::FuncDialect",
    "::mlir::math::MathDialect", "::mlir::memref::MemRefDialect",
    "::mlir::scf::SCFDialect", "::mlir::vector::VectorDialect",
    "::mlir::tai::TaiDialect"
  ];
}

def ForwardDiff : Pass<"tai-forward-diff", "::mlir::ModuleOp"> {
  let summary = "make forward-mode variants of kernels";
  let description = [{
    Forward mode: for a kernel `@k`, makes the kernel `@k_fwd` that computes the
    same with tangents (directional derivatives): values read from a field with
    a dual are read together with the dual, and values stored there are stored
    together with their tangents. The attribute `tangent` of `@k` names it.

    Every value is available when its tangent is computed, so overwritten
    elements, all kinds of atomics and their results, loops and branches of any
    depth can be differentiated. If several iterations of a `tai.parallel_for`
    may update one element, and its tangent depends on their order (products,
    extrema, values before the update), the loop of `@k_fwd` runs serially. The
    rules are those of `tai-make-adjoint`: one table, read in two directions.

    An adjoint is a kernel like any other. Applied to `@k_grad`, where the
    adjoint fields have duals, the pass makes `@k_grad_fwd`, which accumulates
    products of the Hessian and a vector in the duals of the adjoints.

    Without the option `kernel`, applies to all kernels, and to the functions
    with the unit attribute `tai.differentiate`. `@f_fwd` has one more memref
    for each float memref of a function `@f`, at the end, in the same order. So
    has that of a kernel, unless `array-tangents` is off: then values that a
    kernel reads from its arrays are constant, and storing a tangent there is an
    error.

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

def ExpandAtomics : Pass<"tai-expand-atomics"> {
  let summary = "expand exclusive atomics to load and store";
  let description = [{
    Replaces a `tai.atomic` by a load, the operation and a store if no other
    iteration of a parallel loop writes the element (serial code, or indices
    that differ between iterations), so that it is differentiated like these:
    `mul`, `min` and `max` on fields with an adjoint, and every atomic whose old
    value is used. In a tie of `min` and `max`, the new contribution wins.

    Contended `mul`, `min` and `max` are split into one for each component, and
    loop-invariant code is moved before their loop, as `tai-make-adjoint`
    requires. Sums are not changed.

    Applies to the kernels that `tai-make-adjoint` would differentiate.

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

def CheckAccessRules : Pass<"tai-check-access-rules"> {
  let summary = "reject kernels with races between parallel iterations";
  let description = [{
    The paper (section 3) asks of a kernel that an element which is written more
    than once is accumulated from the second write on, and that no element is
    read before its accumulation is done. Within one iteration, in serial loops
    and from loop to loop the order of accesses is known, and differentiation
    deals with such programs. The remaining rules are about iterations of
    one parallel loop: in a field with an adjoint,

    1. two iterations must not store to the same element;
    2. none may read an element that others still accumulate.

    Reports an error if a kernel certainly breaks a rule; accesses for which
    this cannot be proven are accepted. Changes nothing.

    Looks at the kernels that `tai-make-adjoint` would differentiate: kernels
    that only run forward are not checked.
  }];
  let options = [
    ListOption<"kernels", "kernel", "std::string",
               "Names of the kernels or functions to check">,
  ];
}

#endif // TAI_AD_PASSES_TD
