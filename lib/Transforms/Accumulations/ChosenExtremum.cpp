//===- ChosenExtremum.cpp - A minimum under conditions --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ChosenExtremum.h"
#include "SharedUpdate.h"
#include "mlir/Analysis/SliceAnalysis.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/Dominance.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"

using namespace mlir;
using namespace mlir::tai;

/// The most conditions in the truth table of an update: each doubles the number
/// of rows, and the values of all ops are computed in each row.
static constexpr unsigned kMostAtoms = 12;
static constexpr unsigned kMostVisits = 100;

bool mlir::tai::isExtremum(AtomicKind kind) {
  return kind == AtomicKind::Min || kind == AtomicKind::Max ||
         kind == AtomicKind::MinU || kind == AtomicKind::MaxU;
}

unsigned mlir::tai::getNumberWidth(Type type) {
  type = getElementTypeOrSelf(type);
  return type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
}

bool mlir::tai::hasNoEffectBut(Operation *op, Operation *but) {
  return !op->walk([&](Operation *nested) {
              auto access = dyn_cast<DifferentiableAccessInterface>(nested);
              bool isRead =
                  access && access.getAccessKind() == AccessKind::Read;
              bool hasEffect = nested != but && !isRead &&
                               !nested->hasTrait<OpTrait::IsTerminator>() &&
                               !isa<scf::IfOp, scf::ForOp>(nested) &&
                               !isMemoryEffectFree(nested);
              return hasEffect ? WalkResult::interrupt()
                               : WalkResult::advance();
            }).wasInterrupted();
}

static bool isTruthValue(Value value) { return value.getType().isInteger(1); }

static bool isConversion(Operation *op) {
  return isa_and_nonnull<arith::ExtFOp, arith::TruncFOp, arith::ExtSIOp,
                         arith::ExtUIOp, arith::TruncIOp>(op);
}

/// Returns the number from which `value` was converted to the type of the
/// element, or to the type in which the program computes.
Value ChosenExtremum::getNumber(Value value) const {
  unsigned width = getNumberWidth(stored.getType());
  while (isConversion(value.getDefiningOp()) &&
         getNumberWidth(value.getType()) >= width)
    value = value.getDefiningOp()->getOperand(0);
  return value;
}

bool ChosenExtremum::isFormer(Value number) const {
  return old.isLoaded(number) || (former && same.areEqual(former, number));
}

//===----------------------------------------------------------------------===//
// Conditions and values
//===----------------------------------------------------------------------===//

bool ChosenExtremum::addAtom(Value condition) {
  auto *known = llvm::find_if(
      atoms, [&](Value atom) { return same.areEqual(atom, condition); });
  if (known == atoms.end()) {
    if (atoms.size() == kMostAtoms)
      return false;
    known = &atoms.emplace_back(condition);
  }
  numbers[condition] = known - atoms.begin();
  return true;
}

bool ChosenExtremum::collectCondition(Value condition) {
  if (++visited > kMostVisits)
    return false;
  Operation *op = condition.getDefiningOp();
  bool isFlipped = isa_and_nonnull<arith::XOrIOp>(op) &&
                   matchPattern(op->getOperand(1), m_Constant());
  if (!old.reaches(condition) && !isFlipped)
    return matchPattern(condition, m_Constant()) || addAtom(condition);
  if (!op || !isTruthValue(condition))
    return false;
  if (old.reaches(condition))
    path.insert(op);
  if (isa<arith::CmpFOp, arith::CmpIOp>(op))
    return addComparison(op);
  if (isa<arith::AndIOp, arith::OrIOp, arith::XOrIOp, arith::SelectOp>(op))
    return llvm::all_of(op->getOperands(), [&](Value part) {
      return isTruthValue(part) && collectCondition(part);
    });
  auto branch = dyn_cast<scf::IfOp>(op);
  if (!branch || !hasNoEffectBut(branch))
    return false;
  OpResult result = cast<OpResult>(condition);
  branches.push_back(result);
  return collectCondition(branch.getCondition()) &&
         llvm::all_of(branch->getRegions(), [&](Region &region) {
           return collectCondition(region.front().getTerminator()->getOperand(
               result.getResultNumber()));
         });
}

