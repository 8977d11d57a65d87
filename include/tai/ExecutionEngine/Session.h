//===- Session.h - A context in which programs run --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ties an MLIR context, the runtime and the compiler together, and keeps what
// was declared: trees, fields, kernels. The C API and tai-run stand on it.
//
// A session may be used by one thread at a time; it compiles on several.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_SESSION_H
#define TAI_EXECUTIONENGINE_SESSION_H

#include "mlir/IR/OwningOpRef.h"
#include "mlir/IR/SymbolTable.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Background.h"
#include "tai/ExecutionEngine/Compiler.h"
#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "llvm/ADT/StringMap.h"
#include "llvm/Support/ThreadPool.h"
#include <deque>
#include <list>

namespace mlir::tai {
struct AdjointNeeds;

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

/// How many things a session holds.
struct SessionObjects {
  int64_t trees = 0, fields = 0, declarations = 0, kernels = 0, codes = 0,
          linked = 0, failures = 0;
};

/// What a kernel is compiled from, and the code made so far. It lives as long
/// as the runtime may launch it, which a tape can make longer than its handle.
struct KernelCode : std::enable_shared_from_this<KernelCode> {
  KernelCode(Compiler &compiler, Background &background, CodeNames &names,
             StringRef name, const CompileOptions &options)
      : compiler(compiler), background(background), names(names),
        name(name.str()), options(options) {
    names.add(name);
  }
  ~KernelCode();

  Compiler &compiler;
  Background &background;
  CodeNames &names;
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
  std::vector<Compiler::Function> functions;
  /// The adjoint, in the form that a tape launches for all we know, between the
  /// two steps of its compilation, taken by whoever makes the second; and what
  /// it asks of memory.
  std::mutex prepareMutex;
  bool planTakes = false;
  std::optional<Compiler::Prepared> prepared;
  std::optional<std::string> needs;
  /// The adjoint, compiled ahead of need, and what became of it.
  Background::JobPtr ahead;
  std::optional<Compiler::Function> aheadResult;
  Failure aheadFailure;
};

/// Slots of values of these types; see Abi.h.
int64_t countSlots(TypeRange types);

/// Which floats that the kernel stores depend on which that it reads, with or
/// without gradients; of the fields of its summary, and of its arguments.
runtime::KernelFlows findFlows(KernelOp kernel,
                               ArrayRef<runtime::Access> summary);
/// The elements of an array that the kernel stores in each launch, as those of
/// fields in its summary.
std::vector<runtime::StoredBox> findStoredBoxes(KernelOp kernel,
                                                BlockArgument array);

/// A kernel of a session. It is compiled when it is first launched.
struct SessionKernel {
  std::shared_ptr<KernelCode> code;
  runtime::KernelPtr kernel;
  /// Where the session keeps it.
  std::list<SessionKernel>::iterator place = {};
};

class Session {
public:
  Session();
  ~Session();

  MLIRContext *getContext() { return context.get(); }
  runtime::Runtime &getRuntime() { return *rt; }
  Compiler &getCompiler() { return *compiler; }

  /// The last failure of the calling thread; every call below that returns
  /// failure sets it.
  const Failure &getFailure() const;
  LogicalResult fail(Failure failure);
  LogicalResult fail(FailureKind kind, const Twine &message);

  /// Sets an option of `taiContextSetOption`. Those that decide code hold for
  /// kernels created afterwards.
  LogicalResult setOption(StringRef name, StringRef value);

  //===--------------------------------------------------------------------===//
  // Declarations
  //===--------------------------------------------------------------------===//

  /// Adds a tree, by the text of its layout or by its op.
  LogicalResult addTree(StringRef name, StringRef layout);
  LogicalResult addTree(TreeOp tree);
  LogicalResult destroyTree(StringRef name);
  /// See Runtime::setActive.
  LogicalResult setActive(const runtime::TreePtr &tree, int64_t level,
                          int64_t cell, bool isActive) {
    return check(rt->setActive(tree, level, cell, isActive));
  }

  /// Adds a field, by the text of a `tai.field` op or by the op. The adjoint
  /// that it names may be added later.
  FailureOr<runtime::FieldPtr> addField(StringRef declaration);
  FailureOr<runtime::FieldPtr> addField(FieldOp field);

  /// Takes a module with a kernel of the given name, adds the trees and fields
  /// that it uses, and verifies it.
  FailureOr<SessionKernel *> createKernel(OwningOpRef<ModuleOp> module,
                                          StringRef name);
  /// The same for a module given as text, or as bytecode with its checksum (see
  /// ModuleFile.h); `file` names it in diagnostics.
  FailureOr<SessionKernel *> parseKernel(StringRef bytes, StringRef file,
                                         StringRef name);
  void destroyKernel(SessionKernel *kernel);

  //===--------------------------------------------------------------------===//
  // Running
  //===--------------------------------------------------------------------===//

  LogicalResult launch(SessionKernel &kernel, const uint64_t *args,
                       int64_t slots, uint64_t *results) {
    runtime::Status status = rt->launch(*kernel.kernel, args, slots, results);
    if (LLVM_LIKELY(status.ok()))
      return success();
    return fail(status);
  }
  LogicalResult launchAdjoint(SessionKernel &kernel, const uint64_t *args,
                              int64_t slots);

  /// Compiles kernels, and their adjoints if asked, on several threads.
  LogicalResult compile(ArrayRef<SessionKernel *> kernels, bool adjoints);

