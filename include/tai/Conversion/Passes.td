//===- Passes.td - Lowering passes -------------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_PASSES_TD
#define TAI_CONVERSION_PASSES_TD

include "mlir/Pass/PassBase.td"

def LowerStructFor : Pass<"tai-lower-struct-for"> {
  let summary = "turn loops over a field into loops over its index space";
  let description = [{
    A field whose levels are all dense has a fixed index space: the loop over it
    becomes a box, whose dimensions are ordered so that the innermost one walks
    through memory with the smallest stride.

    ```mlir
    tai.parallel_for (%i, %j) in @x {
      tai.store %v, @x[%i, %j] : f32
    }
    // becomes, for a layout dense<[i: 4, j: 8], {x: f32}>
    tai.parallel_for (%i, %j) = (%c0, %c0) to (%c4, %c8) {
      tai.store %v, @x[%i, %j] : f32
    }
    ```

    With the skip `activity-tests`, a write to the cell of the iteration does
    not test whether it is active. Without `repeated-lookups`, every element of
    a sparse field reads the list of cells again.
  }];
  let options = [
    Option<"skip", "skip", "::mlir::tai::SkipSet",
           /*default=*/"::mlir::tai::SkipSet::all()",
           "What to leave out where it is not needed: all, none, or names">,
  ];
  // Alias scopes identify the storage of fields.
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::LLVM::LLVMDialect",
                           "::mlir::tai::TaiRTDialect"];
}

def NarrowIndices : Pass<"tai-narrow-indices", "::mlir::ModuleOp"> {
  let summary = "find modules whose indices fit 32 bits";
  let description = [{
    Device code computes addresses in 32 bits where that cannot overflow. This
    pass puts `tai.index_bits = 32` on a module where that is proven: every
    value of type `index` in its kernels, computed in 64 bits, lies in the range
    of i32; so do the counters of loops, the numbers of iterations of parallel
    loops and all terms of addresses in one of its trees. Ranges are inferred
    from types, constants, extents of fields and arithmetic.

    Where that is not proven, indices have 64 bits: a kernel takes an array,
    whose extents are known at its launch, a bound is an i64, or a product of
    bounds may be large.

    ```mlir
    // %n from an i32: 32 bits
    tai.parallel_for (%i) = (%c0) to (%n) {
    }
    // %m from an i64: 64 bits
    tai.parallel_for (%j) = (%c0) to (%m) {
    }
    // The product of two numbers of 32 bits: 64 bits
    tai.parallel_for (%k, %l) = (%c0, %c0) to (%n, %n) {
    }
    ```

    Expects loops over boxes and field accesses, as they are before
    `tai-lower-layout`; indices of accesses are taken to be in range after it.
  }];
  let options = [
    Option<"remarks", "remarks", "bool", /*default=*/"false",
           "Say at the first thing that may not fit why indices have 64 bits">,
  ];
}

def LowerLayout : Pass<"tai-lower-layout"> {
  let summary = "turn accesses to fields into loads and stores of memory";
  let description = [{
    Replaces accesses to fields by address arithmetic on the base of their tree
    (`tai_rt.tree_base`) and accesses of the LLVM dialect, and accesses to
    `memref` arguments likewise. Fields do not overlap: each access has alias
    scopes, one for each place of a tree.

    With `bounds-check`, an access outside its field or array is reported by
    `tai.assert` and skipped; a skipped load yields zero. Accesses with the
    attribute `tai.in_range` need no check (see `tai-check-bounds`). A float
    that cannot be converted to an integer, such as NaN, is reported too if it
    is used as an index.

    The pipelines run this pass on the module, not on each kernel: loops of
    functions that may be inlined into one another need access groups of their
    own, and groups are taken from a list that the next module uses again,
    because a context never frees one.

    With `on-device`, accesses carry the strides and extents of their indices
    (`tai.digits`), from which `convert-tai-to-gpu` finds the accesses of a
    device function.
  }];
  let options = [
    Option<"boundsCheck", "bounds-check", "bool", /*default=*/"false",
           "Check indices, and report and skip what lies outside">,
    Option<"onDevice", "on-device", "bool", /*default=*/"false",
           "Note on each access how its address is made up, and add small "
           "constants of indices last: a GPU adds them for free">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::memref::MemRefDialect",
                           "::mlir::LLVM::LLVMDialect",
                           "::mlir::tai::TaiRTDialect"];
}