/// Adds to the path the ops that convert `number` to `value`. False if the
/// program extends integers in more than one way.
bool ChosenExtremum::addConversions(Value value, Value number) {
  for (Value between = value; between != number;) {
    Operation *op = between.getDefiningOp();
    path.insert(op);
    between = op->getOperand(0);
    if (!isa<arith::ExtSIOp, arith::ExtUIOp>(op))
      continue;
    if (extension && *extension != op->getName())
      return false;
    extension = op->getName();
  }
  return true;
}

/// True unless another op has extended `number` to a wider type than the op
/// that has extended the element.
bool ChosenExtremum::isExtendedAlike(Value number) const {
  return !extension || isa<FloatType>(number.getType()) ||
         matchPattern(number, m_Constant()) ||
         (number.getDefiningOp() &&
          number.getDefiningOp()->getName() == *extension);
}

/// True if `value` equals the number that the program compares with the
/// element, possibly in the element's type.
bool ChosenExtremum::isGiven(Value value) const {
  APInt longer, narrow;
  if (matchPattern(given, m_ConstantInt(&longer)) &&
      matchPattern(value, m_ConstantInt(&narrow)))
    return longer.sextOrTrunc(narrow.getBitWidth()) == narrow;
  APFloat precise(0.0), rounded(0.0);
  if (matchPattern(given, m_ConstantFloat(&precise)) &&
      matchPattern(value, m_ConstantFloat(&rounded))) {
    bool isInexact;
    precise.convert(rounded.getSemantics(), APFloat::rmNearestTiesToEven,
                    &isInexact);
    return precise.bitwiseIsEqual(rounded);
  }
  return same.areEqual(getNumber(value), getNumber(given));
}

bool ChosenExtremum::addComparison(Operation *op) {
  if (llvm::is_contained(comparisons, op))
    return true;
  for (Value side : op->getOperands()) {
    if (isTruthValue(side) || !side.getType().isIntOrIndexOrFloat())
      return false;
    Value number = getNumber(side);
    if (!old.reaches(side)) {
      if (!given)
        given = side;
      if (given.getType() != side.getType() || !isGiven(side))
        return false;
      continue;
    }
    if (!former)
      former = number;
    if (!isFormer(number) || old.isLoaded(number) != old.isLoaded(former) ||
        !addConversions(side, number))
      return false;
    if (old.isLoaded(number))
      loads.push_back(
          cast<DifferentiableAccessInterface>(number.getDefiningOp()));
  }
  bool isOfBoth =
      old.reaches(op->getOperand(0)) != old.reaches(op->getOperand(1));
  if (auto integers = dyn_cast<arith::CmpIOp>(op)) {
    bool isOrder = integers.getPredicate() > arith::CmpIPredicate::ne;
    bool isOfBits = integers.getPredicate() >= arith::CmpIPredicate::ult;
    if (isOrder) {
      Signs here = isOfBits ? Signs::Unsigned : Signs::Signed;
      signs = signs == Signs::None || signs == here ? here : Signs::Both;
    }
  } else {
    arith::CmpFPredicate predicate = cast<arith::CmpFOp>(op).getPredicate();
    if (isOfBoth && (predicate == arith::CmpFPredicate::UNO ||
                     predicate == arith::CmpFPredicate::ORD))
      return false;
    asksForNaN |= !isOfBoth;
  }
  comparisons.push_back(op);
  return true;
}

bool ChosenExtremum::addExtremum(Value value, Operation *op) {
  std::optional<AtomicKind> extremum = getAtomicKind(op);
  if (!extremum || !isExtremum(*extremum))
    return false;
  bool isLeft = old.reaches(op->getOperand(0));
  Value side = op->getOperand(isLeft ? 0 : 1);
  Value other = op->getOperand(isLeft ? 1 : 0);
  Value number = getNumber(side);
  if (old.reaches(other) || !old.isLoaded(number) ||
      !addConversions(side, number))
    return false;
  loads.push_back(cast<DifferentiableAccessInterface>(number.getDefiningOp()));
  extrema[value] = {*extremum, other};
  return true;
}

