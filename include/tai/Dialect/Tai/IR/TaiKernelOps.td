//===- TaiKernelOps.td - Kernels, loops and locals ---------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIKERNELOPS_TD
#define TAI_DIALECT_TAI_IR_TAIKERNELOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

let opDocGroup = KernelOpGroup in {

def Tai_KernelOp : Tai_Op<"kernel", [
    FunctionOpInterface, IsolatedFromAbove, AffineScope,
    AutomaticAllocationScope]> {
  let summary = "a program that runs over fields";
  let description = [{
    A kernel is launched from the host, by `tai.launch` or through the runtime.
    Its body is serial code with `tai.parallel_for` at the top level. Arguments
    are scalars, small vectors, and `memref`s (arrays owned by the caller). A
    kernel may return one value.

    1. (kernel_c1) The body is one block that ends with `tai.return`.
    2. (kernel_c2) An argument is a scalar, a vector, or a `memref` of them with the
       identity layout.
    3. (kernel_c3) There is at most one result, a scalar or a vector.
    4. (kernel_c4) `modes` holds nothing but `precision`, `"f64"` or `"f32"`; `sums`,
       `"compensated"` or `"deterministic"`; `math`, `"fast"`, `"strict"` or
       `"accurate"`; `"default"` of each; and `ftz`, true or false.

    `adjoint` names the kernel that accumulates its gradient; it has the same
    arguments. `summary` lists the accesses of the kernel (see `#tai.access`).
    `tangent` names its forward-mode variant.

    `modes` sets precision, summation and approximations (docs/guides/precision.md);
    its adjoint and its forward-mode variant have the same.

    Attributes for differentiation, set by users: `gradients`, the positions of
    arguments and results (numbered consecutively) with respect to which the
    kernel is differentiated besides fields; `conventions`, the subgradients at
    kinks (docs/reference/derivatives.md).

    Attributes set by passes. On an adjoint: `zeroes_adjoint`, it zeroes the
    adjoints of all elements that the kernel stores; `reads_before`, the fields
    that it reads in the version before the launch; `reexecutes`, it re-executes
    stores of the kernel, so that the fields of `reads_before` must be restored
    again after it; `stored_form`, the name of its variant that loads stored
    outputs of the kernel, valid while they are not overwritten;
    `keeps_activity`, it skips additions to inactive cells instead of activating
    them; `guarded`, some of its selects are guards (`tai.guard`), whose marks
    are needed to differentiate it again. On any kernel: `part_of`, under a tape
    it is launched in place of the named kernel, with the other parts;
    `checks_indices`, some accesses are checked at run time, so that
    optimisations must not restructure it; `checked_accesses`, (field, use,
    location) of each logged access.

    The parser of this op also accepts former names of attributes:
    `tai.gradients`, `tai.conventions`, `tai.modes`, `tai.tangent`, `tai.takes`
    (now `zeroes_adjoint`), `tai.before` (`reads_before`), `tai.reruns`
    (`reexecutes`), `tai.stored_form`, `tai.part_of`, `tai.keeps_activity`. The
    printer prints the present names.

    Example:

    ```mlir
    tai.tree @scene : !tai.root<dense<[i: 16], {x: f32, y: f32}>>
    tai.field @x = @scene["x"] : f32, rank 1
    tai.field @y = @scene["y"] : f32, rank 1
    tai.kernel @square(%a: f32) {
      tai.parallel_for (%i) in @x {
        %0 = tai.load @x[%i] : f32
        %1 = arith.mulf %0, %0 : f32
        %2 = arith.mulf %1, %a : f32
        tai.store %2, @y[%i] : f32
      }
      tai.return
    }
    ```
  }];
  let arguments = (ins
    SymbolNameAttr:$sym_name,
    TypeAttrOf<FunctionType>:$function_type,
    OptionalAttr<DictArrayAttr>:$arg_attrs,
    OptionalAttr<DictArrayAttr>:$res_attrs,
    OptionalAttr<StrAttr>:$sym_visibility,
    OptionalAttr<FlatSymbolRefAttr>:$adjoint,
    OptionalAttr<ArrayAttr>:$summary,
    OptionalAttr<FlatSymbolRefAttr>:$tangent,
    OptionalAttr<DenseI64ArrayAttr>:$gradients,
    OptionalAttr<DictionaryAttr>:$conventions,
    OptionalAttr<DictionaryAttr>:$modes,
    UnitAttr:$zeroes_adjoint,
    OptionalAttr<TypedArrayAttrBase<FlatSymbolRefAttr, "fields">>:$reads_before,
    UnitAttr:$reexecutes,
    OptionalAttr<FlatSymbolRefAttr>:$stored_form,
    OptionalAttr<FlatSymbolRefAttr>:$part_of,
    UnitAttr:$keeps_activity,
    UnitAttr:$guarded,
    UnitAttr:$checks_indices,
    OptionalAttr<ArrayAttr>:$checked_accesses
  );
  let regions = (region SizedRegion<1>:$body);
  let skipDefaultBuilders = 1;
  let builders = [OpBuilder<(ins "::llvm::StringRef":$name,
                                 "::mlir::FunctionType":$type)>];
  let hasCustomAssemblyFormat = 1;
  let hasVerifier = 1;
  let extraClassDeclaration = [{
    ::llvm::ArrayRef<::mlir::Type> getArgumentTypes() {
      return getFunctionType().getInputs();
    }
    ::llvm::ArrayRef<::mlir::Type> getResultTypes() {
      return getFunctionType().getResults();
    }
    ::mlir::Region *getCallableRegion() { return &getBody(); }
  }];
}

def Tai_ReturnOp : Tai_Op<"return", [
    Pure, HasParent<"KernelOp">, ReturnLike, Terminator]> {
  let summary = "end a kernel";
  let description = [{
    Ends a kernel and returns its value, if it has one, to the host.

    1. (return_c1) The operands have the types of the results of the kernel.

    Example:

    ```mlir
    tai.kernel @seven() -> i32 {
      %c = arith.constant 7 : i32
      tai.return %c : i32
    }
    ```
  }];
  let arguments = (ins Variadic<Tai_Value>:$operands);
  let assemblyFormat = "attr-dict ($operands^ `:` type($operands))?";
  let hasVerifier = 1;
}

def Tai_YieldOp : Tai_Op<"yield", [
    Pure, ReturnLike, Terminator]> {
  let summary = "end a region of the dialect";
  let description = [{
    Ends the body of a parallel loop, of a tape, or of another op that records
    launches, and yields nothing. Implicit in the textual form.

    1. (yield_c1) It stands in one of these.
  }];
  let assemblyFormat = "attr-dict";
  let hasVerifier = 1;
}

def Tai_ParallelForOp : Tai_Op<"parallel_for", [
    AttrSizedOperandSegments, AutomaticAllocationScope,
    RecursiveMemoryEffects, SingleBlockImplicitTerminator<"YieldOp">,
    DeclareOpInterfaceMethods<LoopLikeOpInterface,
                              ["getLoopInductionVars", "getLoopLowerBounds",
                               "getLoopUpperBounds", "getLoopSteps"]>,
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "run iterations in parallel";
  let description = [{
    Runs its body once for each point of a box of indices, or for each active
    element of a field, in any order and possibly at the same time. Iterations
    communicate through `tai.atomic` alone.

    The box form has inclusive lower bounds and exclusive upper bounds for each
    dimension; an empty range runs nothing. The field form visits the elements
    of the named field whose cell is active at the start of the loop.

    With `level n`, the field form visits the active cells of the level `n`
    levels up (1 is the innermost), with the indices of the first element in
    each.

    `serialize` runs the iterations in ascending order on one thread.
    `block_dim` is the number of threads in a block on a GPU: a multiple of 32
    or a power of two, 1024 at most. It is ignored on the CPU.

    1. (parallel_for_c1) The body has one argument for each dimension, of type
       `index`.
    2. (parallel_for_c2) `block_dim` is positive.
    3. (parallel_for_c3) No parallel loop stands in another one.
    4. (parallel_for_c4) The box form has at least one dimension, and as many
       lower and upper bounds; no level.
    5. (parallel_for_c5) The field form names a `tai.field`, has no bounds, and an index for
       each dimension of the field.
    6. (parallel_for_c6) There is a level `n` above the field.

    Attributes set by passes, without effect on the semantics: `reach`, an
    iteration over active cells can be skipped unless a cell within this
    distance has a non-zero adjoint (-1: any cell); `outer_dims`, partitions
    divide only this many of the first dimensions; `fixed_cost`, the nanoseconds
    of an iteration used for partitioning, which also fixes the order of its
    sums independently of the lowering; `in_warp`, one warp of a GPU runs the
    loop, with its additions in a fixed order; `order`, no result may depend on
    timing or on the number of threads (`fixed`), nor on the target (`common`).

    `in_order`, which `tai-keep-order` sets, promises less: one thread runs the
    loop, and its iterations read and write memory as if they ran one after
    another, in ascending order. Atomic updates of one kind whose old values are
    not used may still be reassociated.

    Example:

    ```mlir
    tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %m) {
      tai.store %zero, @y[%i, %j] : f32
    }
    tai.parallel_for (%i, %j) in @y {
      tai.store %zero, @y[%i, %j] : f32
    }
    ```
  }];
  let arguments = (ins
    Variadic<Index>:$lowerBounds,
    Variadic<Index>:$upperBounds,
    OptionalAttr<FlatSymbolRefAttr>:$field,
    OptionalAttr<ConfinedAttr<I64Attr, [IntPositive]>>:$level,
    UnitAttr:$serialize,
    OptionalAttr<I64Attr>:$block_dim,
    OptionalAttr<I64Attr>:$reach,
    OptionalAttr<I64Attr>:$outer_dims,
    OptionalAttr<F64Attr>:$fixed_cost,
    UnitAttr:$in_warp,
    UnitAttr:$in_order,
    OptionalAttr<Tai_LoopOrderAttr>:$order
  );
  let regions = (region SizedRegion<1>:$body);
  let hasCustomAssemblyFormat = 1;
  let hasVerifier = 1;
  let hasCanonicalizeMethod = 1;
  let skipDefaultBuilders = 1;
  let builders = [
    OpBuilder<(ins "::mlir::ValueRange":$lowerBounds,
                   "::mlir::ValueRange":$upperBounds)>,
    OpBuilder<(ins "::mlir::FlatSymbolRefAttr":$field, "unsigned":$rank)>
  ];
  let extraClassDeclaration = [{
    /// True for the form that visits the elements of a field.
    bool isStructFor() { return getField().has_value(); }
    /// Copies from a loop that this one replaces: `block_dim`, attributes set
    /// by passes, and discardable attributes.
    void copyNotesFrom(ParallelForOp other);
    ::mlir::Block::BlockArgListType getInductionVars() {
      return getBody().getArguments();
    }
  }];
}

} // opDocGroup = KernelOpGroup

