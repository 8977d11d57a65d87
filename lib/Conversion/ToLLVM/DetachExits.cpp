//===- DetachExits.cpp - Carried values that do not wait for an exit ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `while i < n: if found(i): break; i += 1` carries a flag, and the next `i` is
// a select by it. A processor predicts branches but not selects, so each
// iteration would wait for the load or the division that decides on the flag.
// Once the flag is set, no iteration follows. So the next `i` may always be
// `i + 1`, and a second carried value keeps the one that remains.
//
//===----------------------------------------------------------------------===//

#include "DetachExits.h"

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "mlir/Transforms/RegionUtils.h"

using namespace mlir;
using namespace mlir::tai;

/// The largest number of operations that are moved out of a branch.
static constexpr unsigned kMaxMovedOps = 16;

/// True if `value` is the negation of `flag`.
static bool isNot(Value value, Value flag) {
  auto negation = value.getDefiningOp<arith::XOrIOp>();
  return negation && negation.getLhs() == flag &&
         matchPattern(negation.getRhs(), m_One());
}

/// True if the condition of a loop does not hold where `flag` is set.
static bool stopsAt(Value condition, Value flag) {
  if (isNot(condition, flag))
    return true;
  if (auto both = condition.getDefiningOp<arith::AndIOp>())
    return stopsAt(both.getLhs(), flag) || stopsAt(both.getRhs(), flag);
  if (auto select = condition.getDefiningOp<arith::SelectOp>())
    return (select.getCondition() == flag &&
            matchPattern(select.getTrueValue(), m_Zero())) ||
           (isNot(select.getCondition(), flag) &&
            matchPattern(select.getFalseValue(), m_Zero()));
  auto branch = condition.getDefiningOp<scf::IfOp>();
  if (!branch)
    return false;
  bool isNegated = isNot(branch.getCondition(), flag);
  if (!isNegated && branch.getCondition() != flag)
    return false;
  Block *stopped = isNegated ? branch.elseBlock() : branch.thenBlock();
  unsigned number = cast<OpResult>(condition).getResultNumber();
  return matchPattern(stopped->getTerminator()->getOperand(number), m_Zero());
}

namespace {
/// A carried value of the next iteration: `kept` if the loop ends by the flag,
/// `next` otherwise.
struct Choice {
  Value kept, next;
};
} // namespace

/// Splits a value into the two that a branch or a select chooses from.
static std::optional<Choice> getChoice(Value value, Value flag) {
  if (auto select = value.getDefiningOp<arith::SelectOp>()) {
    if (select.getCondition() == flag)
      return Choice{select.getTrueValue(), select.getFalseValue()};
    if (isNot(select.getCondition(), flag))
      return Choice{select.getFalseValue(), select.getTrueValue()};
  }
  auto branch = value.getDefiningOp<scf::IfOp>();
  if (!branch)
    return std::nullopt;
  unsigned number = cast<OpResult>(value).getResultNumber();
  Value then = branch.thenYield().getOperand(number);
  Value orelse = branch.elseYield().getOperand(number);
  if (branch.getCondition() == flag)
    return Choice{then, orelse};
  if (isNot(branch.getCondition(), flag))
    return Choice{orelse, then};
  return std::nullopt;
}

/// Collects the operations that compute `value` in a branch of the body of a
/// loop, operands first. Fails if one of them must not run without need.
static bool collectMoved(Value value, Block *body,
                         SetVector<Operation *> &moved) {
  Operation *op = value.getDefiningOp();
  Block *block = value.getParentBlock();
  if (block == body || block->getParent()->isProperAncestor(body->getParent()))
    return true;
  if (!op || op->getNumRegions() != 0 || !isPure(op) ||
      moved.size() >= kMaxMovedOps)
    return false;
  if (!llvm::all_of(op->getOperands(), [&](Value operand) {
        return collectMoved(operand, body, moved);
      }))
    return false;
  moved.insert(op);
  return true;
}

/// True if `value` is computed from `argument` in the block of the argument.
static bool dependsOn(Value value, BlockArgument argument) {
  Region *body = argument.getOwner()->getParent();
  SetVector<Value> reached;
  reached.insert(value);
  for (unsigned number = 0; number < reached.size(); ++number) {
    Value one = reached[number];
    if (one == argument)
      return true;
    Operation *op = one.getDefiningOp();
    if (!op || !body->isAncestor(op->getParentRegion()))
      continue;
    reached.insert(op->operand_begin(), op->operand_end());
    getUsedValuesDefinedAbove(op->getRegions(), reached);
    for (Region &region : op->getRegions())
      for (Block &block : region)
        reached.insert(block.getTerminator()->operand_begin(),
                       block.getTerminator()->operand_end());
  }
  return false;
}