/// Collects the values that may reach `user`, a store or a yield, as `value`.
bool ChosenExtremum::collectValue(Value value, Operation *user) {
  if (++visited > kMostVisits)
    return false;
  if (!old.reaches(value)) {
    givenValues.push_back(value);
    return true;
  }
  Value number = getNumber(value);
  if (!addConversions(value, number))
    return false;
  if (isFormer(number)) {
    formerValues.insert(value);
    if (old.isLoaded(number))
      loads.push_back(
          cast<DifferentiableAccessInterface>(number.getDefiningOp()));
    return true;
  }
  Operation *op = number.getDefiningOp();
  if (!op)
    return false;
  path.insert(op);
  if (auto select = dyn_cast<arith::SelectOp>(op))
    return isTruthValue(select.getCondition()) &&
           collectCondition(select.getCondition()) &&
           collectValue(select.getTrueValue(), user) &&
           collectValue(select.getFalseValue(), user);
  if (auto branch = dyn_cast<scf::IfOp>(op)) {
    // The branch will move to its user, so both ops must be in one block.
    if (branch->getNumResults() != 1 || branch->getBlock() != user->getBlock())
      return false;
    for (Operation *between = branch; between != user;
         between = between->getNextNode())
      if (!hasNoEffectBut(between))
        return false;
    branches.push_back(branch->getResult(0));
    return collectCondition(branch.getCondition()) &&
           llvm::all_of(branch->getRegions(), [&](Region &region) {
             Operation *yield = region.front().getTerminator();
             return collectValue(yield->getOperand(0), yield);
           });
  }
  return addExtremum(value, op);
}

//===----------------------------------------------------------------------===//
// The table
//===----------------------------------------------------------------------===//

/// Returns the result of the comparison `op` if the given number and the former
/// one are in the order `order`.
bool ChosenExtremum::compares(Operation *op, Order order) const {
  bool isLess = order == Order::Less;
  bool isLeftOld = old.reaches(op->getOperand(0)),
       isRightOld = old.reaches(op->getOperand(1));
  if (auto integers = dyn_cast<arith::CmpIOp>(op)) {
    auto number = [&](bool isOld) { return APInt(8, isOld == isLess ? 2 : 1); };
    return arith::applyCmpPredicate(integers.getPredicate(), number(isLeftOld),
                                    number(isRightOld));
  }
  auto number = [&](bool isOld) {
    if (isOld && order == Order::FormerIsNaN)
      return APFloat::getNaN(APFloat::IEEEdouble());
    return APFloat(isOld == isLess ? 2.0 : 1.0);
  };
  return arith::applyCmpPredicate(cast<arith::CmpFOp>(op).getPredicate(),
                                  number(isLeftOld), number(isRightOld));
}

bool ChosenExtremum::holds(Value condition, Row row) const {
  if (auto known = numbers.find(condition); known != numbers.end())
    return (row.holding >> known->second) & 1;
  APInt constant;
  if (matchPattern(condition, m_ConstantInt(&constant)))
    return !constant.isZero();
  Operation *op = condition.getDefiningOp();
  auto part = [&](unsigned number) {
    return holds(op->getOperand(number), row);
  };
  if (isa<arith::AndIOp>(op))
    return part(0) && part(1);
  if (isa<arith::OrIOp>(op))
    return part(0) || part(1);
  if (isa<arith::XOrIOp>(op))
    return part(0) != part(1);
  if (isa<arith::SelectOp>(op))
    return part(0) ? part(1) : part(2);
  auto branch = dyn_cast<scf::IfOp>(op);
  if (!branch)
    return compares(op, row.order);
  Region &taken = branch->getRegion(part(0) ? 0 : 1);
  unsigned number = cast<OpResult>(condition).getResultNumber();
  return holds(taken.front().getTerminator()->getOperand(number), row);
}

/// True if `value` is the given number, and not the former one, in this row of
/// the truth table.
bool ChosenExtremum::takes(Value value, Row row) const {
  if (formerValues.contains(value))
    return false;
  if (auto known = extrema.find(value); known != extrema.end()) {
    AtomicKind extremum = known->second.kind;
    bool isMin = extremum == AtomicKind::Min || extremum == AtomicKind::MinU;
    return row.order == (isMin ? Order::Less : Order::Greater);
  }
  if (!old.reaches(value))
    return true;
  Operation *op = getNumber(value).getDefiningOp();
  if (auto select = dyn_cast<arith::SelectOp>(op))
    return takes(holds(select.getCondition(), row) ? select.getTrueValue()
                                                   : select.getFalseValue(),
                 row);
  auto branch = cast<scf::IfOp>(op);
  Region &taken = branch->getRegion(holds(branch.getCondition(), row) ? 0 : 1);
  return takes(taken.front().getTerminator()->getOperand(0), row);
}

