//===- WarpLoop.cpp - Loops that one warp executes ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Thread n of the first warp runs the iterations 32 * k + n, k = 0, 1, ...: the
// threads execute additions to memory together, in an order fixed by their
// numbers (lib/DeviceLibrary/Ordered.cpp). All threads must reach each
// addition. So additions are moved out of branches, which then yield an
// address, or null, and a value; and in the last batch, threads without an
// iteration repeat the last iteration without its effects.
//
//===----------------------------------------------------------------------===//

#include "WarpLoop.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Dominance.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "mlir/Transforms/CSE.h"
#include "tai/Analysis/Reductions/OrderedAdditions.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Operations of the loop
//===----------------------------------------------------------------------===//

/// True for memory that is private to one iteration.
static bool isPrivate(Value pointer) {
  while (auto element = pointer.getDefiningOp<LLVM::GEPOp>())
    pointer = element.getBase();
  return pointer.getDefiningOp<LLVM::AllocaOp>() != nullptr;
}

/// True for an addition to memory that other iterations may add to, so that its
/// place in the order matters.
static bool isAddition(Operation *op) {
  auto update = dyn_cast<LLVM::AtomicRMWOp>(op);
  if (!update || isDoneByLoop(op) || !update.use_empty() ||
      isPrivate(update.getPtr()))
    return false;
  Type type = update.getVal().getType();
  return (type.isF32() || type.isF64()) &&
         (update.getBinOp() == LLVM::AtomicBinOp::fadd ||
          update.getBinOp() == LLVM::AtomicBinOp::fsub);
}

static bool containsAddition(Operation *op) {
  return op
      ->walk([](Operation *inner) {
        return isAddition(inner) ? WalkResult::interrupt()
                                 : WalkResult::advance();
      })
      .wasInterrupted();
}

/// True for an operation of a known kind, which cannot end the thread.
static bool isKnown(Operation *op) {
  auto canBeYielded = [](Type type) {
    return type.isIntOrIndexOrFloat() || isa<LLVM::LLVMPointerType>(type);
  };
  if (isa<LLVM::AllocaOp, AllocaOp>(op))
    return true;
  if (!llvm::all_of(op->getResultTypes(), canBeYielded))
    return false;
  // Sums that the loop keeps in registers are lowered later.
  if (isa<AtomicOp>(op))
    return isDoneByLoop(op);
  if (isa<LLVM::LoadOp, LLVM::StoreOp, LLVM::AtomicRMWOp, LLVM::AtomicCmpXchgOp,
          LocalLoadOp, LocalStoreOp, scf::IfOp, scf::ForOp, scf::WhileOp,
          scf::IndexSwitchOp, scf::YieldOp, scf::ConditionOp, YieldOp>(op))
    return true;
  return op->getNumRegions() == 0 && isMemoryEffectFree(op);
}

/// True if all threads of the warp can reach the additions together. Earlier
/// lowerings may have inserted code that prevents this, such as a bounds check
/// that fails.
static bool canComeTogether(ParallelForOp loop) {
  WalkResult result = loop.getBody().walk([](Operation *op) {
    return isKnown(op) ? WalkResult::advance() : WalkResult::interrupt();
  });
  return !result.wasInterrupted() && !findDivergence(loop, isAddition);
}

void tai::prepareWarpLoop(ParallelForOp loop) {
  // Equal addresses are computed once, so that they are one value.
  IRRewriter rewriter(loop.getContext());
  DominanceInfo dominance(loop);
  eliminateCommonSubExpressions(rewriter, dominance, loop);
}

WarpPart tai::emitWarpPart(OpBuilder &builder, ParallelForOp loop, Value thread,
                           Value count, RuntimeCalls &runtime) {
  Location loc = loop.getLoc();
  IndexMath math(builder, loc);
  WarpPart part;
  Value lanes;
  if (canComeTogether(loop)) {
    lanes = arith::IndexCastOp::create(builder, loc, builder.getIndexType(),
                                       runtime.call(builder, loc,
                                                    "tai_dev_ordered_lanes",
                                                    builder.getI32Type(), {}));
    part.lane = thread;
  } else {
    lanes = math.constant(1);
  }
  part.isHere = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::slt,
                                      thread, lanes);
  part.first = arith::SelectOp::create(builder, loc, part.isHere,
                                       math.constant(0), count);
  part.step = lanes;
  return part;
}

void tai::emitWarpBarrier(OpBuilder &builder, Location loc,
                          const WarpPart &part, RuntimeCalls &runtime) {
  auto branch = scf::IfOp::create(builder, loc, part.isHere);
  OpBuilder inside = branch.getThenBodyBuilder();
  runtime.call(inside, loc, "tai_dev_ordered_meet", Type(), {});
}

//===----------------------------------------------------------------------===//
// Additions
//===----------------------------------------------------------------------===//

