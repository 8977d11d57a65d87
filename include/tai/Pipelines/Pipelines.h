//===- Pipelines.h - The pass pipelines of tai ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The pipelines by name: as functions that add their passes to a pass manager,
// and as the options `--tai-autodiff` and `--tai-to-llvm` of tai-opt.
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
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {

/// Which kernels get an adjoint, and how.
struct AutodiffOptions : PassPipelineOptions<AutodiffOptions> {
  AutodiffOptions() = default;
  // Options are bound to their parser and cannot be moved: copy the values.
  AutodiffOptions(const AutodiffOptions &other) : PassPipelineOptions() {
    kernels = other.kernels;
    flatten = other.flatten.getValue();
    arrayAdjoints = other.arrayAdjoints.getValue();
    historyBytes = other.historyBytes.getValue();
    zeroOverwritten = other.zeroOverwritten.getValue();
    takes = other.takes.getValue();
    storedOutputs = other.storedOutputs.getValue();
    deterministic = other.deterministic.getValue();
    skip = other.skip.getValue();
  }

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
  Option<int64_t> historyBytes{
      *this, "history-bytes",
      llvm::cl::desc("Bytes that a loop may record at once; where it takes "
                     "more, parts of the loop are run once more"),
      llvm::cl::init(kDefaultHistoryBytes)};
  Option<bool> zeroOverwritten{
      *this, "zero-overwritten",
      llvm::cl::desc(
          "Make the form of adjoints that leaves zero in the adjoints "
          "of all that kernels store"),
      llvm::cl::init(false)};
  Option<bool> takes{*this, "takes",
                     llvm::cl::desc("The former name of zero-overwritten"),
                     llvm::cl::init(false)};
  Option<bool> storedOutputs{
      *this, "stored-outputs",
      llvm::cl::desc(
          "Make the forms of adjoints that load what kernels have stored"),
      llvm::cl::init(false)};
  Option<bool> deterministic{
      *this, "deterministic",
      llvm::cl::desc("Let results not depend on what adjoints record"),
      llvm::cl::init(false)};
  Option<SkipSet> skip{*this, "skip",
                       llvm::cl::desc("What to leave out where it is not "
                                      "needed: all, none, or names"),
                       llvm::cl::init(SkipSet::all())};
};

/// What of a module is lowered: kernels, trees and fields, and the functions
/// that hold ops of tai or call, at some depth, a function that does. `entry`,
/// if not empty, is one of them whatever it holds.
llvm::SetVector<Operation *> collectOwn(ModuleOp module, StringRef entry);

/// Adds the passes of `populate` so that they see what `collectOwn` yields and
/// the functions that this calls. All else stays as it is.
void addIsolated(OpPassManager &pm,
                 llvm::function_ref<void(OpPassManager &)> populate);

/// Makes `tai-isolate` known to pass pipelines given as text.
void registerIsolate();

/// Makes the adjoints of kernels and the summaries of all kernels. Anchored on
/// the module.
void buildAutodiffPipeline(OpPassManager &pm, const AutodiffOptions &options);

/// Makes of all kernels those that carry tangents along.
void buildForwardPipeline(OpPassManager &pm, bool arrayTangents);

/// Makes `--tai-autodiff` known to pass pipelines given as text.
void registerAutodiffPipeline();

/// How kernels are lowered, wherever they run.
struct LoweringOptions : virtual ::mlir::detail::PassOptions {
  /// Options are bound to their parser and cannot be moved: copies the values.
  void copyFrom(const LoweringOptions &other) {
    deterministic = other.deterministic.getValue();
    debug = other.debug.getValue();
    boundsCheck = other.boundsCheck.getValue();
    bounds = other.bounds.getValue();
    fastMath = other.fastMath.getValue();
    contract = other.contract.getValue();
    optLevel = other.optLevel.getValue();
    fuseLaunches = other.fuseLaunches.getValue();
    skip = other.skip.getValue();
  }

  Option<bool> deterministic{
      *this, "deterministic",
      llvm::cl::desc("Make results bit-identical from run to run and over "
                     "numbers of threads, or sizes of blocks on a GPU"),
      llvm::cl::init(false)};
  Option<bool> debug{
      *this, "debug",
      llvm::cl::desc("Check tai.assert, and every index (see bounds-check)"),
      llvm::cl::init(false)};
  Option<bool> boundsCheck{*this, "bounds-check",
                           llvm::cl::desc("The same as bounds=check"),
                           llvm::cl::init(false)};
  Option<BoundsMode> bounds{
      *this, "bounds",
      llvm::cl::desc("What happens to indices that depend on data and lie "
                     "outside their field or array; all others are checked "
                     "always. Clamping comes first of all, before "
                     "differentiation: see tai-check-bounds"),
      llvm::cl::init(BoundsMode::Off),
      llvm::cl::values(
          clEnumValN(BoundsMode::Off, "off", "Nothing is defined"),
          clEnumValN(BoundsMode::Clamp, "clamp",
                     "The nearest element is taken"),
          clEnumValN(BoundsMode::Check, "check", "The launch fails"))};
  /// Whether indices are checked as kernels run.
  bool checksIndices() const {
    return boundsCheck || debug || bounds == BoundsMode::Check;
  }
  Option<bool> fastMath{
      *this, "fast-math",
      llvm::cl::desc("Let float operations be reordered and approximated; "
                     "infinities and NaN keep their meaning"),
      llvm::cl::init(false)};
  Option<bool> contract{
      *this, "contract",
      llvm::cl::desc("Let a product and a sum be rounded once"),
      llvm::cl::init(true)};
  Option<unsigned> optLevel{
      *this, "opt-level",
      llvm::cl::desc("Effort, 0 to 3; 0 leaves out what only makes code fast"),
      llvm::cl::init(3)};
  Option<bool> fuseLaunches{
      *this, "fuse-launches",
      llvm::cl::desc("Make one kernel of those that a host function launches "
                     "one after another, where iterations allow"),
      llvm::cl::init(true)};
  Option<SkipSet> skip{*this, "skip",
                       llvm::cl::desc("What to leave out where it is not "
                                      "needed: all, none, or names"),
                       llvm::cl::init(SkipSet::all())};
};

/// How kernels are lowered for the CPU.
struct ToLLVMOptions : PassPipelineOptions<ToLLVMOptions>, LoweringOptions {
  ToLLVMOptions() = default;
  ToLLVMOptions(const ToLLVMOptions &other) { copyFrom(other); }
  ToLLVMOptions &operator=(const ToLLVMOptions &other) {
    copyFrom(other);
    return *this;
  }
};

/// Lowers a module of trees, fields, kernels and host functions to the LLVM
/// dialect. Each kernel and each host function becomes
/// `i32 @name(TaiFrame *)`; see tai/Runtime/Abi.h. Anchored on the module.
/// Functions that have nothing to do with tai stay as they are.
void buildToLLVMPipeline(OpPassManager &pm, const ToLLVMOptions &options);
/// The same for a module that holds nothing else.
void buildToLLVMPasses(OpPassManager &pm, const ToLLVMOptions &options);

/// Makes `--tai-to-llvm` known to pass pipelines given as text.
void registerToLLVMPipeline();

/// How kernels are lowered for a GPU.
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
/// The same for a module that holds nothing else.
void buildToNVVMPasses(OpPassManager &pm, const ToNVVMOptions &options);

/// Makes `--tai-to-nvvm` known to pass pipelines given as text.
void registerToNVVMPipeline();

} // namespace mlir::tai

#endif // TAI_PIPELINES_PIPELINES_H
