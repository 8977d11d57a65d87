//===- MakeAdjoint.cpp - Adjoint kernels ----------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Selects the functions to differentiate, makes the shell of each adjoint and
// lets AdjointBuilder fill it. The primal is not changed.
//
//===----------------------------------------------------------------------===//

#include "../SelectedFunctionsPass.h"
#include "StoredOutputs.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlow.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Conventions.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/AD/Foreign/Traces.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/AD/Prepare/SpectralForms.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/AD/Reverse/AdjointPlanner.h"
#include "tai/AD/Signature.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Cost.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Support/SilencedDiagnostics.h"

namespace mlir::tai {
#define GEN_PASS_DEF_MAKEADJOINT
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Returns the function type of the adjoint: the arguments of `function`, then
/// the memrefs of adjoints; no results.
static FunctionType getAdjointType(FunctionOpInterface function,
                                   const AdjointSignature &signature) {
  SmallVector<Type> inputs(function.getArgumentTypes());
  llvm::append_range(inputs, signature.getShadowTypes(function));
  return FunctionType::get(function.getContext(), inputs, {});
}

/// Creates the adjoint of `function` without a body, next to `function`.
static FunctionOpInterface createShell(FunctionOpInterface function,
                                       StringRef name,
                                       const AdjointSignature &signature) {
  OpBuilder builder(function.getContext());
  builder.setInsertionPointAfter(function);
  FunctionType type = getAdjointType(function, signature);
  if (auto kernel = dyn_cast<KernelOp>(function.getOperation())) {
    auto adjoint = KernelOp::create(builder, function.getLoc(), name, type);
    adjoint.setModesAttr(kernel.getModesAttr());
    return adjoint;
  }
  auto shell = func::FuncOp::create(builder, function.getLoc(), name, type);
  shell.addEntryBlock();
  return shell;
}

/// Makes accumulations into adjoints of arrays non-atomic where no other
/// iteration can reach the element.
static void relaxArrayAccumulations(FunctionOpInterface function) {
  llvm::MapVector<std::pair<Operation *, Value>, SmallVector<Operation *>>
      groups;
  function.walk([&](Operation *op) {
    if (!isa<memref::AtomicRMWOp, memref::StoreOp>(op))
      return;
    Value memref =
        cast<DifferentiableAccessInterface>(op).getAccessedStorage().memref;
    if (isa<BlockArgument>(memref) || memref.getDefiningOp<memref::AllocOp>())
      groups[{getOutermostParallelLoop(op), memref}].push_back(op);
  });
  for (auto &[key, writes] : groups) {
    bool exclusive = isExclusive(writes);
    for (Operation *write : writes) {
      auto atomic = dyn_cast<memref::AtomicRMWOp>(write);
      if (!exclusive || !atomic ||
          atomic.getKind() != arith::AtomicRMWKind::addf)
        continue;
      OpBuilder builder(atomic);
      Value old = memref::LoadOp::create(
          builder, atomic.getLoc(), atomic.getMemref(), atomic.getIndices());
      Value sum = arith::AddFOp::create(builder, atomic.getLoc(), old,
                                        atomic.getValue());
      memref::StoreOp::create(builder, atomic.getLoc(), sum, atomic.getMemref(),
                              atomic.getIndices());
      atomic.erase();
    }
  }
}

/// True if some field that the function accesses lies below a sparse level.
static bool reachesSparse(FunctionOpInterface function) {
  WalkResult result = function->walk([](Operation *op) {
    FlatSymbolRefAttr name = getNamedField(op);
    FieldOp field = name ? lookupField(op, name) : FieldOp();
    FailureOr<FieldLayout> layout =
        field ? getFieldLayout(field) : FailureOr<FieldLayout>(failure());
    return succeeded(layout) && layout->path.getFirstSparse()
               ? WalkResult::interrupt()
               : WalkResult::advance();
  });
  return result.wasInterrupted();
}

static void clearBody(FunctionOpInterface shell) {
  Block &body = shell.getFunctionBody().front();
  body.dropAllReferences();
  body.getOperations().clear();
}

/// Placeholders for the adjoints of arrays that a function allocates, until the
/// adjoints are allocated.
class OwnAdjoints {
public:
  OwnAdjoints(FunctionOpInterface function, DenseMap<Value, Value> &arrays) {
    if (!isa<func::FuncOp>(function.getOperation()))
      return;
    function.walk([&](Operation *op) {
      if (!isa<memref::AllocOp, memref::AllocaOp>(op) ||
          !getShadowType(op->getResult(0).getType()))
        return;
      OpBuilder builder(op->getContext());
      Operation *standIn = memref::AllocaOp::create(
          builder, op->getLoc(), MemRefType::get({}, builder.getF32Type()));
      arrays[op->getResult(0)] = standIn->getResult(0);
      standIns.push_back(standIn);
    });
  }
  ~OwnAdjoints() {
    for (Operation *op : standIns)
      op->destroy();
  }

private:
  SmallVector<Operation *> standIns;
};

static LogicalResult fillWith(FunctionOpInterface function,
                              FunctionOpInterface shell,
                              const AdjointSignature &signature,
                              const AdjointOptions &options, bool *needsParts,
                              LocalMemory local = LocalMemory()) {
  DenseMap<Value, Value> arrays;
  ValueShadows values;
  unsigned next = function.getNumArguments();
  for (unsigned position : signature.arguments) {
    BlockArgument argument = function.getArgument(position);
    Value shadow = shell.getArgument(next++);
    if (isa<MemRefType>(argument.getType())) {
      arrays[argument] = shadow;
      continue;
    }
    values.inputs.push_back(argument);
    values.inputShadows.push_back(shadow);
  }
  Operation *end = function.getFunctionBody().front().getTerminator();
  for (unsigned position : signature.results) {
    values.outputs.push_back(end->getOperand(position));
    values.outputShadows.push_back(shell.getArgument(next++));
  }
  auto adjointOf = [&](Storage storage) -> Storage {
    if (storage.memref)
      return arrays.lookup(storage.memref);
    FieldOp field = lookupField(function, storage.field);
    return field.getAdjointAttr() && isFloatOrVector(field.getType())
               ? Storage(field.getAdjointAttr())
               : Storage();
  };
  OwnAdjoints own(function, arrays);
  if (isa<func::FuncOp>(function.getOperation()))
    local.setAdjoint = [&](Value array, Value adjoint) {
      arrays[array] = adjoint;
    };
  AdjointPlanner planner(function, adjointOf, values, options);
  SmallVector<Value> records;
  for (auto &[argument, record] : local.records)
    records.push_back(record);
  planner.setLocalMemory(std::move(local));
  const AdjointPlan &plan = planner.getPlan();
  if (failed(verifyReversible(plan)))
    return failure();
  // Only an emitted adjoint shows which operations it has to execute forward
  // again: emit the adjoint until the plan has them all.
  while (true) {
    AdjointBuilder builder(shell, plan);
    LogicalResult built = builder.build();
    const PrimalDemands &demands = builder.getDemands();
    FailureOr<bool> fits = failure();
    if (succeeded(built))
      fits = planner.settle(demands);
    if (needsParts)
      *needsParts = demands.parts || planner.needsParts();
    if (failed(fits))
      return failure();
    if (options.loadsStored &&
        !(*fits && planner.findsStored(demands.stored.getArrayRef())))
      return failure();
    if (*fits) {
      if (!options.loadsStored) {
        countSkips(plan, demands);
        warnOfActiveFactors(function,
                            [&](Value v) { return plan.activity.isActive(v); });
      }
      break;
    }
    if (plan.local.histories)
      plan.local.histories->clear();
    clearBody(shell);
  }
  dropForms(shell);
  planner.annotate(shell);
  OpBuilder builder = OpBuilder::atBlockEnd(&shell.getFunctionBody().front());
  for (Value record : records)
    memref::DeallocOp::create(builder, function.getLoc(), record);
  if (isa<KernelOp>(shell.getOperation()))
    ReturnOp::create(builder, function.getLoc(), ValueRange());
  else
    func::ReturnOp::create(builder, function.getLoc());
  // The primal kernel decides which cells are active: writes of its adjoint
  // activate none.
  if (auto kernel = dyn_cast<KernelOp>(shell.getOperation());
      kernel && reachesSparse(shell))
    kernel.setKeepsActivity(true);
  noteGuards(shell);
  markExclusiveAtomics(shell);
  splitAdjointZeroing(shell);
  relaxArrayAccumulations(shell);
  return success();
}

/// Refuses side effects that a second execution of the function would repeat.
static LogicalResult checkRunsAgain(FunctionOpInterface function) {
  auto isOwn = [&](Value array) {
    auto argument = dyn_cast<BlockArgument>(array);
    return argument
               ? argument.getOwner()->getParentOp() == function
               : isa<memref::AllocOp, memref::AllocaOp>(array.getDefiningOp());
  };
  WalkResult result = function->walk([&](Operation *op) {
    if (op == function || op->getNumRegions() != 0 ||
        op->hasTrait<OpTrait::IsTerminator>() || isMemoryEffectFree(op) ||
        hasSingleEffect<MemoryEffects::Read>(op) ||
        isa<memref::AllocOp, memref::AllocaOp>(op))
      return WalkResult::advance();
    if (auto store = dyn_cast<memref::StoreOp>(op);
        store && isOwn(store.getMemref()))
      return WalkResult::advance();
    if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op);
        atomic && isOwn(atomic.getMemref()))
      return WalkResult::advance();
    if (auto dealloc = dyn_cast<memref::DeallocOp>(op);
        dealloc && isOwn(dealloc.getMemref()) &&
        !isa<BlockArgument>(dealloc.getMemref()))
      return WalkResult::advance();
    InFlightDiagnostic diag =
        op->emitError("the gradient has to run this function again, and '")
        << op->getName() << "' would happen twice";
    diag.attachNote(function->getLoc())
        << "it overwrites values that the gradient needs, or keeps them in "
           "arrays of its own";
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

/// Erases the body of a function, and its arguments from `count` on.
static void clearFunction(FunctionOpInterface shell, unsigned count) {
  clearBody(shell);
  Block &body = shell.getFunctionBody().front();
  body.eraseArguments(count, body.getNumArguments() - count);
}

/// The augmented function returns records as additional results: adds an
/// argument for each record to the adjoint `shell`.
static void passRecords(Traces &traces, FunctionOpInterface shell) {
  Block &body = shell.getFunctionBody().front();
  for (auto &[argument, record] : traces.arrays)
    record = body.addArgument(record.getType(), record.getLoc());
}

/// The bytes that a derivative may take for copies and records, and those that
/// it takes; none if the size of a record depends on the arguments.
struct TraceBudget {
  uint64_t limit = 0;
  std::optional<uint64_t> taken = 0;

  /// Adds the size of `array`, which is a constant if all trip counts are.
  void add(memref::AllocOp array) {
    std::optional<uint64_t> bytes = getAllocatedBytes(array);
    if (taken && bytes)
      *taken += *bytes;
    else
      taken.reset();
  }
  bool isExceeded() const { return !taken || *taken > limit; }
};

/// Returns the budget of `function`, without the bytes that it takes.
static std::optional<TraceBudget> getTraceBudget(FunctionOpInterface function) {
  auto limit =
      getOriginal(function)->getAttrOfType<IntegerAttr>("tai.trace_bytes");
  if (!limit)
    return std::nullopt;
  return TraceBudget{limit.getValue().getZExtValue()};
}

/// Marks arrays that are copies or records, while others are made.
constexpr StringLiteral kCounted = "tai.counted";

/// Returns the copies and records of the derivative `shell`: the marked arrays,
/// and `histories`.
static SmallVector<Value> takeCounted(FunctionOpInterface shell,
                                      ArrayRef<Value> histories) {
  SmallVector<Value> arrays;
  shell.walk([&](memref::AllocOp array) {
    if (array->removeAttr(kCounted) ||
        llvm::is_contained(histories, array.getResult()))
      arrays.push_back(array);
  });
  return arrays;
}

/// Refuses a derivative whose traces take more bytes than the function allows.
static LogicalResult refuseTraces(FunctionOpInterface function,
                                  const TraceBudget &budget,
                                  ArrayRef<Location> reads) {
  InFlightDiagnostic diag = function.emitError("cannot differentiate '@")
                            << getOriginal(function).getName()
                            << "' within 'tai.trace_bytes' of " << budget.limit
                            << ": ";
  if (budget.taken)
    diag << "the copies and records of the derivative take " << *budget.taken
         << " bytes";
  else
    diag << "the size of a record depends on the arguments";
  for (Location read : reads)
    diag.attachNote(read)
        << "the value read here is recorded, because it is overwritten; a "
           "store to another array keeps it";
  return diag;
}

/// Fills the adjoint of a function of arrays. Values that the function
/// overwrites or frees are recorded by a second execution in the adjoint, or by
/// the function `augmented` unless that is null.
static LogicalResult
fillFunction(FunctionOpInterface function, FunctionOpInterface shell,
             const AdjointSignature &signature, const AdjointOptions &options,
             bool recordsAll, FunctionOpInterface augmented) {
  // Reads are identified by their numbers in program order, because each
  // attempt works on a copy of its own.
  llvm::SetVector<unsigned> numbers;
  std::optional<TraceBudget> budget = getTraceBudget(function);
  int64_t historyBytes = options.historyBytes;
  unsigned numArguments = shell.getNumArguments();
  while (true) {
    FunctionOpInterface copy = function;
    if (augmented) {
      clearFunction(augmented, function.getNumArguments());
      clearFunction(shell, numArguments);
    }
    OwningOpRef<func::FuncOp> owner;
    if (!numbers.empty()) {
      OpBuilder builder(function->getContext());
      builder.setInsertionPointAfter(function);
      owner = cast<func::FuncOp>(builder.clone(*function));
      copy = cast<FunctionOpInterface>(owner->getOperation());
    }
    DenseMap<Operation *, unsigned> numberOf;
    SmallVector<Operation *> reads;
    copy.walk([&](Operation *op) {
      unsigned number = numberOf.size();
      numberOf[op] = number;
      if (numbers.contains(number))
        reads.push_back(op);
    });
    LocalMemory local;
    llvm::SetVector<Operation *> missing;
    local.toRecord = &missing;
    local.recordsAll = recordsAll || !numbers.empty();
    SmallVector<int64_t> before;
    SmallVector<Location> places;
    for (Operation *read : reads)
      places.push_back(read->getLoc());
    SmallVector<Value> records, histories;
    AdjointOptions adjusted = options;
    adjusted.historyBytes = historyBytes;
    if (budget) {
      local.histories = &histories;
      budget->taken = 0;
    }
    if (augmented) {
      Traces traces = recordReads(copy, augmented, reads, TraceMode::Augmented);
      if (budget)
        augmented.walk([&](memref::AllocOp array) { budget->add(array); });
      if (budget && budget->isExceeded())
        return refuseTraces(function, *budget, places);
      passRecords(traces, shell);
      local.recorded = std::move(traces.recorded);
      local.records = std::move(traces.arrays);
    } else if (!reads.empty()) {
      if (failed(checkRunsAgain(copy)))
        return failure();
      Traces traces = recordReads(copy, shell, reads);
      if (budget)
        shell.walk([&](memref::AllocOp array) {
          array->setAttr(kCounted, UnitAttr::get(array.getContext()));
        });
      for (auto &[argument, array] : traces.arrays)
        records.push_back(array);
      local.recorded = std::move(traces.recorded);
      local.records = std::move(traces.arrays);
      before = std::move(traces.before);
    }
    // Diagnostics are held back, since an attempt that lacks values is
    // repeated.
    std::vector<Diagnostic> said;
    LogicalResult filled = failure();
    {
      ScopedDiagnosticHandler handler(
          function->getContext(),
          [&, thread = llvm::get_threadid()](Diagnostic &diagnostic) {
            if (llvm::get_threadid() != thread)
              return failure();
            said.push_back(std::move(diagnostic));
            return success();
          });
      filled = fillWith(copy, shell, signature, adjusted,
                        /*needsParts=*/nullptr, std::move(local));
    }
    auto report = [&] {
      for (Diagnostic &diagnostic : said)
        function->getContext()->getDiagEngine().emit(std::move(diagnostic));
    };
    if (succeeded(filled)) {
      report();
      SmallVector<Value> counted = takeCounted(shell, histories);
      for (Value array : counted)
        if (budget)
          budget->add(array.getDefiningOp<memref::AllocOp>());
      int64_t less = budget ? static_cast<int64_t>(budget->limit) / 2 : 0;
      if (budget && budget->isExceeded() && reads.empty() &&
          !histories.empty() && historyBytes > 0) {
        // Loops keep fewer of the values that they carry, and run again.
        historyBytes = historyBytes > less ? less : 0;
        clearBody(shell);
        continue;
      }
      llvm::append_range(records, histories);
      if (budget && budget->isExceeded() &&
          failed(divideTraces(shell, getOriginal(function).getName(), records,
                              counted, budget->limit)))
        return refuseTraces(function, *budget, places);
      if (!before.empty())
        shell->setAttr("tai.reads_before",
                       DenseI64ArrayAttr::get(function->getContext(), before));
      return success();
    }
    size_t known = numbers.size();
    for (Operation *read : missing)
      numbers.insert(numberOf.lookup(read));
    clearBody(shell);
    if (numbers.size() == known) {
      report();
      return failure();
    }
  }
}

/// Fills the adjoint `shell`. If `augmented`, an empty function with the
/// arguments of the primal, is given, it becomes the primal with additional
/// results: records of values that the adjoint needs. The adjoint gets the
/// records as additional arguments.
static LogicalResult fill(FunctionOpInterface function,
                          FunctionOpInterface shell,
                          const AdjointSignature &signature,
                          AdjointOptions options, bool *needsParts,
                          FunctionOpInterface augmented) {
  auto fillOnce = [&] {
    if (isa<func::FuncOp>(function.getOperation()))
      return fillFunction(function, shell, signature, options,
                          isWrapped(function) || augmented, augmented);
    return fillWith(function, shell, signature, options, needsParts);
  };
  if (!options.skips.has(Skip::InactiveValues)) {
    // The skip of inactive values is off, so they are differentiated like
    // active ones. If one of them has no derivative, the adjoint is made again
    // with the skip.
    SilencedDiagnostics silence(function.getContext());
    if (succeeded(fillOnce()))
      return success();
    clearBody(shell);
    options.skips.set(Skip::InactiveValues, true);
  }
  return fillOnce();
}

LogicalResult mlir::tai::fillAdjoint(FunctionOpInterface function,
                                     FunctionOpInterface shell,
                                     const AdjointSignature &signature,
                                     AdjointOptions options, bool *needsParts) {
  return fill(function, shell, signature, options, needsParts,
              /*augmented=*/nullptr);
}

/// Stores the estimated cost of the original loops in an attribute, which the
/// loops of the adjoint inherit.
static void fixCosts(FunctionOpInterface function) {
  // The assumed time of a gradient relative to the time of its primal.
  constexpr double perPrimal = 3;
  Builder builder(function.getContext());
  function->walk([&](ParallelForOp loop) {
    double cost = perPrimal * estimateNanoseconds(loop.getBody().front());
    loop.setFixedCostAttr(builder.getF64FloatAttr(cost));
  });
}

/// Warns that the gradient must be called with the arrays as they are before
/// the function runs.
static void warnOfBefore(FunctionOpInterface function, func::FuncOp gradient) {
  auto before = gradient->getAttrOfType<DenseI64ArrayAttr>("tai.reads_before");
  if (!before)
    return;
  InFlightDiagnostic diag =
      function->emitWarning("'@")
      << gradient.getName() << "' runs '@" << function.getName()
      << "' again, on copies: call it with the arrays as they are before '@"
      << function.getName() << "'";
  diag.attachNote() << "this concerns the arguments at the positions "
                    << before.asArrayRef();
}

namespace {
struct MakeAdjoint
    : SelectedFunctionsPass<MakeAdjoint, tai::impl::MakeAdjointBase> {
  using SelectedFunctionsPass::SelectedFunctionsPass;

  void getDependentDialects(DialectRegistry &registry) const override {
    SelectedFunctionsPass::getDependentDialects(registry);
    registry.insert<cf::ControlFlowDialect>();
  }
  LogicalResult begin() { return checkNested(getOperation()); }
  void end() { erasePrepared(getOperation()); }
  LogicalResult runOnFunction(FunctionOpInterface function) {
    return differentiate(function, getAnalysis<SymbolTable>());
  }

  AdjointOptions getOptions(bool zeroesAll, bool loadsStored) {
    return {zeroesAll, loadsStored, historyBytes, skip.getValue()};
  }

  /// Makes the stored form of the adjoint, which loads values that the kernel
  /// has stored, if it saves time. The adjoint refers to it in an attribute.
  void makeStoredForm(FunctionOpInterface function, KernelOp adjoint,
                      const AdjointSignature &signature, SymbolTable &symbols) {
    // The time in nanoseconds that loading stored values must save in an
    // iteration. A load saves nothing if other values need the recomputation as
    // well.
    constexpr double worthHaving = 4;
    std::string name = (adjoint.getName() + "_stored").str();
    if (symbols.lookup(name) || adjoint.getReexecutes() ||
        reachesSparse(function) ||
        StoredOutputs(function, AccessTable(function)).empty())
      return;
    auto shell =
        cast<KernelOp>(createShell(function, name, signature).getOperation());
    bool zeroes = adjoint.getZeroesAdjoint();
    // Diagnostics are suppressed, because the plain form of the adjoint has
    // emitted all of them.
    SilencedDiagnostics silence(&getContext());
    if (failed(fillAdjoint(function, shell, signature,
                           getOptions(zeroes, /*loadsStored=*/true))) ||
        shell.getReadsBeforeAttr() != adjoint.getReadsBeforeAttr() ||
        shell.getReexecutes() ||
        estimateNanoseconds(shell) + worthHaving >
            estimateNanoseconds(adjoint)) {
      shell.erase();
      return;
    }
    shell.setZeroesAdjoint(zeroes);
    shell->moveAfter(adjoint);
    symbols.insert(shell);
    adjoint.setStoredFormAttr(FlatSymbolRefAttr::get(&getContext(), name));
  }

  /// Reports an error if the derivative of a kernel, or of a function of
  /// tensors, is requested as two functions, which is not supported.
  LogicalResult checkSplits(FunctionOpInterface function,
                            FunctionOpInterface original) {
    if (isa<func::FuncOp>(function.getOperation()) && !isWrapped(function))
      return success();
    return original.emitError(
        "cannot split the derivative of this function; 'tai.split' is for a "
        "'func.func' of memrefs, numbers and vectors: run 'one-shot-bufferize' "
        "before, if it has tensors");
  }

  /// Gives the two functions of a derivative their types, and names them in the
  /// original.
  void finishSplit(func::FuncOp augmented, func::FuncOp reverse,
                   func::FuncOp original, SymbolTable &symbols) {
    Operation *exit = augmented.getBody().front().getTerminator();
    augmented.setFunctionType(
        FunctionType::get(&getContext(), augmented.getArgumentTypes(),
                          TypeRange(exit->getOperandTypes())));
    reverse.setFunctionType(FunctionType::get(
        &getContext(), reverse.getBody().getArgumentTypes(), {}));
    SmallVector<Attribute> names;
    for (func::FuncOp made : {augmented, reverse}) {
      symbols.insert(made);
      takeInterface(original, made);
      names.push_back(FlatSymbolRefAttr::get(made));
    }
    original->setAttr(kSplit, ArrayAttr::get(&getContext(), names));
  }

  LogicalResult differentiate(FunctionOpInterface function,
                              SymbolTable &symbols) {
    if (failed(Conventions::verify(function)) ||
        failed(checkIsFunction(function)))
      return failure();
    if (failed(checkHasOneBlock(function)))
      return failure();
    FunctionOpInterface original = getOriginal(function);
    if (original->hasAttr("tai.adjoint") || isSplit(original))
      return success();
    bool splits = original->hasAttr(kSplit);
    if (splits && failed(checkSplits(function, original)))
      return failure();
    std::string name =
        (original.getName() + (splits ? "_reverse" : "_grad")).str();
    std::string augmentedName = (original.getName() + "_augmented").str();
    Operation *taken = symbols.lookup(name);
    if (!taken && splits)
      taken = symbols.lookup(augmentedName);
    // Array arguments of a function always get adjoints. A kernel can have
    // fields with adjoints instead, so its arrays get them only with the
    // option.
    bool arrays = arrayAdjoints || !isa<KernelOp>(function.getOperation());
    FailureOr<AdjointSignature> signature =
        AdjointSignature::get(function, arrays);
    if (failed(signature))
      return failure();
    // A declaration of the adjoint, which is yet to be made, lets the module
    // call it.
    if (auto declared = dyn_cast_if_present<func::FuncOp>(taken);
        declared && declared.isExternal() &&
        declared.getFunctionType() == getAdjointType(function, *signature)) {
      symbols.erase(declared);
      taken = nullptr;
    }
    if (taken) {
      InFlightDiagnostic diag = function.emitError()
                                << "cannot make the adjoint '@"
                                << SymbolTable::getSymbolName(taken).getValue()
                                << "': the name is taken";
      diag.attachNote(taken->getLoc()) << "by this";
      return diag;
    }
    FunctionOpInterface shell = createShell(function, name, *signature);
    bool zeroesAll = zeroOverwritten && isa<KernelOp>(function.getOperation());
    if (zeroesAll)
      cast<KernelOp>(shell.getOperation()).setZeroesAdjoint(true);
    if (hasFixedBits(function))
      fixCosts(function);
    SpectralForms forms(function);
    func::FuncOp augmented;
    auto fail = [&] {
      shell.erase();
      if (augmented)
        augmented.erase();
      return failure();
    };
    if (splits) {
      OpBuilder builder(shell);
      augmented =
          func::FuncOp::create(builder, function.getLoc(), augmentedName,
                               cast<FunctionType>(function.getFunctionType()));
      augmented.addEntryBlock();
    }
    if (failed(::fill(function, shell, *signature,
                      getOptions(zeroesAll, /*loadsStored=*/false),
                      /*needsParts=*/nullptr, augmented)))
      return fail();
    auto positions = function->getAttrOfType<DenseI64ArrayAttr>(
        getFunctionAttrName(function, kGradients));
    if (isa<func::FuncOp>(function.getOperation()) && !isWrapped(function) &&
        failed(checkHasDerivative(function, positions ? positions.asArrayRef()
                                                      : ArrayRef<int64_t>())))
      return fail();
    if (splits) {
      finishSplit(augmented, cast<func::FuncOp>(shell.getOperation()),
                  cast<func::FuncOp>(original.getOperation()), symbols);
      return success();
    }
    symbols.insert(shell);
    if (auto made = dyn_cast<func::FuncOp>(shell.getOperation())) {
      if (isWrapped(function)) {
        symbols.remove(made);
        made = wrapDerivative(cast<func::FuncOp>(original.getOperation()), made,
                              /*isForward=*/false);
        symbols.insert(made);
      }
      takeInterface(cast<func::FuncOp>(original.getOperation()), made);
      warnOfBefore(original, made);
    }
    if (auto adjoint = dyn_cast<KernelOp>(shell.getOperation());
        adjoint && storedOutputs)
      makeStoredForm(function, adjoint, *signature, symbols);
    auto reference = FlatSymbolRefAttr::get(&getContext(), name);
    if (auto kernel = dyn_cast<KernelOp>(function.getOperation()))
      kernel.setAdjointAttr(reference);
    else
      original->setAttr("tai.adjoint", reference);
    return success();
  }
};
} // namespace