namespace {
/// An addition to the element `offset` bytes after `base`, an address that is
/// null in threads that do not add.
struct Addition {
  Location loc;
  Value base;
  int64_t offset;
  Value value;
  ArrayAttr scope;
};

class AdditionOrder {
public:
  AdditionOrder(Block *body, Value isActive, bool inTurn, RuntimeCalls &runtime)
      : body(body), isActive(isActive), inTurn(inTurn), runtime(runtime) {}
  void process(Block *block);

private:
  /// The varying parts of an address: its base, its index and the width of an
  /// element. Addresses with equal keys differ by a constant.
  using Key = std::tuple<Value, Value, int64_t>;
  using Plans = llvm::SmallDenseMap<Value, Value>;
  static Key getKey(Value base, int64_t &distance);
  Addition take(LLVM::AtomicRMWOp update);
  SmallVector<Addition> takeFrom(Block *block);
  SmallVector<Addition> takeOut(scf::IfOp &branch);
  void emit(OpBuilder &builder, const Addition &addition, Plans &plans);
  void processPart(ArrayRef<Operation *> part);
  bool isForAll(Value value);

  Block *body;
  Value isActive;
  /// True if threads add to memory one after another.
  bool inTurn;
  /// Operations that even threads without an iteration execute.
  llvm::DenseSet<Operation *> forAll;
  RuntimeCalls &runtime;
};
} // namespace

/// Emits a null pointer, or a zero of another type.
static Value emitZero(OpBuilder &builder, Location loc, Type type) {
  if (isa<LLVM::LLVMPointerType>(type))
    return LLVM::ZeroOp::create(builder, loc, type);
  return arith::ConstantOp::create(builder, loc, builder.getZeroAttr(type));
}

/// Splits an address into an address that it is derived from, and the constant
/// distance in bytes.
static std::pair<Value, int64_t> splitAddress(Value address) {
  int64_t offset = 0;
  while (auto element = address.getDefiningOp<LLVM::GEPOp>()) {
    auto indices = element.getIndices();
    if (indices.size() != 1 || !element.getElemType().isIntOrFloat())
      break;
    int64_t index;
    if (auto constant = dyn_cast<IntegerAttr>(indices[0]))
      index = constant.getInt();
    else if (auto known = getConstantIntValue(cast<Value>(indices[0])))
      index = *known;
    else
      break;
    int64_t size =
        llvm::divideCeil(element.getElemType().getIntOrFloatBitWidth(), 8);
    if (!llvm::isInt<31>(index) || !llvm::isInt<31>(offset + index * size))
      break;
    offset += index * size;
    address = element.getBase();
  }
  return {address, offset};
}

/// Returns the varying parts of an address as its key; `distance` becomes the
/// constant distance of the address from these parts.
AdditionOrder::Key AdditionOrder::getKey(Value base, int64_t &distance) {
  distance = 0;
  auto element = base.getDefiningOp<LLVM::GEPOp>();
  if (!element || element.getIndices().size() != 1 ||
      !element.getElemType().isIntOrFloat())
    return {base, Value(), 0};
  auto index = dyn_cast<Value>(element.getIndices()[0]);
  if (!index)
    return {base, Value(), 0};
  auto [origin, offset] = splitAddress(element.getBase());
  distance = offset;
  return {origin, index, element.getElemType().getIntOrFloatBitWidth()};
}

Addition AdditionOrder::take(LLVM::AtomicRMWOp update) {
  OpBuilder builder(update);
  Value value = update.getVal();
  if (update.getBinOp() == LLVM::AtomicBinOp::fsub)
    value = arith::NegFOp::create(builder, update.getLoc(), value);
  auto [base, offset] = splitAddress(update.getPtr());
  Addition addition{update.getLoc(), base, offset, value,
                    update.getAliasScopesAttr()};
  update.erase();
  return addition;
}

/// Removes the additions from a block and returns them in their order.
SmallVector<Addition> AdditionOrder::takeFrom(Block *block) {
  SmallVector<Addition> additions;
  for (Operation &op : llvm::make_early_inc_range(*block)) {
    if (isAddition(&op)) {
      additions.push_back(take(cast<LLVM::AtomicRMWOp>(op)));
    } else if (auto branch = dyn_cast<scf::IfOp>(op);
               branch && containsAddition(branch)) {
      llvm::append_range(additions, takeOut(branch));
    }
  }
  return additions;
}

