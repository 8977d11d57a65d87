//===- FuseLaunches.cpp - Loop fusion across launches ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Two kernels of one parallel loop each, over the same box, are fused if an
// iteration of the second reads only elements that the same iteration of the
// first wrote, and overwrites none that another one still reads. Indices are
// compared as sums of induction variables and arguments; arguments of both
// launches are related by the arithmetic of the host function.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/SymbolTable.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_FUSELAUNCHES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Candidates for fusion
//===----------------------------------------------------------------------===//

namespace {
/// A launch that can be fused: its kernel is one parallel loop.
struct Candidate {
  LaunchOp launch;
  KernelOp kernel;
  LoopBox box;
  /// The loads, stores and atomic updates in the body of the kernel's loop.
  SmallVector<Operation *> accesses;
};
} // namespace

static bool isDense(Operation *user, FlatSymbolRefAttr name) {
  FieldOp field = lookupField(user, name);
  FailureOr<FieldLayout> layout =
      field ? getFieldLayout(field) : FailureOr<FieldLayout>(failure());
  return succeeded(layout) && !layout->path.getFirstSparse();
}

/// Collects the accesses of the loop to dense fields; false if the loop has
/// effects other than these.
static bool collectAccesses(ParallelForOp loop,
                            SmallVectorImpl<Operation *> &accesses) {
  return !loop.getBody()
              .walk([&](Operation *op) {
                if (isa<LoadOp, StoreOp, AtomicOp>(op)) {
                  accesses.push_back(op);
                  return isDense(op, getNamedField(op))
                             ? WalkResult::advance()
                             : WalkResult::interrupt();
                }
                // Local variables belong to one iteration, so accesses to them
                // have no effect outside of it.
                if (isa<AllocaOp, LocalLoadOp, LocalStoreOp, scf::ForOp,
                        scf::IfOp, scf::WhileOp>(op))
                  return WalkResult::advance();
                return op->getNumRegions() == 0 && isMemoryEffectFree(op)
                           ? WalkResult::advance()
                           : WalkResult::interrupt();
              })
              .wasInterrupted();
}

static std::optional<Candidate> getCandidate(LaunchOp launch,
                                             SymbolTable &symbols) {
  auto kernel = symbols.lookup<KernelOp>(launch.getKernel());
  // Launches under a tape are not fused, because they are differentiated one by
  // one.
  if (!kernel || kernel.isExternal() || launch.getNumResults() != 0 ||
      launch->getParentWithTrait<RecordsLaunches>() ||
      llvm::any_of(kernel.getArgumentTypes(),
                   [](Type type) { return isa<MemRefType>(type); }))
    return std::nullopt;
  ParallelForOp loop;
  for (Operation &op : kernel.getBody().front().without_terminator()) {
    if (auto found = dyn_cast<ParallelForOp>(op); found && !loop)
      loop = found;
    else if (op.getNumRegions() != 0 || !isMemoryEffectFree(&op))
      return std::nullopt;
  }
  if (!loop || loop.getSerialize())
    return std::nullopt;
  std::optional<LoopBox> box = getConstantBox(loop);
  if (!box)
    return std::nullopt;
  Candidate candidate{launch, kernel, *box, {}};
  if (!collectAccesses(loop, candidate.accesses))
    return std::nullopt;
  return candidate;
}

//===----------------------------------------------------------------------===//
// Legality
//===----------------------------------------------------------------------===//

static ValueRange getIndices(Operation *access) {
  return llvm::TypeSwitch<Operation *, ValueRange>(access)
      .Case<LoadOp, StoreOp, AtomicOp>([](auto op) { return op.getIndices(); });
}

/// Returns the index form with the operands of the launch in place of the
/// kernel's arguments, and `ivs` in place of its induction variables.
static IndexExpr translate(const IndexExpr &form, Candidate &from,
                           ValueRange ivs) {
  return form.substitute([&](Value value) -> std::optional<IndexExpr> {
    if (std::optional<unsigned> d = from.box.find(value))
      return IndexExpr(ivs[*d]);
    auto argument = dyn_cast<BlockArgument>(value);
    if (!argument || argument.getOwner() != &from.kernel.getBody().front())
      return std::nullopt;
    Value passed = from.launch.getOperands()[argument.getArgNumber()];
    IndexExpr expr = getIndexExpr(passed);
    return expr.isExact() ? expr : IndexExpr(passed);
  });
}

static bool isSum(Operation *access) {
  auto atomic = dyn_cast<AtomicOp>(access);
  return atomic && atomic.getOld().use_empty() &&
         (atomic.getKind() == AtomicKind::Add ||
          atomic.getKind() == AtomicKind::Sub);
}

