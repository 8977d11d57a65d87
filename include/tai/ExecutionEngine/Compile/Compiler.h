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
  /// The compile options as text, for the key of the cache of object code.
  std::string str() const;
};

/// Steps of a compilation, for the compile-time profile.
enum class Phase { Cache, Autodiff, Lower, Translate, Optimize, Emit, Link };
constexpr unsigned kNumPhases = 7;
StringRef stringifyPhase(Phase phase);

/// The seconds spent in each phase of a compilation.
using PhaseTimes = std::array<double, kNumPhases>;

/// Persistent storage of compiled objects, as functions of its owner that are
/// called from any thread.
struct ObjectCache {
  /// Returns the bytes stored under a key, or none. Damaged entries are never
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

/// Describes a function to compile, or one of its derivatives.
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

  /// The module that holds the function, its callees, and the trees and fields
  /// that it uses. The compiler does not modify the module.
  ModuleOp module;
  StringRef name;
  Goal goal;
  /// Requests the forward-mode variant instead: the function with tangents.
  bool forward = false;
};

class Compiler {
public:
  /// Functions that build the pass pipelines. Each pipeline is run by one
  /// thread at a time.
  struct Pipelines {
    std::function<void(OpPassManager &, const CompileOptions &, bool zeroes)>
        autodiff;
    /// Adds passes that extend all kernels of a module by tangents.
    std::function<void(OpPassManager &, const CompileOptions &)> forward;
    std::function<void(OpPassManager &, const CompileOptions &)> toLLVM;
    /// Lowers a kernel for a device: like toLLVM, but also leaves a
    /// `gpu.module` with the device code.
    std::function<void(OpPassManager &, const CompileOptions &)> toDevice;
    /// The names of the passes whose output is the stage "scf", without and
    /// with a device.
    std::string scfPass, deviceScfPass;
  };

  /// Creates a compiler. loadDialects() must be called before several threads
  /// use the context.
  Compiler(MLIRContext *context, Pipelines pipelines,
           ArrayRef<runtime::RuntimeSymbol> runtime);
  ~Compiler();

  /// Loads into the context the dialects that the pipelines depend on.
  void loadDialects();

  void setCache(ObjectCache cache) { this->cache = std::move(cache); }
  /// Sets the device's assembler, which compiling threads call; may be null.
  void setAssembler(runtime::DeviceAssembler assembler) {
    this->assembler = std::move(assembler);
  }

  struct Function {
    /// The address of the compiled function. Null for an adjoint without
    /// effects.
    void *address = nullptr;
    Linker::Library *library = nullptr;
    /// The names of the trees whose base addresses the function takes, in the
    /// order of its arguments.
    std::vector<std::string> trees;
    /// As in CompiledObject.
    SkipAmounts skipped{};
    std::vector<int64_t> loopLevels;
    std::vector<std::string> storesFirst;
    std::vector<Warning> warnings;
    /// The code of the device functions that the function launches, if any.
    std::shared_ptr<const runtime::DeviceImage> image;
    bool fromCache = false;
    PhaseTimes times = {};
    /// The interpreter that the code at `address` calls, if the function is
    /// interpreted.
    std::shared_ptr<const Interpreter> interpreter;
  };

  /// Loads the function from the cache or compiles it, and links it.
  /// Thread-safe.
  std::optional<Function> compile(CompileRequest request,
                                  const CompileOptions &options,
                                  Failure &failure);

  /// The state between the two steps of a compilation, prepare and finish.
  /// After prepare, the values that an adjoint needs recorded (ToBeRecorded)
  /// are known; on a cache hit, only linking remains.
  struct Prepared {
    /// The step that the compilation has reached, or in which it has failed.
    enum class Step { Autodiff, Forward, Lower, Code };
    Step step = Step::Autodiff;
    std::string key;
    /// The compiled object, if it came from the cache.
    std::optional<CompiledObject> object;
    /// If no object came from the cache: the differentiated module, and the
    /// symbol of its entry point.
    OwningOpRef<ModuleOp> module;
    std::string symbol;
    std::string toBeRecorded;
    SkipAmounts skipped{};
    std::vector<Warning> warnings;
    PhaseTimes times = {};
    /// The claim that makes other processes wait for the compiled object.
    std::shared_ptr<void> claim;
  };
  /// Does the first step of a compilation. With `claims`, `finish` must follow
  /// at once, because other processes wait for the object.
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

  /// Unlinks a compiled function, which must not be running.
  void unload(const Function &function);
  /// The number of objects that are linked and not freed.
  int64_t numLinked() const { return linker ? linker->numLinked() : 0; }

  /// Prints the IR at a stage of the compilation: "tai", "autodiff", "scf",
  /// "llvm", "llvmir", "asm"; with a device also its code, "nvvm" and "ptx".
  /// The stage "autodiff" can include the source locations of its operations.
  std::optional<std::string> print(CompileRequest request, StringRef stage,
                                   const CompileOptions &options,
                                   Failure &failure, bool withPlaces = false);
  static ArrayRef<StringRef> getStages();
  /// Whether a stage exists only with a device.
  static bool isDeviceStage(StringRef stage) {
    return stage == "nvvm" || stage == "ptx";
  }

  /// The seconds spent in each compile phase since the start, summed over all
  /// threads.
  PhaseTimes getTotals();

private:
  struct Worker;
  class WorkerLease;

  /// Loads the compiled object from the cache, if it is there.
  void load(Prepared &prepared, CompileRequest request);
  /// Loads the compiled object from the cache after waiting for another process
  /// that is making it, or else claims the right to make it. Fails where the
  /// wait was interrupted.
  LogicalResult claimOrLoad(Prepared &prepared, CompileRequest request,
                            Failure &failure);
  /// The differentiation step.
  LogicalResult start(CompileRequest request, const CompileOptions &options,
                      Prepared &prepared, Failure &failure);
  /// Links a compiled object into the process; on failure, sets `failure`.
  LogicalResult link(const CompiledObject &object, StringRef name,
                     Function &function, Failure &failure);
  std::optional<CompiledObject> makeObject(CompileRequest request,
                                           const CompileOptions &options,
                                           Prepared &prepared,
                                           Failure &failure);
  /// Makes the module that is lowered: for an adjoint, by differentiation.
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
  /// Takes the device code out of a lowered module, and compiles it to an
  /// image.
  LogicalResult compileDeviceCode(Worker &worker, const CompileOptions &options,
                                  Prepared &prepared,
                                  std::optional<runtime::DeviceImage> &image,
                                  Failure &failure);
  /// Prints a stage of compilation after the LLVM dialect: LLVM IR or assembly.
  std::optional<std::string> printCode(Worker &worker, Prepared &prepared,
                                       StringRef stage,
                                       const CompileOptions &options,
                                       Failure &failure);
  /// Replaces the kernels of a module by their forward-mode variants.
  LogicalResult extendByTangents(Worker &worker, CompileRequest request,
                                 Prepared &prepared, Failure &failure);
  /// Returns a digest of the request's module including its source locations.
  static std::string getPlaces(CompileRequest request);
  std::string getKey(CompileRequest request, const CompileOptions &options);
  /// Returns the cache key of a program fused from several device kernels,
  /// given as LLVM IR.
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
