//===- Compiler.h - From a module to a function that runs -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Compiles kernels for the CPU of this process: differentiation if the adjoint
// is requested, lowering, LLVM's optimiser, object code, and linking into
// memory. For a GPU, the object code is the host code of a kernel, beside the
// image of its device code. Object code is kept in a cache on disk, which is
// looked up first: a hit runs no pass.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_COMPILE_COMPILER_H
#define TAI_EXECUTIONENGINE_COMPILE_COMPILER_H

#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/OwningOpRef.h"
#include "mlir/Pass/PassManager.h"
#include "tai/CodeGen/CompiledObject.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
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

/// The options that affect the code of a kernel; see Options.def.
struct CompileOptions {
  CodegenOptions codegen;
#define TAI_COMPILE_OPTION(type, member, initial, key) type member = initial;
#include "tai/Support/Options.def"
  /// The device that runs the loops, and its target (see DeviceTarget). Empty
  /// for the CPU alone.
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

/// Persistent storage of compiled objects. Called from any thread.
struct ObjectCache {
  /// The bytes stored under the key, or none. Damaged entries are never
  /// returned.
  std::function<std::optional<std::string>(StringRef key)> load;
  std::function<void(StringRef key, StringRef bytes)> store;
  /// The exclusive right to make the object of the key while other processes
  /// wait; see runtime::CacheStore::claim. Waits for the right while `goesOn`
  /// returns true. Optional.
  std::function<std::shared_ptr<void>(StringRef key,
                                      const std::function<bool()> &goesOn)>
      claim = nullptr;
  explicit operator bool() const { return static_cast<bool>(load); }
};

/// A function to compile.
struct CompileRequest {
  /// ZeroingAdjoint: the adjoint that zeroes the adjoints of the elements which
  /// the kernel overwrites. StoredAdjoint: the adjoint that loads stored
  /// outputs of the kernel, or, without such a variant, the adjoint that does
  /// not.
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

  /// Not modified. Holds the function, its callees, and the trees and fields
  /// that it uses.
  ModuleOp module;
  StringRef name;
  Goal goal;
  /// Make the forward-mode variant instead: the function with tangents.
  bool forward = false;
};

class Compiler {
public:
  /// Builders of the pass pipelines. Each pipeline is run by one thread at a
  /// time.
  struct Pipelines {
    std::function<void(OpPassManager &, const CompileOptions &, bool zeroes)>
        autodiff;
    /// Extends all kernels of a module by tangents.
    std::function<void(OpPassManager &, const CompileOptions &)> forward;
    std::function<void(OpPassManager &, const CompileOptions &)> toLLVM;
    /// Like toLLVM, for a kernel on a device: also leaves a `gpu.module`.
    std::function<void(OpPassManager &, const CompileOptions &)> toDevice;
    /// The pass whose output is the stage "scf", without and with a device.
    std::string scfPass, deviceScfPass;
  };

  /// Call loadDialects() before several threads use the context.
  Compiler(MLIRContext *context, Pipelines pipelines,
           ArrayRef<runtime::RuntimeSymbol> runtime);
  ~Compiler();

  /// Loads the dependent dialects of the pipelines into the context.
  void loadDialects();

  void setCache(ObjectCache cache) { this->cache = std::move(cache); }
  /// The assembler of the device, which compiling threads call; may be null.
  void setAssembler(runtime::DeviceAssembler assembler) {
    this->assembler = std::move(assembler);
  }

  struct Function {
    /// Null for an adjoint without effects.
    void *address = nullptr;
    Linker::Library *library = nullptr;
    /// The trees whose base addresses the function needs, in order.
    std::vector<std::string> trees;
    /// As in CompiledObject.
    SkipAmounts skipped{};
    std::vector<int64_t> loopLevels;
    std::vector<Warning> warnings;
    /// The code of the device functions that the function launches, if any.
    std::shared_ptr<const runtime::DeviceImage> image;
    bool fromCache = false;
    PhaseTimes times = {};
    /// The interpreter that the code at `address` calls, if the function is
    /// interpreted.
    std::shared_ptr<const Interpreter> interpreter;
  };

  /// Compiles, or loads from the cache, and links. Thread-safe.
  std::optional<Function> compile(CompileRequest request,
                                  const CompileOptions &options,
                                  Failure &failure);

  /// Compiles in two steps, prepare and finish. After prepare, the ToBeRecorded
  /// of an adjoint is known; on a cache hit, only linking remains.
  struct Prepared {
    /// The current step, or the step that has failed.
    enum class Step { Autodiff, Forward, Lower, Code };
    Step step = Step::Autodiff;
    std::string key;
    /// The object, if it came from the cache.
    std::optional<CompiledObject> object;
    /// Otherwise the differentiated module, and the symbol of its entry point.
    OwningOpRef<ModuleOp> module;
    std::string symbol;
    std::string toBeRecorded;
    SkipAmounts skipped{};
    std::vector<Warning> warnings;
    PhaseTimes times = {};
    /// Makes other processes wait for the object.
    std::shared_ptr<void> claim;
  };
  /// With `claims`, finish must follow at once: other processes wait for the
  /// object.
  std::optional<Prepared> prepare(CompileRequest request,
                                  const CompileOptions &options,
                                  Failure &failure, bool claims = false);
  std::optional<Function> finish(Prepared prepared, CompileRequest request,
                                 const CompileOptions &options,
                                 Failure &failure);