//===----------------------------------------------------------------------===//
// Locals
//===----------------------------------------------------------------------===//

let opDocGroup = LocalOpGroup in {

def Tai_AllocaOp : Tai_Op<"alloca", []> {
  let summary = "create a mutable local variable";
  let description = [{
    Creates a variable that holds zero until the first `tai.local_store`. It
    belongs to one iteration of the parallel loop around it.

    Example:

    ```mlir
    %a = tai.alloca : !tai.local<f32>
    tai.local_store %x, %a : f32
    %y = tai.local_load %a : f32
    ```
  }];
  let results = (outs Res<Tai_AnyLocal, "", [MemAlloc]>:$local);
  let assemblyFormat = "attr-dict `:` qualified(type($local))";
  let hasVerifier = 1;
  let hasCanonicalizeMethod = 1;
}

def Tai_LocalLoadOp : Tai_Op<"local_load", [
    TypesMatchWith<"the local holds the result type", "value", "local",
                   "::mlir::tai::LocalType::get($_self)">,
    TypesMatchWith<"the result is what the local holds", "local", "value",
                   "::llvm::cast<::mlir::tai::LocalType>($_self)"
                   ".getElementType()">]> {
  let summary = "read a local variable";
  let description = [{
    Yields the value last stored to the variable, or zero; see `tai.alloca`.
  }];
  let arguments = (ins Arg<Tai_AnyLocal, "", [MemRead]>:$local);
  let results = (outs Tai_Value:$value);
  let assemblyFormat = "$local attr-dict `:` type($value)";
}

def Tai_LocalStoreOp : Tai_Op<"local_store", [
    TypesMatchWith<"the local holds the value's type", "value", "local",
                   "::mlir::tai::LocalType::get($_self)">]> {
  let summary = "write a local variable";
  let description = [{
    Replaces the value of the variable; see `tai.alloca`.
  }];
  let arguments = (ins Tai_Value:$value,
                       Arg<Tai_AnyLocal, "", [MemWrite]>:$local);
  let assemblyFormat = "$value `,` $local attr-dict `:` type($value)";
}

} // opDocGroup = LocalOpGroup