def ConvertTaiToSCF : Pass<"convert-tai-to-scf", "::mlir::ModuleOp"> {
  let summary = "turn kernels into functions, and parallel loops into calls";
  let description = [{
    A kernel becomes `i32 @name(ptr frame)`; a parallel loop becomes a function
    that runs one partition of its iterations, passed to the runtime with a
    closure of its captured values; a loop too small to be worth a fork stays
    inline. Host functions become `i32 @name(ptr frame)` too, and their launches
    calls of the runtime. See tai/ABI/Abi.h. Control flow stays in `scf`.
  }];
  let options = [
    Option<"debug", "debug", "bool", /*default=*/"false",
           "Keep tai.assert">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::math::MathDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::LLVM::LLVMDialect",
                           "::mlir::tai::TaiRTDialect"];
}

def SkipZeroBlocks : Pass<"tai-skip-zero-blocks", "::mlir::ModuleOp"> {
  let summary = "skip blocks of reverse iterations whose adjoints are zero";
  let description = [{
    Divides the innermost parallel loop of an adjoint into blocks, if its only
    effects are to add to adjoints products of adjoints that it loads. A block
    runs if one of these is not zero. Other factors of the products must be
    finite; so a block also runs if a number that they are computed from is
    infinite, NaN or huge. Loops with less arithmetic than `min-nanoseconds` an
    iteration stay as they are.

    ```mlir
    scf.for %i = %lo to %hi step %c1 : i64 {
      %p = llvm.getelementptr %gy[%i] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %g = llvm.load %p {tai.adjoint_access} : !llvm.ptr -> f32
      %q = llvm.getelementptr %gx[%i] : (!llvm.ptr, i64) -> !llvm.ptr, f32
      %old = llvm.load %q {tai.adjoint_access} : !llvm.ptr -> f32
      %term = arith.mulf %g, %slope : f32
      %new = arith.addf %old, %term : f32
      llvm.store %new, %q {tai.adjoint_access} : f32, !llvm.ptr
    }
    // becomes
    scf.for %b = %lo to %hi step %c128 : i64 {
      %next = arith.addi %b, %c128 : i64
      %end = arith.minsi %next, %hi : i64
      %any = scf.for %k = %b to %end step %c1 iter_args(%found = %false) -> (i1) : i64 {
        %r = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
        %tested = llvm.load %r : !llvm.ptr -> f32
        %bits = arith.bitcast %tested : f32 to i32
        %is = arith.cmpi ne, %bits, %c0 : i32
        %or = arith.ori %found, %is : i1
        scf.yield %or : i1
      }
      scf.if %any {
        scf.for %i = %b to %end step %c1 : i64 {
          %p = llvm.getelementptr %gy[%i] : (!llvm.ptr, i64) -> !llvm.ptr, f32
          %g = llvm.load %p {tai.adjoint_access} : !llvm.ptr -> f32
          %q = llvm.getelementptr %gx[%i] : (!llvm.ptr, i64) -> !llvm.ptr, f32
          %old = llvm.load %q {tai.adjoint_access} : !llvm.ptr -> f32
          %term = arith.mulf %g, %slope : f32
          %new = arith.addf %old, %term : f32
          llvm.store %new, %q {tai.adjoint_access} : f32, !llvm.ptr
        }
      }
    }
    ```
  }];
  let options = [
    Option<"minNanoseconds", "min-nanoseconds", "double", /*default=*/"8",
           "Least estimated cost of the arithmetic of an iteration">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::LLVM::LLVMDialect"];
}

def ConvertTaiToGPU : Pass<"convert-tai-to-gpu", "::mlir::ModuleOp"> {
  let summary = "split kernels into device functions and host code that launches them";
  let description = [{
    Each parallel loop becomes a function of the `gpu.module @kernels`, a
    grid-stride loop over the iterations, whose parameters are the captured
    values. Serial code that accesses memory becomes such a function too, run by
    one thread; its results go through slots of device memory. The remaining
    code is `i32 @name(ptr frame)`, which launches the functions
    (`gpu.launch_func`).

    ```mlir
    tai.kernel @k(%s: f32) {
      %c0 = arith.constant 0 : index
      %c4096 = arith.constant 4096 : index
      tai.parallel_for (%i) = (%c0) to (%c4096) {
        "some.work"(%i, %s) : (index, f32) -> ()
      }
      tai.return
    }
    // becomes
    llvm.func @k_host(%frame: !llvm.ptr, %s: f32, %tree: !llvm.ptr) -> i32 {
      %c1 = arith.constant 1 : index
      %c16 = arith.constant 16 : index
      %c256 = arith.constant 256 : index
      gpu.launch_func @kernels::@k_0 blocks in (%c16, %c1, %c1)
          threads in (%c256, %c1, %c1) args(%s : f32, %tree : !llvm.ptr)
      %status = arith.constant 0 : i32
      llvm.return %status : i32
    }
    gpu.module @kernels {
      llvm.func @k_0(%s: f32, %tree: !llvm.ptr) attributes {gpu.kernel} {
        %thread, %threads, %c4096 = "some.numbers"() : () -> (index, index, index)
        scf.for %i = %thread to %c4096 step %threads {
          "some.work"(%i, %s) : (index, f32) -> ()
        }
        llvm.return
      }
    }
    ```

    The number of blocks follows from the number of iterations; 0 stands for a
    number that only the device knows. Functions are correct for any number of
    threads: the runtime may choose others. `tai.index_bits`, by
    `tai-narrow-indices`, moves from the module to the `gpu.module`.
  }];
  let options = [
    Option<"debug", "debug", "bool", /*default=*/"false",
           "Keep tai.assert">,
  ];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::gpu::GPUDialect",
                           "::mlir::math::MathDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::LLVM::LLVMDialect",
                           "::mlir::tai::TaiRTDialect"];
}

