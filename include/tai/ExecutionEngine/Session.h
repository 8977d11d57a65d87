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

#include "tai/ExecutionEngine/ContextModes.h"
#include "tai/ExecutionEngine/KernelCode.h"
#include "tai/Runtime/Cache/CacheStore.h"
#include "llvm/Support/ThreadPool.h"
#include <list>

namespace mlir::tai {

/// How many things a session holds.
struct SessionObjects {
  int64_t trees = 0, fields = 0, declarations = 0, kernels = 0, codes = 0,
          linked = 0, failures = 0;
};

/// A kernel of a session. It is compiled when it is first launched.
struct SessionKernel {
  std::shared_ptr<KernelCode> code;
  runtime::KernelPtr kernel;
  /// Where the session keeps it.
  std::list<SessionKernel>::iterator place = {};
};

/// The C API and tai-run call this. It owns the parts, and each does its own:
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
  /// Where warnings of the compiler go.
  WarningLog &getWarnings() { return warnings; }
  LogicalResult check(const runtime::Status &status) {
    return failures.check(status);
  }
  /// Keeps a failure and makes a status that stands for it, to pass it through
  /// the runtime. Any thread.
  runtime::Status keepFailure(Failure failure) {
    return failures.keep(std::move(failure));
  }

  /// Sets an option of `taiContextSetOption`. Those that decide code hold for
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

  /// Takes a module with a kernel of the given name, adds the trees and fields
  /// that it uses, and verifies it.
  FailureOr<SessionKernel *> createKernel(OwningOpRef<ModuleOp> module,
                                          StringRef name);
  /// The same for a module given as text, or as bytecode with its checksum (see
  /// ModuleFile.h); `file` names it in diagnostics.
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

private:
  KernelServices getServices();
  /// The kernel and its adjoint, before anyone launches them.
  LogicalResult compileEagerly(runtime::Kernel &kernel);
  void useCache(StringRef folder);

  // Options of which more than one part, or another than CompileOptions and the
  // runtime, is to know; see Options.def.
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
  /// Takes the modes for those of the context, unless two of them contradict.
  LogicalResult setModes(const ContextModes &wanted);
  LogicalResult setShadow(bool on);
  LogicalResult setSanitize(bool address);
  LogicalResult setCacheDir(StringRef folder);
  LogicalResult setPrintIR(StringRef names);
  LogicalResult setProfiler(bool on);
  LogicalResult setCompileProfile(bool on);
  LogicalResult setSkip(StringRef names);
  LogicalResult setDeviceMemoryLimit(int64_t bytes);
  LogicalResult setDeviceHeap(int64_t bytes);
  /// Opens the device, or goes back to the CPU.
  LogicalResult setArch(StringRef name);
  LogicalResult setFuseLaunches(bool on);

  std::unique_ptr<llvm::ThreadPoolInterface> pool;
  std::unique_ptr<MLIRContext> context;
  FailureLog failures;
  CompileReports reports;
  WarningLog warnings;
  /// Outlives the runtime, whose kernels hold code.
  CodeNames codeNames;
  std::unique_ptr<runtime::Runtime> rt;
  std::unique_ptr<Compiler> compiler;
  Background background;
  std::shared_ptr<runtime::CacheStore> cache;
  CompileOptions compileOptions;
  ContextModes modes;
  /// Of the device that is opened next.
  int64_t deviceMemoryLimit = 0;
  bool fuseLaunches = true;
  std::optional<Declarations> declarations;
  std::list<SessionKernel> kernels;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_SESSION_H