//===----------------------------------------------------------------------===//
// Random numbers, checks, output
//===----------------------------------------------------------------------===//

let opDocGroup = MessageOpGroup in {

def Tai_RandomOp : Tai_Op<"random", [MemoryEffects<[MemRead, MemWrite]>]> {
  let summary = "draw a random number";
  let description = [{
    A float in [0, 1), or an integer with all bits random. The generator is
    Philox 4x32-10, keyed by the seed of the context and counted by launch,
    iteration and `stream`, so that a number depends on neither the number of
    threads nor the order of iterations. `stream` distinguishes the draws of one
    kernel; repeated draws of one op in one iteration advance a counter. The
    derivative is zero.

    Example:

    ```mlir
    %u = tai.random stream 0 : f32
    ```
  }];
  let arguments = (ins DefaultValuedAttr<I64Attr, "0">:$stream);
  let results = (outs AnyTypeOf<[AnySignlessInteger, AnyFloat]>:$value);
  let assemblyFormat = "`stream` $stream attr-dict `:` type($value)";
}

def Tai_AssertOp : Tai_Op<"assert", [
    MemoryEffects<[MemWrite]>, Tai_OnlyReports]> {
  let summary = "report an error if a condition is false";
  let description = [{
    If the condition is false the launch fails with the message, in which each
    `{}` is replaced by the next argument. The iteration continues; the first
    failure of a launch is reported. Removed unless the context checks
    assertions (debug mode) or the op has a `failure` kind (`TaiFailure` of
    tai/ABI/Abi.h), as checks created by passes do. `shapes` holds the number of
    components of each argument after `tai-scalarize`.

    Example:

    ```mlir
    tai.assert %ok, "mass {} of particle {}"(%m, %i) : f32, index
    ```
  }];
  let arguments = (ins I1:$condition, StrAttr:$message,
                       Variadic<AnyType>:$args,
                       OptionalAttr<I32Attr>:$failure,
                       OptionalAttr<DenseI32ArrayAttr>:$shapes);
  let builders = [OpBuilder<(ins "::mlir::Value":$condition,
    "::mlir::StringAttr":$message, "::mlir::ValueRange":$args,
    CArg<"::mlir::IntegerAttr", "{}">:$failure), [{
      build($_builder, $_state, condition, message, args, failure,
            ::mlir::DenseI32ArrayAttr());
    }]>];
  let assemblyFormat = [{
    $condition `,` $message (`(` $args^ `)` `:` type($args))? attr-dict
  }];
  let hasCanonicalizeMethod = 1;
}

def Tai_PreconditionOp : Tai_Op<"precondition", [
    MemoryEffects<[MemWrite]>, HasParent<"KernelOp">]> {
  let summary = "refuse a launch if a condition is false";
  let description = [{
    If the condition is false the launch fails with the message, in which each
    `{}` is replaced by the next argument, and nothing of the kernel runs,
    wherever in it the op is. The condition and the arguments must depend on the
    arguments of the kernel and the extents of its arrays alone: on a GPU, the
    host computes them. Never removed, also in release mode. Created by
    `tai-check-bounds`.

    Example:

    ```mlir
    tai.kernel @step(%t: index) {
      %c8 = arith.constant 8 : index
      %ok = arith.cmpi ult, %t, %c8 : index
      tai.precondition %ok, "step {} of {}"(%t, %c8) : index, index
      tai.return
    }
    ```
  }];
  let arguments = (ins I1:$condition, StrAttr:$message,
                       Variadic<AnyType>:$args);
  let assemblyFormat = [{
    $condition `,` $message (`(` $args^ `)` `:` type($args))? attr-dict
  }];
  let hasCanonicalizeMethod = 1;
}

def Tai_PrintOp : Tai_Op<"print", [
    MemoryEffects<[MemWrite]>, Tai_OnlyReports]> {
  let summary = "print values from a kernel";
  let description = [{
    Prints the format, in which each `{}` is replaced by the next argument, and
    a newline, unless `no_newline` is set. `{:…}` gives Python's format
    specification of a number, as in `{:8.3f}`: fill, alignment, sign, `#`, `0`,
    width, precision and one of `bdoxXeEfFgG%`; for vectors, that of each
    component. A final `u` prints an integer as unsigned. Lines of parallel
    iterations are printed in any order, each as a whole. For `shapes` see
    `tai.assert`.

    Example:

    ```mlir
    tai.print "x = {}"(%x) : f32
    ```
  }];
  let arguments = (ins StrAttr:$format, Variadic<AnyType>:$args,
                       OptionalAttr<DenseI32ArrayAttr>:$shapes,
                       UnitAttr:$no_newline);
  let assemblyFormat = "$format (`(` $args^ `)` `:` type($args))? attr-dict";
}

} // opDocGroup = MessageOpGroup

#endif // TAI_DIALECT_TAI_IR_TAIKERNELOPS_TD
