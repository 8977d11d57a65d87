//===- Compiler.h - From a module to a function that runs -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Compiles kernels for the CPU that it runs on: differentiation where the
// adjoint is wanted, lowering, LLVM's optimiser, object code, and a place in
// memory. For a GPU that is the host's part of a kernel, next to the image of
// its device code. Object code is kept in a cache on disk, in front of
// everything else: a hit runs no pass.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_COMPILER_H
#define TAI_EXECUTIONENGINE_COMPILER_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"
#include "mlir/Pass/PassManager.h"
#include "tai/CodeGen/CompiledObject.h"
#include "tai/CodeGen/DeviceCompiler.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/CodeGen/Linker.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "tai/Interfaces/Differentiable.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Support/Skips.h"
#include <array>
#include <functional>

namespace mlir::tai {
class Interpreter;

/// What decides the code made from a kernel; see Options.def.
struct CompileOptions {
  CodegenOptions codegen;
#define TAI_COMPILE_OPTION(type, member, initial, key) type member = initial;
#include "tai/Support/Options.def"
  /// The device that runs the loops, and what its code is made for, by the
  /// words of runtime::Device. None for the CPU alone.
  std::optional<runtime::DeviceKind> device;
  std::string deviceTarget;

  bool operator==(const CompileOptions &other) const {
    bool same = codegen == other.codegen && device == other.device &&
                deviceTarget == other.deviceTarget;
#define TAI_COMPILE_OPTION(type, member, initial, key)                         \
  same &= member == other.member;
#include "tai/Support/Options.def"
    return same;
  }
  /// The options as text, for the key of the cache.
  std::string str() const;
};

/// Steps of a compilation, for the profile.
enum class Phase { Cache, Autodiff, Lower, Translate, Optimize, Emit, Link };
constexpr unsigned kNumPhases = 7;
StringRef stringifyPhase(Phase phase);

/// Seconds spent in each phase.
using PhaseTimes = std::array<double, kNumPhases>;

/// Where compiled objects are kept from run to run. All calls come from any
/// thread.
struct ObjectCache {
  /// The bytes stored under the key, or nothing. Bytes that were damaged are
  /// never returned.
  std::function<std::optional<std::string>(StringRef key)> load;
  std::function<void(StringRef key, StringRef bytes)> store;
  /// The right to make the object of the key, which others wait for; see
  /// runtime::CacheStore::claim. `goesOn` says whether to wait on for it. May
  /// be left out.
  std::function<std::shared_ptr<void>(StringRef key,
                                      const std::function<bool()> &goesOn)>
      claim = nullptr;
  explicit operator bool() const { return static_cast<bool>(load); }
};

/// What to compile.
struct CompileRequest {
  /// ZeroingAdjoint: the adjoint that leaves zero in the adjoints of the
  /// elements which the kernel stores. Stored: the adjoint that loads what the
  /// kernel has stored, or the other where there is no such form.
  enum class Goal {
    Primal,
    Adjoint,
    ZeroingAdjoint,
    StoredAdjoint,
    StoredZeroingAdjoint
  };
  static Goal getAdjointGoal(bool zeroes, bool stored) {
    if (stored)
      return zeroes ? Goal::StoredZeroingAdjoint : Goal::StoredAdjoint;
    return zeroes ? Goal::ZeroingAdjoint : Goal::Adjoint;
  }
  static bool zeroes(Goal goal) {
    return goal == Goal::ZeroingAdjoint || goal == Goal::StoredZeroingAdjoint;
  }
  static bool readsStored(Goal goal) {
    return goal == Goal::StoredAdjoint || goal == Goal::StoredZeroingAdjoint;
  }

  /// Left as it is. Holds the function, what it calls, and the trees and
  /// fields that it uses.
  ModuleOp module;
  StringRef name;
  Goal goal;
  /// Make what carries tangents along instead.
  bool forward = false;
};

class Compiler {
public:
  /// The pass pipelines. Each is built once and run by one thread at a time.
  struct Pipelines {
    std::function<void(OpPassManager &, const CompileOptions &, bool zeroes)>
        autodiff;
    /// Extends all kernels of a module by tangents.
    std::function<void(OpPassManager &, const CompileOptions &)> forward;
    std::function<void(OpPassManager &, const CompileOptions &)> toLLVM;
    /// The same for a kernel that has a device: leaves a `gpu.module` too.
    std::function<void(OpPassManager &, const CompileOptions &)> toDevice;
    /// The pass after which the IR is "scf", and the one with a device.
    std::string scfPass, deviceScfPass;
  };

  /// The dialects that the pipelines make must be loaded: several threads use
  /// the context.
  Compiler(MLIRContext *context, Pipelines pipelines,
           ArrayRef<runtime::RuntimeSymbol> runtime);
  ~Compiler();

  /// Loads what the pipelines depend on into the context.
  void loadDialects();

  void setCache(ObjectCache cache) { this->cache = std::move(cache); }

  struct Function {
    /// Null for an adjoint that has nothing to do.
    void *address = nullptr;
    Linker::Library *library = nullptr;
    /// The trees whose bases the function is given, in order.
    std::vector<std::string> trees;
    /// As in CompiledObject.
    SkipAmounts skipped{};
    std::vector<int64_t> loopLevels;
    std::vector<Warning> warnings;
    /// The code of the device functions that the function launches, if any.
    std::shared_ptr<const runtime::DeviceImage> image;
    bool fromCache = false;
    PhaseTimes times = {};
    /// What the code at the address calls, if that is not code.
    std::shared_ptr<const Interpreter> interpreter;
  };

  /// Compiles, or takes from the cache, and links. Called by several threads.
  std::optional<Function> compile(CompileRequest request,
                                  const CompileOptions &options,
                                  Failure &failure);

