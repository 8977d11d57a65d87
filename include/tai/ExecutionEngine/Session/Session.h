//===- Session.h - A context in which programs run --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Ties an MLIR context, the runtime and the compiler together, and owns the
// declared trees, fields and kernels. The C API and tai-run use it.
//
// A session may be used by one thread at a time; it compiles on several
// threads.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_SESSION_SESSION_H
#define TAI_EXECUTIONENGINE_SESSION_SESSION_H

#include "tai/ExecutionEngine/Kernels/KernelCode.h"
#include "tai/ExecutionEngine/Modes/ContextModes.h"
#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include "llvm/Support/ThreadPool.h"
#include <list>

namespace mlir::tai {

/// The number of objects in a session.
struct SessionObjects {
  int64_t trees = 0, fields = 0, declarations = 0, kernels = 0, codes = 0,
          linked = 0, failures = 0;
};

/// A kernel of a session. Compiled on its first launch.
struct SessionKernel {
  std::shared_ptr<KernelCode> code;
  runtime::KernelPtr kernel;
  /// The position of the kernel in the session's list.
  std::list<SessionKernel>::iterator place = {};
};

/// A facade over its parts: Declarations, KernelCode, Compiler, Background,
/// FailureLog, CompileReports, and the runtime.
class Session {
public:
  Session();
  ~Session();

  MLIRContext *getContext() { return context.get(); }
  runtime::Runtime &getRuntime() { return *rt; }
  Compiler &getCompiler() { return *compiler; }

  /// The last failure of the calling thread; every call below that returns
  /// failure sets it.
  const Failure &getFailure() const { return failures.getLast(); }
  LogicalResult fail(Failure failure) {
    return failures.fail(std::move(failure));
  }
  LogicalResult fail(FailureKind kind, const Twine &message) {
    return failures.fail(kind, message);
  }
  /// Turns a status of the runtime into the failure of the session.
  LogicalResult fail(const runtime::Status &status) {
    return failures.fail(status);
  }
  /// The log of compiler warnings.
  WarningLog &getWarnings() { return warnings; }
  LogicalResult check(const runtime::Status &status) {
    return failures.check(status);
  }
  /// Keeps a failure and returns a status that refers to it, to pass it through
  /// the runtime. Thread-safe.
  runtime::Status keepFailure(Failure failure) {
    return failures.keep(std::move(failure));
  }

  /// Sets an option of `taiContextSetOption`. Options that affect code apply to
  /// kernels created afterwards.
  LogicalResult setOption(StringRef name, StringRef value);

  //===--------------------------------------------------------------------===//
  // Declarations
  //===--------------------------------------------------------------------===//

  /// See Declarations.
  LogicalResult addTree(StringRef name, StringRef layout) {
    return declarations->addTree(name, layout);
  }
  LogicalResult addTree(TreeOp tree) { return declarations->addTree(tree); }
  LogicalResult destroyTree(StringRef name) {
    return declarations->destroyTree(name);
  }
  FailureOr<runtime::FieldPtr> addField(StringRef declaration) {
    return declarations->addField(declaration);
  }
  FailureOr<runtime::FieldPtr> addField(FieldOp field) {
    return declarations->addField(field);
  }
  /// See Runtime::setActive.
  LogicalResult setActive(const runtime::TreePtr &tree, int64_t level,
                          int64_t cell, bool isActive) {
    return check(rt->setActive(tree, level, cell, isActive));
  }

  /// Creates a kernel from a module that holds a kernel of the given name: adds
  /// the trees and fields that the kernel uses, and verifies it.
  FailureOr<SessionKernel *> createKernel(OwningOpRef<ModuleOp> module,
                                          StringRef name);
  /// Creates a kernel from a module as text, or as bytecode with a checksum
  /// (see ModuleFile.h); `file` names it in diagnostics.
  FailureOr<SessionKernel *> parseKernel(StringRef bytes, StringRef file,
                                         StringRef name);
  void destroyKernel(SessionKernel *kernel) { kernels.erase(kernel->place); }

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
                              int64_t slots) {
    return check(rt->launchAdjoint(*kernel.kernel, args, slots));
  }

  /// Compiles kernels, and their adjoints if `adjoints`, on several threads.
  LogicalResult compile(ArrayRef<SessionKernel *> kernels, bool adjoints);

  /// Compiles the adjoints that the reverse sweep of the tape will launch.
  /// `cleared`: gradients will be cleared before the sweep.
  LogicalResult prepareReverse(runtime::Tape &tape, bool cleared);