/// True if the accesses `a` and `b` never reach one element in different
/// iterations of the two loops, or if their order does not matter.
static bool areIndependent(Candidate &first, Operation *a, Candidate &second,
                           Operation *b) {
  if (getStorageKey(a) != getStorageKey(b) ||
      (isa<LoadOp>(a) && isa<LoadOp>(b)))
    return true;
  if (isSum(a) && isSum(b)) {
    Type type = getElementTypeOrSelf(cast<AtomicOp>(a).getValue().getType());
    if (!isa<FloatType>(type) || !hasFixedBits(a))
      return true;
  }
  ValueRange ivs = second.box.loop.getInductionVars();
  SmallVector<IndexExpr> common;
  for (auto [x, y] : llvm::zip(getIndices(a), getIndices(b))) {
    IndexExpr one = translate(getIndexExpr(x), first, ivs);
    IndexExpr other = translate(getIndexExpr(y), second, ivs);
    if (one == other) {
      common.push_back(one);
      continue;
    }
    // If the two indices differ and depend on no loop index, they differ in all
    // pairs of iterations.
    bool isFixed =
        one.allOf([&](Value value) { return !llvm::is_contained(ivs, value); });
    if (isFixed && areDistinct(one, other))
      return true;
  }
  // A dimension with one iteration need not tell iterations apart, so it is
  // left out.
  SmallVector<Value> running;
  for (auto [d, iv] : llvm::enumerate(ivs))
    if (second.box.upper[d] - second.box.lower[d] > 1)
      running.push_back(iv);
  return running.empty() || isInjectiveOver(common, running);
}

static bool canFuse(Candidate &first, Candidate &second) {
  if (first.box.lower != second.box.lower ||
      first.box.upper != second.box.upper ||
      first.box.loop.getBlockDim() != second.box.loop.getBlockDim() ||
      !(Modes::of(first.kernel) == Modes::of(second.kernel)))
    return false;
  for (Operation *a : first.accesses)
    for (Operation *b : second.accesses)
      if (!areIndependent(first, a, second, b))
        return false;
  return true;
}

//===----------------------------------------------------------------------===//
// Fusion
//===----------------------------------------------------------------------===//

namespace {
/// Describes an argument of the second kernel in the fused kernel: an argument
/// of the fused kernel plus a constant.
struct Source {
  unsigned argument;
  int64_t difference = 0;
};
} // namespace

/// Finds an operand of the new launch for an operand of the second launch. An
/// operand that differs by a constant from one in `operands` is computed from
/// that one, so that common accesses of both kernels are recognised.
static Source getSource(Value operand, SmallVectorImpl<Value> &operands) {
  for (auto [i, known] : llvm::enumerate(operands)) {
    if (known == operand)
      return {static_cast<unsigned>(i)};
    if (known.getType() != operand.getType() ||
        !operand.getType().isIntOrIndex() || operand.getType().isInteger(1))
      continue;
    IndexExpr one = getIndexExpr(known), other = getIndexExpr(operand);
    IndexExpr difference = other;
    difference.add(one, -1);
    if (difference.isConstant() &&
        (difference.isExact() || operand.getType().isInteger(difference.width)))
      return {static_cast<unsigned>(i), difference.constant};
  }
  operands.push_back(operand);
  return {static_cast<unsigned>(operands.size() - 1)};
}

/// Loads of elements that the same iteration has just stored become the stored
/// value.
static void reuseStoredValues(Block &body) {
  SmallVector<LoadOp> loads;
  body.walk([&](LoadOp load) { loads.push_back(load); });
  for (LoadOp load : loads) {
    Operation *here = body.findAncestorOpInBlock(*load);
    const void *storage = getStorageKey(load);
    auto writes = [&](Operation *op) {
      return op
          ->walk([&](Operation *inner) {
            return isa<StoreOp, AtomicOp>(inner) &&
                           getStorageKey(inner) == storage
                       ? WalkResult::interrupt()
                       : WalkResult::advance();
          })
          .wasInterrupted();
    };
    if (here != load && writes(here))
      continue;
    Operation *last = here->getPrevNode();
    while (last && !writes(last))
      last = last->getPrevNode();
    auto store = dyn_cast_if_present<StoreOp>(last);
    if (!store || store.getValue().getType() != load.getResult().getType() ||
        !areProvablyEqual(store.getIndices(), load.getIndices()) ||
        !areProvablyEqual(store.getComponents(), load.getComponents()))
      continue;
    load.replaceAllUsesWith(store.getValue());
    load.erase();
  }
}

