//===- KernelCode.h - The compiler side of a kernel -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The module that a kernel is compiled from, and its code: the function, its
// adjoints, the forward-mode variant, the variant that checks accesses. Each is
// compiled when the runtime first needs it, or ahead of that in the background.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_KERNELS_KERNELCODE_H
#define TAI_EXECUTIONENGINE_KERNELS_KERNELCODE_H

#include "mlir/IR/OwningOpRef.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Compile/Background.h"
#include "tai/ExecutionEngine/Compile/Compiler.h"
#include "tai/ExecutionEngine/Modes/ContextModes.h"
#include "tai/ExecutionEngine/Modules/Declarations.h"
#include "tai/ExecutionEngine/Reports/CompileReports.h"
#include "tai/ExecutionEngine/Reports/WarningLog.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "llvm/ADT/StringMap.h"

namespace mlir::tai {
struct ToBeRecorded;

/// The set of names of kernels that may still be launched. Tapes keep some
/// kernels longer than the handles of these kernels live. Thread-safe.
class CodeNames {
public:
  void add(StringRef name) {
    std::lock_guard<std::mutex> lock(mutex);
    ++counts[name];
    ++total;
  }
  void drop(StringRef name) {
    std::lock_guard<std::mutex> lock(mutex);
    auto found = counts.find(name);
    if (--found->second == 0)
      counts.erase(found);
    --total;
  }
  bool has(StringRef name) const {
    std::lock_guard<std::mutex> lock(mutex);
    return counts.contains(name);
  }
  int64_t size() const { return total.load(std::memory_order_relaxed); }

private:
  mutable std::mutex mutex;
  llvm::StringMap<unsigned> counts;
  std::atomic<int64_t> total{0};
};

/// The parts of a session that its kernels use. They outlive all kernels.
struct KernelServices {
  Compiler &compiler;
  Background &background;
  CodeNames &names;
  runtime::Runtime &rt;
  Declarations &declarations;
  FailureLog &failures;
  CompileReports &reports;
  WarningLog &warnings;
};

/// The compiled code of one kernel. Lives as long as the runtime may launch the
/// kernel; because of tapes, this can be longer than the life of the kernel's
/// handle.
class KernelCode final : public runtime::KernelProvider,
                         public std::enable_shared_from_this<KernelCode> {
public:
  /// The module of a kernel and its declarations. Filled in by makeKernel.
  struct Source {
    std::string name;
    /// The source location of the kernel as text, or empty.
    std::string place;
    CompileOptions options;
    OwningOpRef<ModuleOp> module;
    int64_t argSlots = 0;
    int64_t resultSlots = 0;
    /// The trees that the kernel's module declares.
    std::vector<runtime::TreePtr> trees;
    /// The fields that the kernel's module declares, by name. After such a
    /// field is destroyed, another field may reuse its name.
    llvm::StringMap<runtime::FieldPtr> fields;
  };

  KernelCode(const KernelServices &services, Source source);
  ~KernelCode() override;

  const std::string &getName() const { return source.name; }
  const CompileOptions &getOptions() const { return source.options; }
  /// The trees that the kernel's module declares, in the order of its ops.
  const std::vector<runtime::TreePtr> &getTrees() const { return source.trees; }
  ModuleOp getModule() const { return source.module.get(); }
  /// The field that the kernel's module means by `name`, or null.
  runtime::FieldPtr findField(StringRef name) const {
    return source.fields.lookup(name);
  }
  KernelOp getKernel() const;
  /// All functions linked for the kernel so far.
  ArrayRef<Compiler::Function> getFunctions() const { return functions; }
  /// The request by which the compiler makes a variant of the kernel.
  CompileRequest getRequest(CompileRequest::Goal goal,
                            bool forward = false) const;
  /// The variant of the adjoint that a tape launches for the kernel, unless
  /// launches that precede it on the tape need another variant.
  CompileRequest::Goal getTapeGoal(const runtime::Kernel &kernel) const;

  //===--------------------------------------------------------------------===//
  // KernelProvider
  //===--------------------------------------------------------------------===//

  runtime::Status compile(runtime::Kernel &kernel,
                          TaiKernelFn &function) override;
  runtime::Status makeAdjoint(runtime::Kernel &kernel,
                              runtime::AdjointVariant variant,
                              runtime::KernelPtr &adjoint) override;
  bool makesZeroingAdjoints() const override { return true; }
  runtime::Status planAdjoint(runtime::Kernel &kernel,
                              runtime::AdjointAccesses &plan) override;
  runtime::KernelFlows findFlows(const runtime::Kernel &kernel) override;
  runtime::Status makeChecked(runtime::CheckedKernel &checked) override;
  runtime::Status makeTangent(runtime::KernelPtr &tangent) override;
  std::string explainRefusal(const std::string &reason) override;

  /// Makes the forward-mode variant of the kernel or of one of its adjoints.
  runtime::Status makeTangentOf(CompileRequest::Goal goal,
                                runtime::KernelPtr &tangent);
  /// Describes why a device rejected the kernel's compiled code. Such a
  /// rejection is an internal error, so a reproducer is written.
  std::string explainRefusalOf(CompileRequest::Goal goal, bool forward,
                               const std::string &reason);

private:
  /// Runs a step of the compilation of a kernel on a thread of its own, so that
  /// the calling thread passes safepoints. If the calling thread is interrupted
  /// at a safepoint, the step still completes, for the cache, and runAside
  /// returns none with a failure.
  template <typename Result>
  std::optional<Result>
  runAside(std::function<std::optional<Result>(Failure &)> step,
           Failure &failure);
  /// Registers a compiled function, to be freed with the kernel.
  std::optional<Compiler::Function>
  keepFunction(std::optional<Compiler::Function> function);
  std::optional<Compiler::Function>
  compileAs(CompileRequest::Goal goal, Failure &failure, bool forward = false);
  void choosePlannedForm(const runtime::Kernel &kernel);
  /// The variant of the adjoint that a tape most likely launches.
  CompileRequest::Goal getPlannedGoal() const {
    return CompileRequest::getAdjointGoal(planZeroes, planLoadsStored);
  }
  /// Differentiates the kernel unless this has been done. The caller holds
  /// `prepareMutex`.
  LogicalResult prepareAdjoint(Failure &failure, bool claims);
  std::optional<Compiler::Function> compilePlannedAdjoint(Failure &failure);
  bool canReadStored(CompileRequest::Goal goal, const ToBeRecorded &told);
  /// Adds the skip counters of a function that was compiled, or loaded from the
  /// cache, to the statistics.
  void count(const Compiler::Function &function, bool isAdjoint);
  std::vector<runtime::TreePtr> findTrees(ArrayRef<std::string> names) const;
  runtime::KernelInfo getFormInfo(const Compiler::Function &compiled,
                                  CompileRequest::Goal goal, bool forward,
                                  StringRef suffix);

  KernelServices services;
  Source source;
  /// Guards the list of functions that were linked for the kernel.
  std::mutex functionsMutex;
  std::vector<Compiler::Function> functions;
  /// Guards the adjoint, in the variant that a tape most likely launches,
  /// between the two steps of its compilation (the second step moves the
  /// adjoint out), and its serialized ToBeRecorded. Held during compilation,
  /// which has safepoints.
  std::timed_mutex prepareMutex;
  using PrepareLock = runtime::safepoint::Guard<std::timed_mutex>;
  bool planZeroes = false, planLoadsStored = true;
  std::optional<Compiler::Prepared> prepared;
  std::optional<std::string> toBeRecorded;
  /// The background job that compiles the adjoint before it is needed, and the
  /// result of the job.
  Background::JobPtr ahead;
  std::optional<Compiler::Function> aheadResult;
  Failure aheadFailure;
};

/// The kernel object of the runtime, and the kernel's compiled code.
struct MadeKernel {
  std::shared_ptr<KernelCode> code;
  runtime::KernelPtr kernel;
};

/// Makes a runtime kernel from a module that contains a kernel of the given
/// name: adds to the module the declarations that the kernel uses, and verifies
/// it. Failures go to the log. `modes`, the modes of the context, have been
/// added to the kernel before.
FailureOr<MadeKernel> makeKernel(const KernelServices &services,
                                 OwningOpRef<ModuleOp> module, StringRef name,
                                 const CompileOptions &options,
                                 const ContextModes &modes = {});

/// True if a reverse sweep may launch the adjoint of the kernel: the kernel
/// reads a field with an adjoint, and changes a field with an adjoint.
bool carriesGradients(const runtime::Kernel &kernel);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_KERNELS_KERNELCODE_H