/// Makes the branch yield the terms of the additions in both of its arms, and
/// returns the additions, whose terms are these results from now on.
SmallVector<Addition> AdditionOrder::takeOut(scf::IfOp &branch) {
  SmallVector<Addition> additions = takeFrom(branch.thenBlock());
  size_t numThen = additions.size();
  if (branch.elseBlock())
    llvm::append_range(additions, takeFrom(branch.elseBlock()));

  OpBuilder builder(branch);
  SmallVector<Type> types(branch.getResultTypes());
  /// The results that hold base and value of each addition; equal bases share a
  /// result.
  SmallVector<std::pair<size_t, size_t>> results;
  SmallVector<Value> yielded;
  SmallVector<bool> isThen;
  auto addResult = [&](Value value, bool inThen) -> size_t {
    types.push_back(value.getType());
    yielded.push_back(value);
    isThen.push_back(inThen);
    return types.size() - 1;
  };
  for (bool inThen : {true, false}) {
    /// For each key of an address: the number of its result, and the distance
    /// of the address from the key.
    llvm::SmallDenseMap<Key, std::pair<size_t, int64_t>> known;
    for (size_t i = inThen ? 0 : numThen,
                end = inThen ? numThen : additions.size();
         i < end; ++i) {
      Addition &addition = additions[i];
      int64_t distance = 0;
      auto [at, isNew] =
          known.try_emplace(getKey(addition.base, distance), 0, distance);
      if (isNew)
        at->second.first = addResult(addition.base, inThen);
      addition.offset += distance - at->second.second;
      results.push_back({at->second.first, addResult(addition.value, inThen)});
    }
  }

  size_t numBefore = branch.getNumResults();
  auto made = scf::IfOp::create(builder, branch.getLoc(), types,
                                branch.getCondition(), /*addThenBlock=*/true,
                                /*addElseBlock=*/true);
  made->setDiscardableAttrs(branch->getDiscardableAttrDictionary());
  auto fill = [&](Block *from, Block *to, bool inThen) {
    SmallVector<Value> values;
    if (from) {
      Operation *end = from->getTerminator();
      values.append(end->operand_begin(), end->operand_end());
      end->erase();
      to->getOperations().splice(to->end(), from->getOperations());
    }
    OpBuilder inside = OpBuilder::atBlockEnd(to);
    for (auto [i, value] : llvm::enumerate(yielded)) {
      if (isThen[i] == inThen)
        values.push_back(value);
      else
        values.push_back(emitZero(inside, branch.getLoc(), value.getType()));
    }
    scf::YieldOp::create(inside, branch.getLoc(), values);
  };
  fill(branch.thenBlock(), made.thenBlock(), true);
  fill(branch.elseBlock(), made.elseBlock(), false);
  for (size_t i = 0; i < numBefore; ++i)
    branch.getResult(i).replaceAllUsesWith(made.getResult(i));
  branch.erase();
  branch = made;
  for (auto [addition, result] : llvm::zip_equal(additions, results)) {
    addition.base = made.getResult(result.first);
    addition.value = made.getResult(result.second);
  }
  return additions;
}

void AdditionOrder::emit(OpBuilder &builder, const Addition &addition,
                         Plans &plans) {
  Location loc = addition.loc;
  Value &plan = plans[addition.base];
  if (!plan)
    plan = runtime.call(
        builder, loc, inTurn ? "tai_dev_ordered_turns" : "tai_dev_ordered_plan",
        builder.getI64Type(), {addition.base});
  Value target = addition.base;
  if (addition.offset != 0) {
    Value offset = runtime.i64(builder, loc, addition.offset);
    target =
        LLVM::GEPOp::create(builder, loc, target.getType(), builder.getI8Type(),
                            target, ArrayRef<LLVM::GEPArg>{offset});
  }
  bool isSingle = addition.value.getType().isF32();
  StringRef callee =
      isSingle ? "tai_dev_ordered_add_f32" : "tai_dev_ordered_add_f64";
  if (inTurn)
    callee =
        isSingle ? "tai_dev_ordered_append_f32" : "tai_dev_ordered_append_f64";
  runtime.call(builder, loc, callee, Type(), {plan, target, addition.value});
  auto *call = &*std::prev(builder.getInsertionPoint());
  call->setAttr(kOrderedScopeAttrName, addition.scope
                                           ? Attribute(addition.scope)
                                           : Attribute(builder.getUnitAttr()));
}

/// True if `op` contains a loop with additions, which cannot be moved out.
static bool isRepeated(Operation *op) {
  return op
      ->walk([](scf::ForOp inner) {
        return containsAddition(inner) ? WalkResult::interrupt()
                                       : WalkResult::advance();
      })
      .wasInterrupted();
}

/// True for values that follow from the number of an iteration alone and so
/// exist in all threads. Induction variables of inner loops are among them.
bool AdditionOrder::isForAll(Value value) {
  if (Operation *op = value.getDefiningOp())
    return forAll.contains(op) || !body->getParentOp()->isAncestor(op);
  auto argument = cast<BlockArgument>(value);
  auto loop = dyn_cast<scf::ForOp>(argument.getOwner()->getParentOp());
  return !body->getParentOp()->isAncestor(argument.getOwner()->getParentOp()) ||
         (loop && loop.getInductionVar() == argument);
}