bool ChosenExtremum::takes(Row row) const {
  return llvm::all_of(guards,
                      [&](const SideOfBranch &guard) {
                        scf::IfOp branch = guard.branch;
                        return holds(branch.getCondition(), row) ==
                               guard.inThen;
                      }) &&
         takes(stored, row);
}

bool ChosenExtremum::decide() {
  std::optional<bool> isMin;
  for (unsigned holding = 0; holding != 1u << atoms.size(); ++holding) {
    bool ifLess = takes(Row{Order::Less, holding});
    bool ifGreater = takes(Row{Order::Greater, holding});
    // An atomic extremum leaves an element that is NaN as it is, so a program
    // that replaces NaN is not an atomic extremum.
    if (asksForNaN && takes(Row{Order::FormerIsNaN, holding}))
      return false;
    if (!ifLess && !ifGreater)
      continue;
    if ((ifLess && ifGreater) || isMin == ifGreater)
      return false;
    isMin = ifLess;
  }
  if (!isMin || signs == Signs::Both || !isExtendedAlike(given))
    return false;
  bool isUnsigned = signs == Signs::Unsigned;
  kind = *isMin       ? isUnsigned ? AtomicKind::MinU : AtomicKind::Min
         : isUnsigned ? AtomicKind::MaxU
                      : AtomicKind::Max;
  return llvm::all_of(extrema,
                      [&](auto &known) {
                        return known.second.kind == kind &&
                               isExtendedAlike(known.second.given) &&
                               isGiven(known.second.given);
                      }) &&
         llvm::all_of(givenValues, [&](Value value) { return isGiven(value); });
}

/// True if the comparisons may be replaced by constants, by which more
/// iterations may run an arm of `branch`: no arm gets more iterations, or the
/// arm's ops may run in any iteration. Ops that compute compared values may,
/// because the program always runs them.
bool ChosenExtremum::mayRunMore(scf::IfOp branch,
                                const llvm::SetVector<Operation *> &compared) {
  auto isHarmless = [&](Operation *op) {
    if (op == store || isa<scf::IfOp, scf::ForOp>(op) ||
        op->hasTrait<OpTrait::IsTerminator>() || isPure(op) ||
        reads.contains(op, branch))
      return true;
    return op->getNumResults() == 1 &&
           (old.isLoaded(op->getResult(0)) ||
            llvm::any_of(compared, [&](Operation *known) {
              return known->getNumResults() == 1 &&
                     same.areEqual(known->getResult(0), op->getResult(0));
            }));
  };
  Order yes = getTaken(),
        no = yes == Order::Less ? Order::Greater : Order::Less;
  for (auto [number, arm] : llvm::enumerate(branch->getRegions())) {
    bool isThen = number == 0, runsMore = false;
    for (unsigned holding = 0; holding != 1u << atoms.size(); ++holding)
      runsMore |= holds(branch.getCondition(), Row{yes, holding}) == isThen &&
                  holds(branch.getCondition(), Row{no, holding}) != isThen;
    WalkResult walk = arm.walk([&](Operation *op) {
      return isHarmless(op) ? WalkResult::advance() : WalkResult::interrupt();
    });
    if (runsMore && walk.wasInterrupted())
      return false;
  }
  return true;
}

bool ChosenExtremum::match() {
  for (Operation *op = store; op->getParentOp() != loop;
       op = op->getParentOp()) {
    auto branch = dyn_cast<scf::IfOp>(op->getParentOp());
    if (!branch || !old.reaches(branch.getCondition()))
      continue;
    bool inThen = branch.getThenRegion().isAncestor(op->getParentRegion());
    guards.push_back({branch, inThen});
    path.insert(branch);
    if (branch->getNumResults() != 0 || !hasNoEffectBut(branch, store) ||
        !collectCondition(branch.getCondition()))
      return false;
  }
  if (!collectValue(stored, store) || !given || !former || !decide())
    return false;
  llvm::SetVector<Operation *> compared;
  BackwardSliceOptions options;
  options.inclusive = true;
  options.omitBlockArguments = true;
  options.filter = [&](Operation *op) { return loop->isProperAncestor(op); };
  for (Operation *op : comparisons)
    (void)getBackwardSlice(op, &compared, options);
  auto isSafe = [&](scf::IfOp branch) {
    return !old.reaches(branch.getCondition()) || mayRunMore(branch, compared);
  };
  return llvm::all_of(
             guards,
             [&](SideOfBranch &guard) { return isSafe(guard.branch); }) &&
         llvm::all_of(branches, [&](OpResult result) {
           return isSafe(cast<scf::IfOp>(result.getOwner()));
         });
}

