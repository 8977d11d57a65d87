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

/// The numbers of live objects of each kind in a session.
struct SessionObjects {
  int64_t trees = 0, fields = 0, declarations = 0, kernels = 0, codes = 0,
          linked = 0, failures = 0;
};

/// A kernel of a session. The kernel is compiled on its first launch.
struct SessionKernel {
  std::shared_ptr<KernelCode> code;
  runtime::KernelPtr kernel;
  /// The position of the kernel in the session's list of kernels.
  std::list<SessionKernel>::iterator place = {};
};

/// The entry point for users of the compiler and the runtime: a facade over
/// Declarations, KernelCode, Compiler, Background, FailureLog, CompileReports,
/// and the runtime.
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
  /// Keeps a failure of the compiler and returns a status that refers to it, to
  /// pass the failure through the runtime. Thread-safe.
  runtime::Status keepFailure(Failure failure) {
    return failures.keep(std::move(failure));
  }

  /// Sets an option of the session, as `taiContextSetOption` does. Options that
  /// affect code apply to kernels created afterwards.
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
    return check(rt->writes().setActive(tree, level, cell, isActive));
  }

  /// Creates a kernel of the session from a module that holds a kernel of the
  /// given name: adds to the module the trees and fields that the kernel uses,
  /// and verifies it.
  FailureOr<SessionKernel *> createKernel(OwningOpRef<ModuleOp> module,
                                          StringRef name);
  /// Creates a kernel of the session from a module as text, or as bytecode with
  /// a checksum (see ModuleFile.h). Diagnostics call the module `file`.
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

  /// Compiles, ahead of the reverse sweep, the adjoints that the sweep of a
  /// tape will launch. `cleared` says that gradients will be cleared before the
  /// sweep, which allows other variants of adjoints.
  LogicalResult prepareReverse(runtime::Tape &tape, bool cleared);

  /// A compiled function that runs on the host and launches kernels.
  struct HostFunction {
    std::string name;
    Compiler::Function code;
    CompileOptions options;
    /// True if the host function accesses fields itself, beside its launches.
    bool usesFields = false;
  };
  /// Compiles the host function called `name` of a module.
  FailureOr<HostFunction> compileHost(ModuleOp module, StringRef name);
  /// True if the host function was compiled with the options that the session
  /// has now.
  bool isCurrent(const HostFunction &function) const {
    return function.options == getHostOptions();
  }
  /// Runs a host function. `findKernel` finds the kernels that the function
  /// launches by name.
  LogicalResult
  runHost(const HostFunction &function,
          const std::function<SessionKernel *(StringRef name)> &findKernel);
  /// Frees the code of a host function that is not running.
  void unload(const HostFunction &function) { compiler->unload(function.code); }

  /// True if consecutive launches of a host function may be fused into one
  /// launch; see FuseLaunches.
  bool fusesLaunches() const;
  /// Fuses into one kernel those kernels that a host function of the module
  /// launches one after another, where the options allow it.
  LogicalResult fuseLaunchesIn(ModuleOp file);
  bool isDeterministic() const { return compileOptions.deterministic; }

  /// The IR of a kernel at a stage (see Compiler::getStages), or the result of
  /// `explain` for "explain".
  FailureOr<std::string> getIR(SessionKernel &kernel, StringRef stage);
  /// How the gradient of a kernel handles loops, branches and memory, as text.
  FailureOr<std::string> explain(SessionKernel &kernel);
  /// A line for each sum of additions that the gradient of a kernel gathers, or
  /// does not, and why; empty if it has no gradient.
  std::string explainGathers(const runtime::Kernel *kernel);

  std::list<SessionKernel> &getKernels() { return kernels; }
  /// Adds to `module` the tree and field declarations that it refers to and
  /// does not hold.
  LogicalResult declareUsed(ModuleOp module) {
    return declarations->declareUsed(module);
  }

  /// The session's kernel called `name`, or null.
  SessionKernel *findKernel(StringRef name);

  /// True if a kernel called `name` may still be launched, by a tape for
  /// example. Thread-safe.
  bool hasCode(StringRef name) const { return codeNames.has(name); }
  SessionObjects countObjects();

private:
  /// The compile options for functions of the host, which run on the CPU
  /// wherever their kernels run.
  CompileOptions getHostOptions() const;
  KernelServices getServices();
  /// Compiles a kernel and its adjoint before their first launch.
  LogicalResult compileEagerly(runtime::Kernel &kernel);
  void useCache(StringRef folder);
  void keepChoices(runtime::KeptChoices kept);
  /// Compiles a program, fused from several device kernels, on a thread of
  /// `background`.
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
  /// Sets the numeric modes of the session; fails if they contradict each
  /// other.
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
  /// Opens the device that runs kernels, or returns to the CPU.
  LogicalResult setArch(StringRef name);
  LogicalResult setFuseLaunches(bool on);

  std::unique_ptr<llvm::ThreadPoolInterface> pool;
  std::unique_ptr<MLIRContext> context;
  FailureLog failures;
  CompileReports reports;
  WarningLog warnings;
  /// The names of kernels in use. Declared before the runtime, so that they
  /// outlive its kernels, which refer to these names.
  CodeNames codeNames;
  std::unique_ptr<runtime::Runtime> rt;
  std::unique_ptr<Compiler> compiler;
  Background background;
  std::shared_ptr<runtime::CacheStore> cache;
  /// Keeps results of timing trials, such as block sizes of kernels, in the
  /// compile cache.
  runtime::KeptChoices keptChoices;
  CompileOptions compileOptions;
  ContextModes modes;
  /// The memory limit, in bytes, of the device that is opened next; 0 for no
  /// limit.
  int64_t deviceMemoryLimit = 0;
  bool fuseLaunches = true;
  std::optional<Declarations> declarations;
  std::list<SessionKernel> kernels;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_SESSION_SESSION_H
