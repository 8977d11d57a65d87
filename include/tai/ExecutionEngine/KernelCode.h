//===- KernelCode.h - The compiler side of a kernel -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What a kernel is compiled from, and the code made so far: its function, its
// adjoints, what carries tangents along, what checks its accesses. Each is made
// when the runtime first asks, or a little ahead in the background.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_KERNELCODE_H
#define TAI_EXECUTIONENGINE_KERNELCODE_H

#include "mlir/IR/OwningOpRef.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Background.h"
#include "tai/ExecutionEngine/CompileReports.h"
#include "tai/ExecutionEngine/Compiler.h"
#include "tai/ExecutionEngine/ContextModes.h"
#include "tai/ExecutionEngine/Declarations.h"
#include "tai/ExecutionEngine/WarningLog.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "llvm/ADT/StringMap.h"

namespace mlir::tai {
struct ToBeRecorded;

/// The names of the kernels that may be launched. Tapes keep some of them
/// longer than their handles do. Any thread.
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

/// The parts of a session that kernels are made with. They outlive all kernels.
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

/// It lives as long as the runtime may launch the kernel, which a tape can make
/// longer than its handle.
class KernelCode final : public runtime::KernelProvider,
                         public std::enable_shared_from_this<KernelCode> {
public:
  /// What makeKernel fills in.
  struct Source {
    std::string name;
    /// Where it stands in the source, or empty.
    std::string place;
    CompileOptions options;
    OwningOpRef<ModuleOp> module;
    int64_t argSlots = 0;
    int64_t resultSlots = 0;
    /// The trees that the module declares.
    std::vector<runtime::TreePtr> trees;
    /// The fields that it declares, by name. Others may take their names once
    /// they are gone.
    llvm::StringMap<runtime::FieldPtr> fields;
  };

  KernelCode(const KernelServices &services, Source source);
  ~KernelCode() override;

  const std::string &getName() const { return source.name; }
  const CompileOptions &getOptions() const { return source.options; }
  /// The trees that the module declares, in the order of its ops.
  const std::vector<runtime::TreePtr> &getTrees() const { return source.trees; }
  ModuleOp getModule() const { return source.module.get(); }
  KernelOp getKernel() const;
  /// All that was linked so far.
  ArrayRef<Compiler::Function> getFunctions() const { return functions; }
  /// What to compile for a form of the kernel.
  CompileRequest getRequest(CompileRequest::Goal goal,
                            bool forward = false) const;

  //===--------------------------------------------------------------------===//
  // What the runtime asks for
  //===--------------------------------------------------------------------===//

  runtime::Status compile(runtime::Kernel &kernel,
                          TaiKernelFn &function) override;
  runtime::Status makeAdjoint(runtime::Kernel &kernel,
                              runtime::AdjointVariant variant,
                              runtime::KernelPtr &adjoint) override;
  bool makesZeroingAdjoints() const override { return true; }
  runtime::Status planAdjoint(runtime::Kernel &kernel,
                              runtime::AdjointPlan &plan) override;
  runtime::KernelFlows findFlows(const runtime::Kernel &kernel) override;
  runtime::Status makeChecked(runtime::CheckedKernel &checked) override;
  runtime::Status makeTangent(runtime::KernelPtr &tangent) override;
  std::string explainRefusal(const std::string &reason) override;

  /// What carries tangents along with the kernel or a form of its adjoint.
  runtime::Status makeTangentOf(CompileRequest::Goal goal,
                                runtime::KernelPtr &tangent);
  /// That a device does not take our code is a bug of ours.
  std::string explainRefusalOf(CompileRequest::Goal goal, bool forward,
                               const std::string &reason);

private:
  /// Runs a step of the compilation of a kernel on a thread of its own, so that
  /// this one passes safepoints. Where it is interrupted there, the step goes
  /// on to its end, for the cache, and the answer is a failure.
  template <typename Result>
  std::optional<Result>
  runAside(std::function<std::optional<Result>(Failure &)> step,
           Failure &failure);
  /// Notes a function that was compiled, to be freed with the kernel.
  std::optional<Compiler::Function>
  keepFunction(std::optional<Compiler::Function> function);
  std::optional<Compiler::Function>
  compileAs(CompileRequest::Goal goal, Failure &failure, bool forward = false);
  void choosePlannedForm(const runtime::Kernel &kernel);
  /// Most launches store what no other one stores.
  CompileRequest::Goal getPlannedGoal() const {
    return CompileRequest::getAdjointGoal(planZeroes, planLoadsStored);
  }
  /// Differentiates the kernel unless that has been done. The caller holds
  /// `prepareMutex`.
  LogicalResult prepareAdjoint(Failure &failure, bool claims);
  std::optional<Compiler::Function> compilePlannedAdjoint(Failure &failure);
  bool canReadStored(CompileRequest::Goal goal, const ToBeRecorded &told);
  /// What passes have left out of a function that was made or loaded.
  void count(const Compiler::Function &function, bool isAdjoint);
  std::vector<runtime::TreePtr> findTrees(ArrayRef<std::string> names) const;
  runtime::KernelInfo getFormInfo(const Compiler::Function &compiled,
                                  CompileRequest::Goal goal, bool forward,
                                  StringRef suffix);

  KernelServices services;
  Source source;
  /// All that was linked for it.
  std::mutex functionsMutex;
  std::vector<Compiler::Function> functions;
  /// The adjoint, in the form that a tape launches for all we know, between the
  /// two steps of its compilation, taken by whoever makes the second; and what
  /// it asks of memory.
  std::timed_mutex prepareMutex;
  using PrepareLock = runtime::safepoint::Guard<std::timed_mutex>;
  bool planZeroes = false, planLoadsStored = true;
  std::optional<Compiler::Prepared> prepared;
  std::optional<std::string> toBeRecorded;
  /// The adjoint, compiled ahead of need, and what became of it.
  Background::JobPtr ahead;
  std::optional<Compiler::Function> aheadResult;
  Failure aheadFailure;
};

/// A kernel that can be launched, and its code.
struct MadeKernel {
  std::shared_ptr<KernelCode> code;
  runtime::KernelPtr kernel;
};

/// Takes a module with a kernel of the given name, adds the declarations that
/// it uses, verifies it, and makes a kernel of the runtime. What is wrong is
/// noted in the log. `modes` are those of the context, which the kernel has
/// already.
FailureOr<MadeKernel> makeKernel(const KernelServices &services,
                                 OwningOpRef<ModuleOp> module, StringRef name,
                                 const CompileOptions &options,
                                 const ContextModes &modes = {});

/// True if a reverse sweep may launch the adjoint: the kernel reads a field
/// that has one, and changes such a field.
bool carriesGradients(const runtime::Kernel &kernel);

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_KERNELCODE_H