def LowerLaunches : Pass<"tai-lower-launches", "::mlir::ModuleOp"> {
  let summary = "turn launches of device functions into calls of the runtime";
  let description = [{
    `gpu.launch_func` in functions of the host becomes a call of
    `tai_rt_device_launch`, with the number of the function in its `gpu.module`
    and its parameters in slots; see tai/ABI/Abi.h.
  }];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::LLVM::LLVMDialect"];
}

def ConvertToNVVM : Pass<"tai-convert-to-nvvm", "::mlir::ModuleOp"> {
  let summary = "convert device functions to the NVVM and LLVM dialects";
  let description = [{
    Converts functions of `gpu.module`s for the NVPTX backend, in one conversion
    with upstream's patterns: mathematical functions become calls of libdevice,
    thread numbers reads of special registers. Indices have 64 bits, or the
    number in `tai.index_bits` of the `gpu.module`.

    With `emulated`, converts for the CPU: thread numbers become calls
    (`tai_dev_thread_id`, …), mathematical functions calls of libm.
  }];
  let options = [
    Option<"fastMath", "fast-math", "bool", /*default=*/"false",
           "Let float operations be reordered and approximated">,
    Option<"contract", "contract", "bool", /*default=*/"true",
           "Let a product and a sum be rounded once">,
    Option<"emulated", "emulated", "bool", /*default=*/"false",
           "Make functions for the CPU">,
  ];
  let dependentDialects = ["::mlir::LLVM::LLVMDialect",
                           "::mlir::NVVM::NVVMDialect",
                           "::mlir::cf::ControlFlowDialect"];
}

def ConvertToLLVM : Pass<"tai-convert-to-llvm", "::mlir::ModuleOp"> {
  let summary = "convert scf, arith, math and cf to the LLVM dialect at once";
  let description = [{
    The last step. One conversion over upstream's patterns, because each pass
    over a module costs compile time. Sets the float options on all arithmetic
    first. Ops of other dialects that implement upstream's
    `ConvertToLLVMPatternInterface`, such as `complex` and `index`, are
    converted by the patterns of their dialect.

    The exponential, the logarithm and the hyperbolic tangent of f32 become
    arithmetic that vectorises: with `fast-math` polynomials in f32 (largest
    error 1, 1 and 4 units in the last place), else, with `contract`, in f64
    (0.501, where those of libm have 0.5, 1 and 2). Without both they are calls
    of libm.

    Elementary functions that may be contracted are those for which loops may
    call vector forms: with `contract` and in deterministic kernels, but for kernels
    with `math = "strict"`. Bits of vector forms do not depend on where a loop
    ends.
  }];
  let options = [
    Option<"fastMath", "fast-math", "bool", /*default=*/"false",
           "Let float operations be reordered and approximated">,
    Option<"contract", "contract", "bool", /*default=*/"true",
           "Let a product and a sum be rounded once">,
  ];
  let dependentDialects = ["::mlir::LLVM::LLVMDialect",
                           "::mlir::cf::ControlFlowDialect",
                           "::mlir::func::FuncDialect"];
}