//===----------------------------------------------------------------------===//
// Rewriting
//===----------------------------------------------------------------------===//

bool ChosenExtremum::mayTake(Value value) const {
  if (!old.reaches(value) || extrema.contains(value))
    return true;
  if (formerValues.contains(value))
    return false;
  Operation *op = getNumber(value).getDefiningOp();
  if (auto select = dyn_cast<arith::SelectOp>(op))
    return mayTake(select.getTrueValue()) || mayTake(select.getFalseValue());
  return llvm::any_of(op->getRegions(), [&](Region &region) {
    return mayTake(region.front().getTerminator()->getOperand(0));
  });
}

/// Emits the update of the element by `value`, inside the arms of the branches
/// that choose this value.
void ChosenExtremum::sink(OpBuilder &b, Value value,
                          function_ref<void(OpBuilder &, Value)> emit) {
  if (formerValues.contains(value))
    return;
  auto known = extrema.find(value);
  if (known != extrema.end() || !old.reaches(value)) {
    Value result = known == extrema.end() ? value : known->second.given;
    // The given number equals `result` and dominates the store, so it can be
    // stored instead.
    if (isGivenKnown && given.getType() == result.getType())
      result = given;
    return emit(b, result);
  }
  Operation *op = getNumber(value).getDefiningOp();
  Value condition = op->getOperand(0);
  SmallVector<Value, 2> arms;
  if (auto select = dyn_cast<arith::SelectOp>(op))
    arms = {select.getTrueValue(), select.getFalseValue()};
  else
    for (Region &region : op->getRegions())
      arms.push_back(region.front().getTerminator()->getOperand(0));
  auto choice = scf::IfOp::create(b, op->getLoc(), condition,
                                  /*withElseRegion=*/mayTake(arms[1]));
  for (auto [number, arm] : llvm::enumerate(arms)) {
    if (!mayTake(arm))
      continue;
    Operation *end = choice->getRegion(number).front().getTerminator();
    if (op->getNumRegions() != 0) {
      Block &from = op->getRegion(number).front();
      end->getBlock()->getOperations().splice(
          end->getIterator(), from.getOperations(), from.begin(),
          from.getTerminator()->getIterator());
    }
    OpBuilder inside(end);
    sink(inside, arm, emit);
  }
}

void ChosenExtremum::rewrite(
    llvm::SetVector<Operation *> &path,
    SmallVectorImpl<DifferentiableAccessInterface> &formerLoads,
    function_ref<void(OpBuilder &, Value)> emit) {
  auto erase = [&](Operation *branch) {
    auto isWithin = [&](Operation *op) { return branch->isAncestor(op); };
    path.remove_if(isWithin);
    llvm::erase_if(formerLoads, isWithin);
    branch->erase();
  };
  isGivenKnown = DominanceInfo(loop).properlyDominates(given, store);
  for (Operation *op : comparisons) {
    OpBuilder b(op);
    op->getResult(0).replaceAllUsesWith(arith::ConstantIntOp::create(
        b, op->getLoc(), compares(op, getTaken()), 1));
  }
  OpBuilder b(store);
  sink(b, stored, emit);
  store->erase();
  // The arms of branches that yield numbers have been moved, so the branches
  // are erased.
  for (OpResult result : llvm::reverse(branches)) {
    Operation *branch = result.getOwner();
    if (isTruthValue(result))
      continue;
    OpBuilder b(branch);
    result.replaceAllUsesWith(arith::ConstantOp::create(
        b, branch->getLoc(), b.getZeroAttr(result.getType())));
    erase(branch);
  }
  for (SideOfBranch &guard : guards) {
    path.remove(guard.branch);
    APInt holds;
    if (!matchPattern(guard.branch.getCondition(), m_ConstantInt(&holds)))
      continue;
    Block *block =
        guard.inThen ? guard.branch.thenBlock() : guard.branch.elseBlock();
    for (Operation &op :
         llvm::make_early_inc_range(block->without_terminator()))
      op.moveBefore(guard.branch);
    erase(guard.branch);
  }
}