static LaunchOp fuse(Candidate &first, Candidate &second,
                     SymbolTable &symbols) {
  SmallVector<Value> operands;
  SmallVector<unsigned> ofFirst;
  for (Value operand : first.launch.getOperands()) {
    ofFirst.push_back(operands.size());
    operands.push_back(operand);
  }
  SmallVector<Source> sources =
      llvm::map_to_vector(second.launch.getOperands(), [&](Value operand) {
        return getSource(operand, operands);
      });

  MLIRContext *context = first.kernel.getContext();
  Location loc =
      FusedLoc::get(context, {first.kernel.getLoc(), second.kernel.getLoc()});
  OpBuilder builder(context);
  builder.setInsertionPointAfter(second.kernel);
  std::string name =
      (first.kernel.getSymName() + "_" + second.kernel.getSymName()).str();
  auto type = FunctionType::get(
      context, llvm::to_vector(TypeRange(ValueRange(operands))), {});
  auto kernel = KernelOp::create(builder, loc, name, type);
  Modes::of(first.kernel).setOn(kernel);
  symbols.insert(kernel);
  Block &body = kernel.getBody().front();
  builder.setInsertionPointToEnd(&body);

  IRMapping one, other;
  for (auto [argument, number] :
       llvm::zip(first.kernel.getArguments(), ofFirst))
    one.map(argument, body.getArgument(number));
  for (auto [argument, source] :
       llvm::zip(second.kernel.getArguments(), sources)) {
    Value value = body.getArgument(source.argument);
    if (source.difference != 0) {
      auto constant = arith::ConstantOp::create(
          builder, loc,
          builder.getIntegerAttr(value.getType(), source.difference));
      value = arith::AddIOp::create(builder, loc, value, constant);
    }
    other.map(argument, value);
  }
  // The fused kernel consists of the code before the loops, then one loop with
  // both bodies.
  for (Operation &op : second.kernel.getBody().front().without_terminator())
    if (&op != second.box.loop)
      builder.clone(op, other);
  ParallelForOp loop;
  for (Operation &op : first.kernel.getBody().front().without_terminator()) {
    Operation *copy = builder.clone(op, one);
    if (&op == first.box.loop)
      loop = cast<ParallelForOp>(copy);
  }
  ReturnOp::create(builder, loc, ValueRange());
  loop->setLoc(FusedLoc::get(
      context, {first.box.loop.getLoc(), second.box.loop.getLoc()}));
  Block &iteration = loop.getBody().front();
  builder.setInsertionPoint(iteration.getTerminator());
  for (auto [from, to] :
       llvm::zip(second.box.loop.getInductionVars(), loop.getInductionVars()))
    other.map(from, to);
  for (Operation &op : second.box.loop.getBody().front().without_terminator())
    builder.clone(op, other);
  // In the fused loop, several iterations may reach the element of an atomic
  // that was exclusive.
  loop.walk([](AtomicOp atomic) { atomic.setExclusive(false); });
  reuseStoredValues(iteration);

  builder.setInsertionPoint(second.launch);
  auto launch = LaunchOp::create(
      builder,
      FusedLoc::get(context, {first.launch.getLoc(), second.launch.getLoc()}),
      TypeRange(), kernel.getSymName(), operands);
  first.launch.erase();
  second.launch.erase();
  return launch;
}

namespace {
struct FuseLaunches : tai::impl::FuseLaunchesBase<FuseLaunches> {
  using Base::Base;

  void runOnOperation() override {
    ModuleOp module = getOperation();
    SymbolTable symbols(module);
    SmallVector<Block *> blocks;
    for (auto function : module.getOps<func::FuncOp>())
      function.walk([&](Block *block) { blocks.push_back(block); });
    for (Block *block : blocks)
      run(*block, symbols);
  }

  void run(Block &block, SymbolTable &symbols) {
    std::optional<Candidate> last;
    for (Operation &op : llvm::make_early_inc_range(block)) {
      auto launch = dyn_cast<LaunchOp>(op);
      if (!launch) {
        // Host arithmetic between the launches can also run before the first
        // launch.
        if (op.getNumRegions() != 0 || !isMemoryEffectFree(&op))
          last.reset();
        continue;
      }
      std::optional<Candidate> next = getCandidate(launch, symbols);
      if (!last || !next ||
          last->accesses.size() + next->accesses.size() > size_t(maxAccesses) ||
          !canFuse(*last, *next)) {
        last = std::move(next);
        continue;
      }
      KernelOp before = last->kernel;
      bool isTemporary = made.contains(before);
      LaunchOp fused = fuse(*last, *next, symbols);
      last = getCandidate(fused, symbols);
      made.insert(symbols.lookup(fused.getKernel()));
      ++numFused;
      // A fused kernel that was itself fused with another one is no longer
      // launched, and is erased.
      if (isTemporary) {
        made.erase(before);
        symbols.erase(before);
      }
    }
  }

  llvm::DenseSet<Operation *> made;
};
} // namespace