  /// A compiled function that runs on the host.
  struct HostFunction {
    std::string name;
    Compiler::Function code;
    CompileOptions options;
    /// Whether the function accesses fields itself, beside its launches.
    bool usesFields = false;
  };
  /// Compiles the host function of the given name in the module.
  FailureOr<HostFunction> compileHost(ModuleOp module, StringRef name);
  /// Whether the function was compiled with the options that hold now.
  bool isCurrent(const HostFunction &function) const {
    return function.options == getHostOptions();
  }
  /// Runs the function with the kernels that `findKernel` gives for the names
  /// that it launches.
  LogicalResult
  runHost(const HostFunction &function,
          const std::function<SessionKernel *(StringRef name)> &findKernel);
  /// Frees a function that is not running.
  void unload(const HostFunction &function) { compiler->unload(function.code); }

  /// Whether consecutive launches may be fused into one; see FuseLaunches.
  bool fusesLaunches() const;
  /// Fuses kernels that a host function of the file launches one after another
  /// into one kernel, where the options allow it.
  LogicalResult fuseLaunchesIn(ModuleOp file);
  bool isDeterministic() const { return compileOptions.deterministic; }

  /// The IR of a kernel at a stage (see Compiler::getStages), or the result of
  /// `explain` for "explain".
  FailureOr<std::string> getIR(SessionKernel &kernel, StringRef stage);
  /// How the gradient of a kernel handles loops, branches and memory, as text.
  FailureOr<std::string> explain(SessionKernel &kernel);

  std::list<SessionKernel> &getKernels() { return kernels; }
  /// Adds the declarations that the module refers to and does not hold.
  LogicalResult declareUsed(ModuleOp module) {
    return declarations->declareUsed(module);
  }

  /// The session's kernel called `name`, or null.
  SessionKernel *findKernel(StringRef name);

  /// Whether a kernel of the name may be launched, by a tape for example.
  /// Thread-safe.
  bool hasCode(StringRef name) const { return codeNames.has(name); }
  SessionObjects countObjects();

private:
  /// The options of functions of the host, which run on the CPU wherever their
  /// kernels do.
  CompileOptions getHostOptions() const;
  KernelServices getServices();
  /// Compiles the kernel and its adjoint before their first launch.
  LogicalResult compileEagerly(runtime::Kernel &kernel);
  void useCache(StringRef folder);
  void keepChoices(runtime::KeptChoices kept);
  /// Compiles a program on a thread of `background`.
  std::unique_ptr<runtime::ProgramJob> startProgram(runtime::ProgramPlan plan);

  // Setters of options that are kept in several members of the session, or in
  // members other than CompileOptions and the runtime; see Options.def.
  LogicalResult setThreads(int threads);
  LogicalResult setDeterministic(bool on);
  LogicalResult setDebug(bool on);
  LogicalResult setFastMath(bool on);
  LogicalResult setStrict(bool on);
  LogicalResult setPrecision(StringRef word);
  LogicalResult setSums(StringRef word);
  LogicalResult setMath(StringRef word);
  LogicalResult setFtz(bool on);
  LogicalResult setAdjoints(StringRef word);
  LogicalResult setWord(StringRef name, StringRef word);
  /// Sets the modes of the context; fails if they contradict each other.
  LogicalResult setModes(const ContextModes &wanted);
  LogicalResult setShadow(bool on);
  LogicalResult setSanitize(bool address);
  LogicalResult setTargetCpu(StringRef name);
  LogicalResult setCacheDir(StringRef folder);
  LogicalResult setPrintIR(StringRef names);
  LogicalResult setProfiler(bool on);
  LogicalResult setCompileProfile(bool on);
  LogicalResult setSkip(StringRef names);
  LogicalResult setDeviceMemoryLimit(int64_t bytes);
  LogicalResult setDeviceHeap(int64_t bytes);
  /// Opens the device, or returns to the CPU.
  LogicalResult setArch(StringRef name);
  LogicalResult setFuseLaunches(bool on);

  std::unique_ptr<llvm::ThreadPoolInterface> pool;
  std::unique_ptr<MLIRContext> context;
  FailureLog failures;
  CompileReports reports;
  WarningLog warnings;
  /// Declared before the runtime, to outlive it: kernels of the runtime use the
  /// names.
  CodeNames codeNames;
  std::unique_ptr<runtime::Runtime> rt;
  std::unique_ptr<Compiler> compiler;
  Background background;
  std::shared_ptr<runtime::CacheStore> cache;
  /// Storage for results of trials, such as block sizes, in the cache.
  runtime::KeptChoices keptChoices;
  CompileOptions compileOptions;
  ContextModes modes;
  /// The memory limit of the device that is opened next.
  int64_t deviceMemoryLimit = 0;
  bool fuseLaunches = true;
  std::optional<Declarations> declarations;
  std::list<SessionKernel> kernels;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_SESSION_SESSION_H