  /// The same in two steps. After the first, what the adjoint asks of memory is
  /// known; with code in the cache, it is all there is to do.
  struct Prepared {
    /// The step that is being done, or that has failed.
    enum class Step { Autodiff, Forward, Lower, Code };
    Step step = Step::Autodiff;
    std::string key;
    /// From the cache.
    std::optional<CompiledObject> object;
    /// Else the module, differentiated, and the symbol of its entry point.
    OwningOpRef<ModuleOp> module;
    std::string symbol;
    std::string toBeRecorded;
    SkipAmounts skipped{};
    std::vector<Warning> warnings;
    PhaseTimes times = {};
    /// Makes other processes wait for the object.
    std::shared_ptr<void> claim;
  };
  /// `claims`: the second step follows at once, and other processes may wait.
  std::optional<Prepared> prepare(CompileRequest request,
                                  const CompileOptions &options,
                                  Failure &failure, bool claims = false);
  std::optional<Function> finish(Prepared prepared, CompileRequest request,
                                 const CompileOptions &options,
                                 Failure &failure);

  /// Makes one kernel of many; see runtime::ProgramMaker.
  std::optional<runtime::DeviceImage>
  makeProgram(const runtime::ProgramPlan &plan, const CompileOptions &options,
              Failure &failure);

  /// Where code is refused that was made without an error: writes the module
  /// and the passes that lead there. The failure names the file afterwards.
  void addReproducer(CompileRequest request, const CompileOptions &options,
                     Failure &failure) {
    addReproducer(request, options, Prepared::Step::Code, failure);
  }

  /// Frees a function that is not running.
  void unload(const Function &function);
  /// Pieces of code that are linked and not freed.
  int64_t numLinked() const { return linker ? linker->numLinked() : 0; }

  /// The IR at a stage: "tai", "autodiff", "scf", "llvm", "llvmir", "asm"; with
  /// a device also its code, "nvvm" and "ptx".
  std::optional<std::string> print(CompileRequest request, StringRef stage,
                                   const CompileOptions &options,
                                   Failure &failure);
  static ArrayRef<StringRef> getStages();
  /// Whether a stage is there only with a device.
  static bool isDeviceStage(StringRef stage) {
    return stage == "nvvm" || stage == "ptx";
  }

  /// Seconds spent in each phase since the start, over all threads.
  PhaseTimes getTotals();

private:
  struct Worker;
  class WorkerLease;

  /// Takes the object from the cache, if it is there.
  void load(Prepared &prepared, CompileRequest request);
  /// The same after whoever makes the object now is done; where nobody has, the
  /// right to make it.
  /// Fails where the wait for another process was interrupted.
  LogicalResult claimOrLoad(Prepared &prepared, CompileRequest request,
                            Failure &failure);
  /// Differentiates what is to be compiled.
  LogicalResult start(CompileRequest request, const CompileOptions &options,
                      Prepared &prepared, Failure &failure);
  /// Links an object. False, with the reason, if that cannot be.
  LogicalResult link(const CompiledObject &object, StringRef name,
                     Function &function, Failure &failure);
  std::optional<CompiledObject> makeObject(CompileRequest request,
                                           const CompileOptions &options,
                                           Prepared &prepared,
                                           Failure &failure);
  /// Makes the module to be lowered: for an adjoint, by differentiation.
  LogicalResult differentiate(Worker &worker, CompileRequest request,
                              Prepared &prepared, Failure &failure);
  LogicalResult lower(Worker &worker, CompileRequest request,
                      Prepared &prepared, std::vector<std::string> &trees,
                      Failure &failure, std::string *scf);
  std::optional<CompiledObject> compileObject(CompileRequest request,
                                              const CompileOptions &options,
                                              Prepared &prepared,
                                              Failure &failure);
  /// Compiles what the cache holds anew, for its device code.
  runtime::Status makeImageAgain(CompileRequest request,
                                 const CompileOptions &options,
                                 runtime::DeviceImage &image);
  /// Makes a function of the interpreter, and a few instructions that call it.
  std::optional<Function> interpret(Prepared prepared, CompileRequest request,
                                    const CompileOptions &options,
                                    Failure &failure);
  std::optional<std::string> printStage(CompileRequest request, StringRef stage,
                                        const CompileOptions &options,
                                        Prepared &prepared, Failure &failure);
  /// Takes the device code out of a lowered module and compiles it.
  LogicalResult compileDeviceCode(Worker &worker, const CompileOptions &options,
                                  Prepared &prepared,
                                  std::optional<runtime::DeviceImage> &image,
                                  Failure &failure);
  /// Prints what comes after the LLVM dialect.
  std::optional<std::string> printCode(Worker &worker, Prepared &prepared,
                                       StringRef stage,
                                       const CompileOptions &options,
                                       Failure &failure);
  /// Replaces the kernels of a module by those that carry tangents.
  LogicalResult extendByTangents(Worker &worker, CompileRequest request,
                                 Prepared &prepared, Failure &failure);
  /// A digest of the module with all that it says of places in the source.
  static std::string getPlaces(CompileRequest request);
  std::string getKey(CompileRequest request, const CompileOptions &options);
  Linker *getLinker(Failure &failure);
  /// Adds what shows the failure of a step, if it is a bug of ours.
  void addReproducer(CompileRequest request, const CompileOptions &options,
                     Prepared::Step step, Failure &failure);

  MLIRContext *context;
  Pipelines pipelines;
  std::vector<runtime::RuntimeSymbol> runtime;
  ObjectCache cache;
  std::mutex mutex;
  std::unique_ptr<Linker> linker;
  std::vector<std::unique_ptr<Worker>> idle;
  PhaseTimes totals = {};
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_COMPILER_H