  /// Fuses a sequence of kernels into one, or loads the result from the cache;
  /// see runtime::ProgramMaker.
  std::optional<runtime::DeviceImage>
  makeProgram(const runtime::ProgramPlan &plan, const CompileOptions &options,
              Failure &failure);

  /// For code that compiled without an error and was then rejected (by the
  /// device driver, say): writes a reproducer with the module and the pass
  /// pipeline, and adds the name of the file to the failure.
  void addReproducer(CompileRequest request, const CompileOptions &options,
                     Failure &failure) {
    addReproducer(request, options, Prepared::Step::Code, failure);
  }

  /// Frees a function that is not running.
  void unload(const Function &function);
  /// The number of objects that are linked and not freed.
  int64_t numLinked() const { return linker ? linker->numLinked() : 0; }

  /// The IR at a stage: "tai", "autodiff", "scf", "llvm", "llvmir", "asm"; with
  /// a device also its code, "nvvm" and "ptx". "autodiff" can have the places
  /// of its operations.
  std::optional<std::string> print(CompileRequest request, StringRef stage,
                                   const CompileOptions &options,
                                   Failure &failure, bool withPlaces = false);
  static ArrayRef<StringRef> getStages();
  /// Whether a stage exists only with a device.
  static bool isDeviceStage(StringRef stage) {
    return stage == "nvvm" || stage == "ptx";
  }

  /// Seconds spent in each phase since the start, over all threads.
  PhaseTimes getTotals();

private:
  struct Worker;
  class WorkerLease;

  /// Loads the object from the cache, if it is there.
  void load(Prepared &prepared, CompileRequest request);
  /// Loads the object, after waiting for another process that is making it; or
  /// else claims the right to make it. Fails where the wait for another process
  /// was interrupted.
  LogicalResult claimOrLoad(Prepared &prepared, CompileRequest request,
                            Failure &failure);
  /// The differentiation step.
  LogicalResult start(CompileRequest request, const CompileOptions &options,
                      Prepared &prepared, Failure &failure);
  /// Links an object; on failure, sets `failure`.
  LogicalResult link(const CompiledObject &object, StringRef name,
                     Function &function, Failure &failure);
  std::optional<CompiledObject> makeObject(CompileRequest request,
                                           const CompileOptions &options,
                                           Prepared &prepared,
                                           Failure &failure);
  /// Makes the module to lower: for an adjoint, by differentiation.
  LogicalResult differentiate(Worker &worker, CompileRequest request,
                              Prepared &prepared, Failure &failure);
  LogicalResult lower(Worker &worker, CompileRequest request,
                      Prepared &prepared, std::vector<std::string> &trees,
                      Failure &failure, std::string *scf);
  std::optional<CompiledObject> compileObject(CompileRequest request,
                                              const CompileOptions &options,
                                              Prepared &prepared,
                                              Failure &failure);
  /// Recompiles a kernel that came from the cache, for its device code.
  runtime::Status makeImageAgain(CompileRequest request,
                                 const CompileOptions &options,
                                 runtime::DeviceImage &image);
  /// Makes an interpreter of the function, and a stub that calls it.
  std::optional<Function> interpret(Prepared prepared, CompileRequest request,
                                    const CompileOptions &options,
                                    Failure &failure);
  std::optional<std::string> printStage(CompileRequest request, StringRef stage,
                                        const CompileOptions &options,
                                        Prepared &prepared, Failure &failure,
                                        bool withPlaces);
  /// Takes the device code out of a lowered module and compiles it.
  LogicalResult compileDeviceCode(Worker &worker, const CompileOptions &options,
                                  Prepared &prepared,
                                  std::optional<runtime::DeviceImage> &image,
                                  Failure &failure);
  /// Prints the stages after the LLVM dialect.
  std::optional<std::string> printCode(Worker &worker, Prepared &prepared,
                                       StringRef stage,
                                       const CompileOptions &options,
                                       Failure &failure);
  /// Replaces the kernels of a module by their forward-mode variants.
  LogicalResult extendByTangents(Worker &worker, CompileRequest request,
                                 Prepared &prepared, Failure &failure);
  /// A digest of the module with its source locations.
  static std::string getPlaces(CompileRequest request);
  std::string getKey(CompileRequest request, const CompileOptions &options);
  /// The key of a program, from its LLVM IR.
  std::string getProgramKey(StringRef text, const CompileOptions &options);
  Linker *getLinker(Failure &failure);
  /// Adds a reproducer to the failure of a step, if it is an internal error.
  void addReproducer(CompileRequest request, const CompileOptions &options,
                     Prepared::Step step, Failure &failure);

  MLIRContext *context;
  Pipelines pipelines;
  std::vector<runtime::RuntimeSymbol> runtime;
  ObjectCache cache;
  runtime::DeviceAssembler assembler;
  std::mutex mutex;
  std::unique_ptr<Linker> linker;
  std::vector<std::unique_ptr<Worker>> idle;
  PhaseTimes totals = {};
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_COMPILE_COMPILER_H