/// Lets only threads that have an iteration execute the consecutive operations
/// `part`, and all threads the additions in them.
void AdditionOrder::processPart(ArrayRef<Operation *> part) {
  llvm::SmallPtrSet<Operation *, 16> inside;
  SmallVector<Operation *> moved;
  for (Operation *op : part) {
    bool stays = isa<LLVM::AllocaOp, AllocaOp>(op) ||
                 (op->getNumRegions() == 0 && isMemoryEffectFree(op) &&
                  llvm::all_of(op->getOperands(), [&](Value operand) {
                    return isForAll(operand);
                  }));
    if (stays) {
      forAll.insert(op);
      continue;
    }
    inside.insert(op);
    moved.push_back(op);
  }
  if (moved.empty())
    return;
  // The results of the moved operations that other code uses.
  SmallVector<Value> used;
  for (Operation *op : moved)
    for (Value result : op->getResults())
      if (llvm::any_of(result.getUsers(), [&](Operation *user) {
            return !inside.contains(
                op->getBlock()->findAncestorOpInBlock(*user));
          }))
        used.push_back(result);
  OpBuilder builder(moved.front()->getContext());
  builder.setInsertionPointAfter(part.back());
  Location loc = moved.front()->getLoc();
  auto branch = scf::IfOp::create(builder, loc, ValueRange(used).getTypes(),
                                  isActive, /*addThenBlock=*/true,
                                  /*addElseBlock=*/true);
  for (auto [value, result] : llvm::zip_equal(used, branch.getResults()))
    value.replaceUsesWithIf(result, [&](OpOperand &use) {
      return !inside.contains(
          branch->getBlock()->findAncestorOpInBlock(*use.getOwner()));
    });
  Block *active = branch.thenBlock();
  for (Operation *op : moved)
    op->moveBefore(active, active->end());
  OpBuilder end = OpBuilder::atBlockEnd(active);
  scf::YieldOp::create(end, loc, used);
  // Threads without an iteration yield zeros, because they do not use the
  // results.
  OpBuilder none = OpBuilder::atBlockEnd(branch.elseBlock());
  SmallVector<Value> zeros;
  for (Value value : used)
    zeros.push_back(emitZero(none, loc, value.getType()));
  scf::YieldOp::create(none, loc, zeros);

  SmallVector<Addition> additions;
  if (containsAddition(branch))
    additions = takeOut(branch);
  builder.setInsertionPointAfter(branch);
  Plans plans;
  for (const Addition &addition : additions)
    emit(builder, addition, plans);
}

/// Processes a block that all threads of the warp run together.
void AdditionOrder::process(Block *block) {
  SmallVector<SmallVector<Operation *>> parts(1);
  SmallVector<Operation *> together;
  for (Operation &op : block->without_terminator()) {
    if (!isRepeated(&op)) {
      parts.back().push_back(&op);
      continue;
    }
    together.push_back(&op);
    parts.emplace_back();
  }
  for (ArrayRef<Operation *> part : parts)
    processPart(part);
  for (Operation *op : together) {
    if (auto serial = dyn_cast<scf::ForOp>(op)) {
      process(serial.getBody());
      continue;
    }
    // Both arms can be processed, because the condition is the same for all
    // threads.
    auto branch = cast<scf::IfOp>(op);
    process(branch.thenBlock());
    if (branch.elseBlock())
      process(branch.elseBlock());
  }
}

void tai::orderAdditions(Block *body, Value isActive, bool inTurn,
                         RuntimeCalls &runtime) {
  AdditionOrder(body, isActive, inTurn, runtime).process(body);
}

//===----------------------------------------------------------------------===//
// Sums
//===----------------------------------------------------------------------===//

void tai::storeParts(OpBuilder &builder, Location loc, Sum &sum, Value thread,
                     Value threads, int64_t count) {
  IndexMath math(builder, loc);
  Value mine = emitSlotLoad(builder, loc, sum.kept, sum.slot);
  Value none =
      arith::ConstantOp::create(builder, loc, getLaneStart(sum.kind, sum.kept));
  scf::ForOp::create(
      builder, loc, thread, math.constant(count), threads, ValueRange(),
      [&](OpBuilder &in, Location, Value part, ValueRange) {
        Value isMine = arith::CmpIOp::create(in, loc, arith::CmpIPredicate::eq,
                                             part, thread);
        Value value = arith::SelectOp::create(in, loc, isMine, mine, none);
        emitStore(
            in, loc, value,
            emitPointer(in, loc, getStorageType(sum.kept), sum.target, part),
            AliasScopes());
        scf::YieldOp::create(in, loc);
      });
}