  /// Compiles the adjoints that the reverse sweep of the tape will launch.
  /// `cleared`: the gradients will be cleared before.
  LogicalResult prepareReverse(runtime::Tape &tape, bool cleared);

  /// Compiles the host function of the given name in the module and runs it.
  /// The kernels that it launches are those of the session.
  LogicalResult runHost(ModuleOp module, StringRef name);

  /// The IR of a kernel at a stage, or what `explain` says for "explain".
  FailureOr<std::string> getIR(SessionKernel &kernel, StringRef stage);
  /// What the gradient of a kernel does about loops, branches and memory.
  FailureOr<std::string> explain(SessionKernel &kernel);

  /// The session's kernel behind a kernel of the runtime, or null.
  SessionKernel *findKernel(StringRef name);

  /// Whether a kernel of the name may be launched, by a tape for example. Any
  /// thread.
  bool hasCode(StringRef name) const { return codeNames.has(name); }
  SessionObjects countObjects();

  /// Keeps a failure and makes a status that stands for it, to pass it through
  /// the runtime. Any thread.
  runtime::Status keepFailure(Failure failure);
  /// Turns a status of the runtime into the failure of the session.
  LogicalResult fail(const runtime::Status &status);
  LogicalResult check(const runtime::Status &status) {
    return status.ok() ? success() : fail(status);
  }

private:
  /// Adds the declarations that `module` refers to and does not hold.
  LogicalResult declareUsed(ModuleOp module);
  LogicalResult verifyModule(ModuleOp module);
  LogicalResult clampIndices(ModuleOp module);
  std::vector<runtime::Access> summarize(ModuleOp module, KernelOp kernel);
  runtime::Status compilePrimal(KernelCode &code,
                                runtime::Kernel &runtimeKernel,
                                TaiKernelFn &function);
  runtime::Status compileAdjoint(KernelCode &code,
                                 runtime::Kernel &runtimeKernel, bool takes,
                                 bool stored, runtime::KernelPtr &adjoint);
  bool canReadStored(KernelCode &code, CompileRequest::Goal goal,
                     const AdjointNeeds &told);
  runtime::Status compileChecked(KernelCode &code,
                                 runtime::CheckedKernel &checked);
  /// What carries tangents along with the kernel or a form of its adjoint.
  runtime::Status compileTangent(KernelCode &code, CompileRequest::Goal goal,
                                 runtime::KernelPtr &tangent);
  /// Runs a step of the compilation of a kernel on a thread of its own, so that
  /// this one passes safepoints. Where it is interrupted there, the step goes
  /// on to its end, for the cache, and the answer is a failure.
  template <typename Result>
  std::optional<Result>
  runAside(KernelCode &code,
           std::function<std::optional<Result>(Failure &)> step,
           Failure &failure);
  /// Notes a function that was compiled, to be freed with its kernel.
  std::optional<Compiler::Function>
  keepFunction(KernelCode &code, std::optional<Compiler::Function> function);
  std::optional<Compiler::Function> compileAs(KernelCode &code,
                                              CompileRequest::Goal goal,
                                              Failure &failure,
                                              bool forward = false);
  /// Differentiates the kernel unless that has been done. The caller holds
  /// `prepareMutex`.
  LogicalResult prepareAdjoint(KernelCode &code, Failure &failure, bool claims);
  std::optional<Compiler::Function> compileAdjoint(KernelCode &code,
                                                   Failure &failure);
  runtime::Status planAdjoint(KernelCode &code, runtime::Kernel &runtimeKernel,
                              runtime::AdjointPlan &plan);
  /// The kernel and its adjoint, before anyone launches them.
  LogicalResult compileEagerly(runtime::Kernel &kernel);
  /// What passes have left out of a function that was made or loaded.
  void count(const Compiler::Function &function, bool isAdjoint);
  FailureOr<std::pair<std::shared_ptr<KernelCode>, runtime::KernelPtr>>
  makeKernel(OwningOpRef<ModuleOp> module, StringRef name);
  void printStages(KernelCode &code, CompileRequest::Goal goal,
                   bool forward = false);
  void printProfile(StringRef name, CompileRequest::Goal goal,
                    const Compiler::Function &function);
  void useCache(StringRef folder);
  /// Opens the device, or goes back to the CPU.
  LogicalResult setArch(StringRef name);
  void setFuseLaunches(bool on);

  std::unique_ptr<llvm::ThreadPoolInterface> pool;
  std::unique_ptr<MLIRContext> context;
  /// Outlives the runtime, whose kernels hold code.
  CodeNames codeNames;
  std::unique_ptr<runtime::Runtime> rt;
  std::unique_ptr<Compiler> compiler;
  Background background;
  std::shared_ptr<runtime::CacheStore> cache;
  CompileOptions options;
  /// Of the device that is opened next.
  int64_t deviceMemoryLimit = 0;
  bool fuseLaunches = true;
  SmallVector<std::string> printedStages;
  bool printsProfile = false;

  /// Holds the trees and fields that were added.
  OwningOpRef<ModuleOp> declarations;
  std::optional<SymbolTable> symbols;
  std::list<SessionKernel> kernels;
  /// Failures of compilations, which the runtime passes on by number: the last
  /// ones, and how many there were before them.
  std::deque<Failure> compileFailures;
  size_t failuresBefore = 0;
  std::mutex mutex;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_SESSION_H
