//===- CompilerWorker.h - State of one compiling thread ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of one thread that compiles: Compiler.cpp runs passes with it, and
// CompilerCode.cpp generates code with it.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_COMPILERWORKER_H
#define TAI_EXECUTIONENGINE_COMPILERWORKER_H

#include "tai/ExecutionEngine/Compile/Compiler.h"
#include "tai/ExecutionEngine/Reproduce/Reproducer.h"
#include <chrono>

namespace mlir::tai {

/// Adds the lifetime of the timer object to the time of a compile phase.
class PhaseTimer {
public:
  PhaseTimer(PhaseTimes &times, Phase phase)
      : slot(times[static_cast<unsigned>(phase)]),
        start(std::chrono::steady_clock::now()) {}
  ~PhaseTimer() {
    slot +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
            .count();
  }

private:
  double &slot;
  std::chrono::steady_clock::time_point start;
};

/// The pass managers and code generators of one thread. They are reused,
/// because a pass collects its patterns when it first runs, and target machines
/// are expensive to create.
struct Compiler::Worker {
  Worker(MLIRContext *context, const Pipelines &pipelines,
         const CompileOptions &options);

  CompileOptions options;
  /// The pass after which verification failed in the last pipeline, and the
  /// error.
  InvalidAfterPass::Finding finding;
  PassManager autodiff;
  PassManager zeroingAutodiff;
  PassManager forward;
  /// The passes that lower to the LLVM dialect, with or without device code.
  PassManager lowering;
  std::unique_ptr<ObjectCompiler> objects;
  std::unique_ptr<DeviceCompiler> deviceCode;
  std::string *scf = nullptr;
};

/// Borrows an idle compiler worker for these options, or makes one, and returns
/// it at the end of the scope.
class Compiler::WorkerLease {
public:
  WorkerLease(Compiler &compiler, const CompileOptions &options)
      : compiler(compiler) {
    {
      std::lock_guard<std::mutex> lock(compiler.mutex);
      auto found = llvm::find_if(compiler.idle, [&](const auto &candidate) {
        return candidate->options == options;
      });
      if (found != compiler.idle.end()) {
        worker = std::move(*found);
        compiler.idle.erase(found);
      }
    }
    if (!worker)
      worker = std::make_unique<Worker>(compiler.context, compiler.pipelines,
                                        options);
  }
  ~WorkerLease() {
    std::lock_guard<std::mutex> lock(compiler.mutex);
    compiler.idle.push_back(std::move(worker));
  }

  Worker &operator*() { return *worker; }

private:
  Compiler &compiler;
  std::unique_ptr<Worker> worker;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_COMPILERWORKER_H