/// Replaces the choice between true and false by its condition.
static Value simplifyFlag(Value flag) {
  Value condition;
  if (auto select = flag.getDefiningOp<arith::SelectOp>()) {
    if (matchPattern(select.getTrueValue(), m_One()) &&
        matchPattern(select.getFalseValue(), m_Zero()))
      condition = select.getCondition();
  } else if (auto branch = flag.getDefiningOp<scf::IfOp>()) {
    unsigned number = cast<OpResult>(flag).getResultNumber();
    if (matchPattern(branch.thenYield().getOperand(number), m_One()) &&
        matchPattern(branch.elseYield().getOperand(number), m_Zero()))
      condition = branch.getCondition();
  }
  if (!condition)
    return flag;
  flag.replaceAllUsesWith(condition);
  return condition;
}

namespace {
/// A carried value that no longer waits for the flag.
struct Detached {
  unsigned number;
  Choice choice;
};
} // namespace

/// Lets the loop also carry the values that remain once the flag is set.
static void keepValues(scf::WhileOp loop, unsigned flagNumber,
                       ArrayRef<Detached> detached) {
  Location loc = loop.getLoc();
  OpBuilder builder(loop);
  SmallVector<Value> inits(loop.getInits());
  SmallVector<Type> types(loop.getResultTypes());
  for (const Detached &one : detached) {
    inits.push_back(inits[one.number]);
    types.push_back(types[one.number]);
  }
  auto made = scf::WhileOp::create(builder, loc, types, inits);
  made->setDiscardableAttrs(loop->getDiscardableAttrDictionary());
  made.getBefore().takeBody(loop.getBefore());
  made.getAfter().takeBody(loop.getAfter());
  SmallVector<Value> forwarded, yielded;
  for (const Detached &one : detached) {
    Type type = types[one.number];
    forwarded.push_back(made.getBefore().addArgument(type, loc));
    made.getAfter().addArgument(type, loc);
    yielded.push_back(one.choice.kept);
  }
  made.getConditionOp().getArgsMutable().append(forwarded);
  made.getYieldOp().getResultsMutable().append(yielded);

  unsigned count = loop.getNumResults();
  SmallVector<Value> results(made.getResults().take_front(count));
  for (auto [number, one] : llvm::enumerate(detached))
    results[one.number] = arith::SelectOp::create(
        builder, loc, made.getResult(flagNumber),
        made.getResult(count + number), made.getResult(one.number));
  loop.replaceAllUsesWith(results);
  loop.erase();
}

/// Detaches the carried values from the flag with this number.
static void detachFrom(scf::WhileOp loop, unsigned flagNumber) {
  Block *body = loop.getAfterBody();
  scf::YieldOp yield = loop.getYieldOp();
  OpBuilder builder(body, body->begin());
  BlockArgument own = body->getArgument(flagNumber);
  if (!own.use_empty())
    own.replaceAllUsesWith(arith::ConstantOp::create(
        builder, loop.getLoc(), builder.getBoolAttr(false)));
  Value flag = simplifyFlag(yield.getOperand(flagNumber));

  SmallVector<Detached> detached;
  for (unsigned number = 0; number < yield.getNumOperands(); ++number) {
    std::optional<Choice> choice = getChoice(yield.getOperand(number), flag);
    SetVector<Operation *> moved;
    if (number == flagNumber || !choice ||
        !dependsOn(flag, body->getArgument(number)) ||
        !collectMoved(choice->kept, body, moved) ||
        !collectMoved(choice->next, body, moved))
      continue;
    for (Operation *op : moved)
      op->moveBefore(body->findAncestorOpInBlock(*op));
    yield.setOperand(number, choice->next);
    if (!loop.getResult(number).use_empty())
      detached.push_back({number, *choice});
  }
  if (!detached.empty())
    keepValues(loop, flagNumber, detached);
}

/// Detaches the carried values from the flag that ends a loop, if there is one.
static void detachFrom(scf::WhileOp loop) {
  scf::ConditionOp condition = loop.getConditionOp();
  if (!llvm::equal(condition.getArgs(), loop.getBeforeArguments()))
    return;
  for (auto [number, argument] : llvm::enumerate(loop.getBeforeArguments()))
    if (argument.getType().isInteger(1) &&
        stopsAt(condition.getCondition(), argument)) {
      detachFrom(loop, number);
      return;
    }
}

void tai::detachExits(Operation *root) {
  SmallVector<scf::WhileOp> loops;
  root->walk([&](scf::WhileOp loop) { loops.push_back(loop); });
  for (scf::WhileOp loop : loops)
    detachFrom(loop);
}
