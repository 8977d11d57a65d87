//===- Pipelines.h - The pass pipelines of tai ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The pipelines as functions that add their passes to a pass manager, and as
// options of tai-opt: `--tai-autodiff`, `--tai-to-llvm`, `--tai-to-nvvm`.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PIPELINES_PIPELINES_H
#define TAI_PIPELINES_PIPELINES_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Pass/PassOptions.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Support/SkipOption.h"

namespace mlir::tai {

/// Options of differentiation: the kernels that get an adjoint, and the form of
/// the adjoints. (Options of a context are in Options.def.)
struct AutodiffOptions : PassPipelineOptions<AutodiffOptions> {
  AutodiffOptions() = default;
  // Copies the values of the options only, because options are bound to their
  // parser and cannot be moved.
  AutodiffOptions(const AutodiffOptions &other) : PassPipelineOptions() {
    kernels = other.kernels;
    flatten = other.flatten.getValue();
    arrayAdjoints = other.arrayAdjoints.getValue();
    zeroOverwritten = other.zeroOverwritten.getValue();
    storedOutputs = other.storedOutputs.getValue();
#define TAI_AUTODIFF_OPTION(type, member, from, argument, initial, about)      \
  member = other.member.getValue();
#include "tai/Support/Options.def"
  }

#define TAI_AUTODIFF_OPTION(type, member, from, argument, initial, about)      \
  Option<type> member{*this, argument, llvm::cl::desc(about),                  \
                      llvm::cl::init(initial)};
#include "tai/Support/Options.def"
  ListOption<std::string> kernels{
      *this, "kernel",
      llvm::cl::desc("Names of the kernels to differentiate; by default those "
                     "launched under a tape, or all if there is no tape")};
  Option<bool> flatten{
      *this, "flatten",
      llvm::cl::desc("Turn cheap and safe branches into selects first"),
      llvm::cl::init(true)};
  Option<bool> arrayAdjoints{
      *this, "array-adjoints",
      llvm::cl::desc("Give the adjoint of a kernel the adjoints of its float "
                     "memrefs; without, they are constant"),
      llvm::cl::init(true)};
  Option<bool> zeroOverwritten{
      *this, "zero-overwritten",
      llvm::cl::desc(
          "Make the form of adjoints that leaves zero in the adjoints "
          "of all that kernels store"),
      llvm::cl::init(false)};
  Option<bool> storedOutputs{
      *this, "stored-outputs",
      llvm::cl::desc(
          "Make the forms of adjoints that load what kernels have stored"),
      llvm::cl::init(false)};
};

/// How passes that are restricted to some functions of a module treat the
/// callers of these functions.
enum class IsolateMode {
  /// The functions become functions that only the runtime can call, so their
  /// callers are lowered too.
  Lower,
  /// The given functions are kept, and derivatives are added as new functions,
  /// so callers of the given functions need no change.
  Keep,
};

/// Adds the passes of `populate`, restricted to code that belongs to tai and
/// the functions that this code calls. The rest of the module stays as it is.
/// Functions called `names` count as code of tai.
void addIsolated(OpPassManager &pm,
                 llvm::function_ref<void(OpPassManager &)> populate,
                 IsolateMode mode = IsolateMode::Lower,
                 ArrayRef<std::string> names = {});

/// Registers the pass `tai-isolate` by name.
void registerIsolate();

/// Makes the adjoints of kernels and the summaries of all kernels. Anchored on
/// the module; functions of the module that do not belong to tai stay as they
/// are.
void buildAutodiffPipeline(OpPassManager &pm, const AutodiffOptions &options);

/// Adds the passes of buildAutodiffPipeline for a module that holds code of tai
/// only.
void buildAutodiffPasses(OpPassManager &pm, const AutodiffOptions &options);

/// Adds passes that replace all kernels by their forward-mode variants.
void buildForwardPipeline(OpPassManager &pm, bool arrayTangents);

/// Adds the passes of buildForwardPipeline for a module that also holds
/// functions which do not belong to tai.
void buildForwardFunctionsPipeline(OpPassManager &pm);

/// Registers `tai-autodiff` and `tai-autodiff-forward` by name.
void registerAutodiffPipeline();

/// The words that an option of an enumeration type accepts, with their values.
template <typename T> struct OptionWords {
  template <typename Opt> void apply(Opt &) const {}
};
template <> struct OptionWords<BoundsMode> {
  template <typename Opt> void apply(Opt &option) const {
    llvm::cl::values(
        clEnumValN(BoundsMode::Off, "off", "Nothing is defined"),
        clEnumValN(BoundsMode::Clamp, "clamp", "The nearest element is taken"),
        clEnumValN(BoundsMode::Check, "check", "The launch fails"))
        .apply(option);
  }
};

/// Options of the lowering of kernels, for all targets. (Options of a context
/// are in Options.def.)
struct LoweringOptions : virtual ::mlir::detail::PassOptions {
  /// Copies the values of the options, because options are bound to their
  /// parser and cannot be moved.
  void copyFrom(const LoweringOptions &other) {
#define TAI_LOWERING_OPTION(type, member, from, argument, initial, about)      \
  member = other.member.getValue();
#include "tai/Support/Options.def"
    boundsCheck = other.boundsCheck.getValue();
    fuseLaunches = other.fuseLaunches.getValue();
  }

#define TAI_LOWERING_OPTION(type, member, from, argument, initial, about)      \
  Option<type> member{*this, argument, llvm::cl::desc(about),                  \
                      llvm::cl::init(initial), OptionWords<type>()};
#include "tai/Support/Options.def"
  Option<bool> boundsCheck{*this, "bounds-check",
                           llvm::cl::desc("The same as bounds=check"),
                           llvm::cl::init(false)};
  Option<bool> fuseLaunches{
      *this, "fuse-launches",
      llvm::cl::desc("Make one kernel of those that a host function launches "
                     "one after another, where iterations allow"),
      llvm::cl::init(true)};