def VectorizeIterations : Pass<"tai-vectorize-iterations"> {
  let summary = "make vectors of the iterations of independent loops";
  let description = [{
    An innermost loop that says of its accesses that they do not depend on those
    of other iterations becomes one over vectors of eight f32, and one over the
    iterations that are left. It may have loads and stores of consecutive f32,
    loads of what all iterations read, arithmetic, and branches that all
    iterations take alike. Other loops are not changed.

    For shadow execution, which leaves branches behind that LLVM does not
    vectorise. Each operation is done once for each iteration as before.

    ```mlir
    func.func @k(%x: !llvm.ptr, %n: index) {
      %c0 = arith.constant 0 : index
      %c1 = arith.constant 1 : index
      scf.for %i = %c0 to %n step %c1 {
        %at = arith.index_cast %i : index to i64
        %p = llvm.getelementptr %x[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f32
        // A load of vector<8xf32> afterwards.
        %v = llvm.load %p {
          access_groups = [#llvm.access_group<id = distinct[0]<>>]
        } : !llvm.ptr -> f32
        %w = arith.mulf %v, %v : f32
        llvm.store %w, %p {
          access_groups = [#llvm.access_group<id = distinct[0]<>>]
        } : f32, !llvm.ptr
      } {
        llvm.loop_annotation = #llvm.loop_annotation<
          parallelAccesses = #llvm.access_group<id = distinct[0]<>>>
      }
      return
    }
    ```
  }];
  let dependentDialects = ["::mlir::LLVM::LLVMDialect",
                           "::mlir::arith::ArithDialect"];
}

def ShadowExecution : Pass<"tai-shadow-execution", "::mlir::ModuleOp"> {
  let summary = "compute each float again in higher precision, and compare";
  let description = [{
    Gives each float in the functions of a module in the LLVM dialect a shadow:
    the result of the same operations on the shadows of their operands, in f64
    for f32 and in `f64-shadow` for f64. The floats are not changed, and control
    flow and selects follow them.

    The shadow of a float in memory is in a table of the process, with a copy of
    the float; if that differs from the current float, code without shadows
    wrote it, and the shadow is the float.

    Operations that can lose digits are compared: if less than half of the bits
    of a result are correct while those of its operands are, the location is
    reported to the runtime. Comparisons and conversions to integers are
    reported if the shadows give another result. Operations that only round
    (products, quotients, square roots) are compared where their result is
    stored or leaves the block.

    Functions whose first parameter is not a pointer (the frame) are not
    changed. Fails if the module already has shadows.

    ```mlir
    llvm.func @k(%frame: !llvm.ptr, %a: f32, %b: f32) -> f32 {
      %0 = llvm.fsub %a, %b : f32
      llvm.return %0 : f32
    }
    // becomes
    llvm.func @k(%frame: !llvm.ptr, %a: f32, %b: f32) -> f32 {
      %sa = llvm.fpext %a : f32 to f64
      %sb = llvm.fpext %b : f32 to f64
      %0 = llvm.fsub %a, %b : f32
      %s0 = llvm.fsub %sa, %sb : f64
      // Is it far from %s0, though %a and %b are not far from %sa and %sb?
      %back = llvm.fpext %0 : f32 to f64
      %fires = llvm.fcmp "une" %back, %s0 : f64
      llvm.cond_br %fires, ^report, ^rest
    ^report:
      // Counts it in the frame of the function. If it may be the worst, with
      // the operands, the result and how far their shadows lie above them:
      llvm.call @tai_rt_shadow_site(%frame) : (!llvm.ptr) -> ()
      llvm.br ^rest
    ^rest:
      llvm.return %0 : f32
    }
    ```
  }];
  let options = [
    Option<"f64Shadow", "f64-shadow", "std::string", /*default=*/"\"f80\"",
           "The type of the shadows of f64: f80, or f128">,
  ];
  let dependentDialects = ["::mlir::LLVM::LLVMDialect"];
}

def CheckLowerable : Pass<"tai-check-lowerable", "::mlir::ModuleOp"> {
  let summary = "check that a program holds only ops that can be lowered";
  let description = [{
    Fails at each operation of a dialect that no later pass lowers, such as one
    of a plugin. The error is at the original op with its name, not at an op
    that the last pass finds.
  }];
}

def VerifyLLVM : Pass<"tai-verify-llvm", "::mlir::ModuleOp"> {
  let summary = "check that only the LLVM dialect is left";
  let description = [{
    Fails at an operation of another dialect in the functions that belong to tai,
    with its name. Then takes off the marks by which passes know these functions.
  }];
  let options = [
    Option<"all", "all", "bool", /*default=*/"false",
           "Check all functions of the module">,
  ];
}

#endif // TAI_CONVERSION_PASSES_TD