  /// True if indices of accesses are checked at run time.
  bool checksIndices() const {
    return boundsCheck || debug || bounds == BoundsMode::Check;
  }
};

/// Options of the lowering of kernels for the CPU.
struct ToLLVMOptions : PassPipelineOptions<ToLLVMOptions>, LoweringOptions {
  ToLLVMOptions() = default;
  ToLLVMOptions(const ToLLVMOptions &other) { *this = other; }
  ToLLVMOptions &operator=(const ToLLVMOptions &other) {
    copyFrom(other);
    shadow = other.shadow.getValue();
    return *this;
  }

  Option<bool> shadow{
      *this, "shadow",
      llvm::cl::desc("Carry shadows of floats along: see tai-shadow-execution"),
      llvm::cl::init(false)};
};

/// Lowers a module of trees, fields, kernels and host functions to the LLVM
/// dialect. Each kernel and each host function becomes `i32 @name(TaiFrame *)`;
/// see tai/ABI/Abi.h. Anchored on the module. Functions that have nothing to do
/// with tai stay as they are.
void buildToLLVMPipeline(OpPassManager &pm, const ToLLVMOptions &options);
/// Adds the passes of buildToLLVMPipeline for a module that holds code of tai
/// only.
void buildToLLVMPasses(OpPassManager &pm, const ToLLVMOptions &options);

/// Registers `tai-to-llvm` by name.
void registerToLLVMPipeline();

/// Options of the lowering of kernels for a GPU.
struct ToNVVMOptions : PassPipelineOptions<ToNVVMOptions>, LoweringOptions {
  ToNVVMOptions() = default;
  ToNVVMOptions(const ToNVVMOptions &other) {
    copyFrom(other);
    emulated = other.emulated.getValue();
  }

  Option<bool> emulated{
      *this, "emulated",
      llvm::cl::desc("Make device functions that the CPU can run, for tests "
                     "without a GPU"),
      llvm::cl::init(false)};
};

/// Lowers a module of trees, fields, kernels and host functions for a GPU: to
/// device functions in the `gpu.module @kernels`, in the NVVM dialect, and to
/// `i32 @name(TaiFrame *)` in the LLVM dialect, which launch them through the
/// runtime. Anchored on the module. Functions that have nothing to do with tai
/// stay as they are.
void buildToNVVMPipeline(OpPassManager &pm, const ToNVVMOptions &options);
/// Adds the passes of buildToNVVMPipeline for a module that holds code of tai
/// only.
void buildToNVVMPasses(OpPassManager &pm, const ToNVVMOptions &options);

/// Registers `tai-to-nvvm` by name.
void registerToNVVMPipeline();

} // namespace mlir::tai

#endif // TAI_PIPELINES_PIPELINES_H
