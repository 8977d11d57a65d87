//===- SharedUpdate.cpp - An update of a shared element -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SharedUpdate.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/Dominance.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

static Type getScalar(Value value) {
  return getElementTypeOrSelf(value.getType());
}

/// Returns the truth value whose negation is `value`, or null.
static Value getNegated(Value value) {
  auto flip = value.getDefiningOp<arith::XOrIOp>();
  return flip && matchPattern(flip.getRhs(), m_One()) ? flip.getLhs() : Value();
}

std::optional<AtomicKind> mlir::tai::getAtomicKind(Operation *op) {
  using Kind = std::optional<AtomicKind>;
  return llvm::TypeSwitch<Operation *, Kind>(op)
      .Case<arith::AddFOp, arith::AddIOp>([](auto) { return AtomicKind::Add; })
      .Case<arith::SubFOp, arith::SubIOp>([](auto) { return AtomicKind::Sub; })
      .Case<arith::MulFOp, arith::MulIOp>([](auto) { return AtomicKind::Mul; })
      .Case<arith::MinNumFOp, arith::MinimumFOp, arith::MinSIOp>(
          [](auto) { return AtomicKind::Min; })
      .Case<arith::MaxNumFOp, arith::MaximumFOp, arith::MaxSIOp>(
          [](auto) { return AtomicKind::Max; })
      .Case([](arith::MinUIOp) { return AtomicKind::MinU; })
      .Case([](arith::MaxUIOp) { return AtomicKind::MaxU; })
      .Case([](arith::AndIOp) { return AtomicKind::And; })
      .Case([](arith::OrIOp) { return AtomicKind::Or; })
      .Case([](arith::XOrIOp) { return AtomicKind::Xor; })
      .Default([](Operation *) { return std::nullopt; });
}

//===----------------------------------------------------------------------===//
// Operands of a store
//===----------------------------------------------------------------------===//

bool SharedUpdate::readsElement() {
  if (old.reaches(store.getAccessedValue()))
    return true;
  for (Operation *op = store; op->getParentOp() != loop; op = op->getParentOp())
    if (auto branch = dyn_cast<scf::IfOp>(op->getParentOp()))
      if (old.reaches(branch.getCondition()))
        return true;
  return false;
}

bool mlir::tai::storesTheSame(DifferentiableAccessInterface store,
                              ParallelForOp loop) {
  Value value = store.getAccessedValue();
  return matchPattern(value, m_Constant()) ||
         !loop->isAncestor(value.getParentBlock()->getParentOp());
}

bool mlir::tai::decidesOnlyFlags(DifferentiableAccessInterface read,
                                 ParallelForOp loop) {
  SmallVector<Operation *> todo(read->user_begin(), read->user_end());
  llvm::SmallPtrSet<Operation *, 16> seen;
  auto add = [&](auto values) {
    for (Value value : values)
      todo.append(value.user_begin(), value.user_end());
  };
  while (!todo.empty()) {
    Operation *op = todo.pop_back_val();
    if (!seen.insert(op).second)
      continue;
    // A value that leaves a region is a result of the op around it.
    if (op->hasTrait<OpTrait::IsTerminator>())
      op = op->getParentOp();
    if (op == loop)
      continue;
    if (op->getNumRegions() == 0) {
      bool isRead = false;
      if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
        isRead = access.getAccessKind() == AccessKind::Read;
      if (!isRead && !isMemoryEffectFree(op))
        return false;
      add(op->getResults());
      continue;
    }
    WalkResult result = op->walk([&](Operation *inner) {
      for (Region &region : inner->getRegions())
        for (Block &block : region)
          add(block.getArguments());
      if (inner->getNumRegions() != 0 || isMemoryEffectFree(inner))
        return WalkResult::advance();
      auto access = dyn_cast<DifferentiableAccessInterface>(inner);
      bool isBenign = access && (access.getAccessKind() == AccessKind::Read ||
                                 (isa<StoreOp, memref::StoreOp>(inner) &&
                                  getSharing(access, loop) != Sharing::Own &&
                                  storesTheSame(access, loop)));
      return isBenign ? WalkResult::advance() : WalkResult::interrupt();
    });
    if (result.wasInterrupted())
      return false;
    add(op->getResults());
  }
  return true;
}

//===----------------------------------------------------------------------===//
// Matching
//===----------------------------------------------------------------------===//

void SharedUpdate::forget() {
  family = std::nullopt;
  extension = std::nullopt;
  loads.clear();
  steps.clear();
  path.clear();
  branches.clear();
  carried.clear();
  totals.clear();
  formers.clear();
}

/// Returns the kind of atomic that does the operation of `kind` on unsigned
/// integers.
static AtomicKind getUnsigned(AtomicKind kind) {
  if (kind == AtomicKind::Min)
    return AtomicKind::MinU;
  return kind == AtomicKind::Max ? AtomicKind::MaxU : kind;
}

/// True if the step of an update can be computed in the type of the element,
/// and combined with the earlier steps. Narrows the step's value to that type.
bool SharedUpdate::accepts(Step &step) {
  // In a type narrower than the element's, digits of the element would be lost.
  // Extrema of wider integers are not the extrema of the truncated integers.
  Type scalar = getScalar(store.getAccessedValue());
  Type combined = getElementTypeOrSelf(step.type);
  if (isa<FloatType>(scalar) != isa<FloatType>(combined) ||
      getNumberWidth(combined) < getNumberWidth(scalar))
    return false;
  if (isExtremum(step.kind) && !isa<FloatType>(scalar) && combined != scalar) {
    APInt constant;
    Operation *op = step.value.getDefiningOp();
    bool isUnsigned = extension ? extension->getStringRef() ==
                                      arith::ExtUIOp::getOperationName()
                                : isa_and_nonnull<arith::ExtUIOp>(op);
    if (matchPattern(step.value, m_ConstantInt(&constant))) {
      if (isUnsigned ? !constant.isIntN(scalar.getIntOrFloatBitWidth())
                     : !constant.isSignedIntN(scalar.getIntOrFloatBitWidth()))
        return false;
    } else {
      if (!isa_and_nonnull<arith::ExtSIOp, arith::ExtUIOp>(op) ||
          getScalar(op->getOperand(0)) != scalar ||
          (extension && *extension != op->getName()))
        return false;
      step.value = op->getOperand(0);
    }
    if (isUnsigned)
      step.kind = getUnsigned(step.kind);
  }
  if (!family)
    family = getCombiningKind(step.kind);
  return *family == getCombiningKind(step.kind);
}

bool SharedUpdate::addStep(Step step) {
  // A select may choose the result of a branch: values that are computed inside
  // of the branch are not available at the select.
  auto isKnown = [&](Value value) {
    return value.getParentRegion()->isAncestor(step.at->getParentRegion());
  };
  if (!isKnown(step.value) ||
      llvm::any_of(step.conditions,
                   [&](auto entry) { return !isKnown(entry.first); }) ||
      !accepts(step))
    return false;
  steps.push_back(std::move(step));
  return true;
}

bool SharedUpdate::matchValue(Value value, const Context &context) {
  if (llvm::is_contained(formers, value))
    return true;
  if (old.isLoaded(value)) {
    loads.push_back(cast<DifferentiableAccessInterface>(value.getDefiningOp()));
    return true;
  }
  Operation *op = value.getDefiningOp();
  if (!op || !old.reaches(value))
    return false;
  path.insert(op);
  if (std::optional<AtomicKind> kind = getAtomicKind(op))
    return matchCombination(op, *kind, context);
  if (auto select = dyn_cast<arith::SelectOp>(op))
    return matchSelect(select, context);
  if (isa<scf::IfOp>(op))
    return matchBranch(cast<OpResult>(value), context);
  if (isa<scf::ForOp>(op))
    return matchLoop(cast<OpResult>(value), context);
  if (isa<arith::ExtFOp, arith::TruncFOp, arith::ExtSIOp, arith::ExtUIOp,
          arith::TruncIOp>(op)) {
    if (isa<arith::ExtSIOp, arith::ExtUIOp>(op)) {
      if (extension && *extension != op->getName())
        return false;
      extension = op->getName();
    }
    return getNumberWidth(value.getType()) >=
               getNumberWidth(store.getAccessedValue().getType()) &&
           matchValue(op->getOperand(0), context);
  }
  return false;
}

/// Matches an op that combines, in one kind of operation, the result of the
/// earlier update with another operand.
bool SharedUpdate::matchCombination(Operation *op, AtomicKind kind,
                                    const Context &context) {
  Value lhs = op->getOperand(0), rhs = op->getOperand(1);
  bool isLeft = old.reaches(lhs);
  if (isLeft == old.reaches(rhs) || (kind == AtomicKind::Sub && !isLeft))
    return false;
  Value other = isLeft ? rhs : lhs;
  return matchValue(isLeft ? lhs : rhs, context) &&
         addStep({context.select ? context.select : op, kind, other,
                  other.getType(), context.conditions});
}

/// Recognises `condition ? whenTrue : whenFalse` as a minimum or maximum: the
/// condition compares whenTrue and whenFalse, or values equal to them.
std::optional<Extremum>
SharedUpdate::getExtremum(Value condition, Value whenTrue, Value whenFalse) {
  while (Value turned = getNegated(condition)) {
    path.insert(condition.getDefiningOp());
    condition = turned;
    std::swap(whenTrue, whenFalse);
  }
  Operation *compare = condition.getDefiningOp();
  // The program may write a condition that also holds where one of the compared
  // numbers is NaN.
  if (auto either = dyn_cast_or_null<arith::OrIOp>(compare)) {
    auto isNaN = either.getRhs().getDefiningOp<arith::CmpFOp>();
    if (!isNaN || isNaN.getPredicate() != arith::CmpFPredicate::UNO)
      return std::nullopt;
    path.insert(compare);
    path.insert(isNaN);
    compare = either.getLhs().getDefiningOp();
  }
  std::optional<int> direction; // of lhs against rhs
  bool isUnsigned = false;
  if (auto floats = dyn_cast_or_null<arith::CmpFOp>(compare)) {
    using Predicate = arith::CmpFPredicate;
    switch (floats.getPredicate()) {
    case Predicate::OLT:
    case Predicate::OLE:
    case Predicate::ULT:
    case Predicate::ULE:
      direction = -1;
      break;
    case Predicate::OGT:
    case Predicate::OGE:
    case Predicate::UGT:
    case Predicate::UGE:
      direction = 1;
      break;
    default:
      break;
    }
  } else if (auto integers = dyn_cast_or_null<arith::CmpIOp>(compare)) {
    using Predicate = arith::CmpIPredicate;
    Predicate predicate = integers.getPredicate();
    isUnsigned = predicate >= Predicate::ult;
    switch (predicate) {
    case Predicate::slt:
    case Predicate::sle:
    case Predicate::ult:
    case Predicate::ule:
      direction = -1;
      break;
    case Predicate::sgt:
    case Predicate::sge:
    case Predicate::ugt:
    case Predicate::uge:
      direction = 1;
      break;
    default:
      break;
    }
  }
  if (!direction)
    return std::nullopt;
  path.insert(compare);
  Value lhs = compare->getOperand(0), rhs = compare->getOperand(1);
  auto isSame = [&](Value a, Value b) {
    return same.areEqual(a, b) || (old.isLoaded(a) && old.isLoaded(b));
  };
  // If the value for a true condition is chosen where it is less, the select is
  // a minimum.
  bool isMin = *direction < 0;
  if (isSame(lhs, whenFalse) && isSame(rhs, whenTrue))
    isMin = !isMin;
  else if (!isSame(lhs, whenTrue) || !isSame(rhs, whenFalse))
    return std::nullopt;
  bool isTrueOld = old.reaches(whenTrue);
  if (isTrueOld == old.reaches(whenFalse))
    return std::nullopt;
  for (Value side : {lhs, rhs})
    if (old.isLoaded(side))
      loads.push_back(
          cast<DifferentiableAccessInterface>(side.getDefiningOp()));
  AtomicKind kind = isMin ? isUnsigned ? AtomicKind::MinU : AtomicKind::Min
                    : isUnsigned ? AtomicKind::MaxU
                                 : AtomicKind::Max;
  // The compared value is used, and not the chosen one, because it is computed
  // before the choice.
  return Extremum{kind, old.reaches(lhs) ? rhs : lhs,
                  isTrueOld ? whenTrue : whenFalse};
}

bool SharedUpdate::matchSelect(arith::SelectOp select, const Context &context) {
  Value condition = select.getCondition();
  Value yes = select.getTrueValue(), no = select.getFalseValue();
  if (old.reaches(condition)) {
    std::optional<Extremum> extremum = getExtremum(condition, yes, no);
    return extremum && matchValue(extremum->old, context) &&
           addStep({context.select ? context.select : select.getOperation(),
                    extremum->kind, extremum->value, extremum->value.getType(),
                    context.conditions});
  }
  if (!condition.getType().isInteger(1))
    return false;
  Context inside = context;
  if (!inside.select)
    inside.select = select;
  inside.conditions.emplace_back(condition, true);
  if (!matchValue(yes, inside))
    return false;
  inside.conditions.back().second = false;
  return matchValue(no, inside);
}

/// Returns the earlier update, before the branch or loop `scope`, from which
/// `value` inside of it is computed: null for the loaded element, and nullopt
/// if there is not exactly one such update.
std::optional<Value> SharedUpdate::findFormer(Value value,
                                              Operation *scope) const {
  if (old.isLoaded(value))
    return Value();
  Operation *op = value.getDefiningOp();
  if (!op || !scope->isProperAncestor(op))
    return value;
  SmallVector<Value, 2> sides;
  if (auto inner = dyn_cast<scf::IfOp>(op)) {
    unsigned number = cast<OpResult>(value).getResultNumber();
    sides = {inner.thenYield().getOperand(number),
             inner.elseYield().getOperand(number)};
  } else if (auto select = dyn_cast<arith::SelectOp>(op)) {
    sides = {select.getTrueValue(), select.getFalseValue()};
  } else if (auto serial = dyn_cast<scf::ForOp>(op)) {
    sides = {serial.getInitArgs()[cast<OpResult>(value).getResultNumber()]};
  } else {
    sides.assign(op->operand_begin(), op->operand_end());
  }
  std::optional<Value> former;
  for (Value side : sides) {
    // An operand that does not depend on the element is skipped: an added
    // value, or the number with which an extremum compares the element.
    if (!old.reaches(side))
      continue;
    std::optional<Value> found = findFormer(side, scope);
    if (!found || (former && *former != *found))
      return std::nullopt;
    former = found;
  }
  return former;
}

/// Matches a branch if both of its sides yield updates that continue one
/// earlier update.
bool SharedUpdate::matchBranch(OpResult result, const Context &context) {
  auto branch = cast<scf::IfOp>(result.getOwner());
  branches.push_back(result);
  if (old.reaches(branch.getCondition())) {
    // The branch must have no other result, and its arms no effect.
    if (branch->getNumResults() != 1 || !hasNoEffectBut(branch))
      return false;
    std::optional<Extremum> extremum =
        getExtremum(branch.getCondition(), branch.thenYield().getOperand(0),
                    branch.elseYield().getOperand(0));
    if (!extremum)
      return false;
    if (old.isLoaded(extremum->old))
      loads.push_back(
          cast<DifferentiableAccessInterface>(extremum->old.getDefiningOp()));
    else if (!llvm::is_contained(formers, extremum->old))
      return false;
    return addStep({context.select ? context.select : branch.getOperation(),
                    extremum->kind, extremum->value, extremum->value.getType(),
                    context.conditions});
  }
  Value yielded[] = {branch.thenYield().getOperand(result.getResultNumber()),
                     branch.elseYield().getOperand(result.getResultNumber())};
  std::optional<Value> former = findFormer(yielded[0], branch);
  if (!former || former != findFormer(yielded[1], branch))
    return false;
  if (*former) {
    if (!matchValue(*former, context))
      return false;
    // The steps of the earlier update, with which both sides of the branch
    // start, run once, before the branch.
    formers.push_back(*former);
  }
  Context side = context;
  // Steps under a select are emitted at the select, outside of the branch.
  if (context.select)
    side.conditions.emplace_back(branch.getCondition(), true);
  bool matches = matchValue(yielded[0], side);
  if (context.select)
    side.conditions.back().second = false;
  matches = matches && matchValue(yielded[1], side);
  if (*former)
    formers.pop_back();
  return matches;
}

/// Matches a serial loop that carries an update: the loop combines the values
/// of all iterations, and its total is one step.
bool SharedUpdate::matchLoop(OpResult result, const Context &context) {
  auto serial = cast<scf::ForOp>(result.getOwner());
  unsigned number = result.getResultNumber();
  carried.push_back(result);
  if (!matchValue(serial.getInitArgs()[number], context))
    return false;
  // An iteration that starts from a value other than the carried one drops the
  // earlier values.
  Value former = serial.getRegionIterArg(number);
  Value yielded = serial.getYieldedValues()[number];
  if (findFormer(yielded, serial) != std::optional(former))
    return false;
  size_t numSteps = steps.size(), numTotals = totals.size(),
         numBranches = branches.size();
  formers.push_back(former);
  bool matches = matchValue(yielded, {});
  formers.pop_back();
  if (!matches)
    return false;
  // The operations of the update that are inside of the serial loop, and the
  // branches around them, remain in the loop.
  SmallVector<Step> inside(std::make_move_iterator(steps.begin() + numSteps),
                           std::make_move_iterator(steps.end()));
  steps.truncate(numSteps);
  totals.truncate(numTotals);
  choices.append(branches.begin() + numBranches, branches.end());
  branches.truncate(numBranches);
  // A loop that only hands the element on has no step, and the update possibly
  // has no kind of operation yet.
  AtomicKind kind = inside.empty() ? AtomicKind::Add : *family;
  if (isExtremum(kind)) {
    kind = inside.front().kind;
    if (llvm::any_of(inside,
                     [&](const Step &step) { return step.kind != kind; }))
      return false;
  }
  totals.emplace_back(result, kind);
  Operation *at = context.select ? context.select : serial->getNextNode();
  return inside.empty() ||
         addStep({at, kind, result, result.getType(), context.conditions});
}

/// Matches an extremum that is chosen by more than a single select.
bool SharedUpdate::matchChosen() {
  chosen.emplace(store, loop, same, old, safeReads);
  if (!chosen->match())
    return false;
  extension = chosen->getExtension();
  path.insert_range(chosen->getPath());
  llvm::append_range(loads, chosen->getLoads());
  llvm::append_range(choices, chosen->getBranches());
  // The former value can be the result of an earlier update of the element:
  // match this update as well.
  if (!old.isLoaded(chosen->getFormer()) &&
      !matchValue(chosen->getFormer(), {}))
    return false;
  Value given = chosen->getGiven();
  Step step{store, chosen->getKind(), given, given.getType(), {}};
  if (!accepts(step))
    return false;
  chosenKind = step.kind;
  return true;
}

/// True if only the store uses the former value of the element.
bool SharedUpdate::isOnlyUsedHere() {
  auto isOurResult = [&](Value value) {
    return llvm::is_contained(
        llvm::concat<OpResult>(branches, choices, carried), value);
  };
  // Branches and loops on the path may have other results, too.
  auto isOurUse = [&](OpOperand &use) {
    Operation *user = use.getOwner(), *parent = user->getParentOp();
    if (isa<scf::YieldOp>(user))
      return path.contains(parent) &&
             isOurResult(parent->getResult(use.getOperandNumber()));
    if (auto serial = dyn_cast<scf::ForOp>(user)) {
      OpResult result = serial.getTiedLoopResult(&use);
      return result && isOurResult(result);
    }
    return user == store || path.contains(user);
  };
  auto isOnlyOurs = [&](Value value) {
    return llvm::all_of(value.getUses(), isOurUse);
  };
  auto isFine = [&](Operation *op) {
    return llvm::all_of(op->getResults(), [&](OpResult result) {
      return (isa<scf::IfOp, scf::ForOp>(op) && !isOurResult(result)) ||
             isOnlyOurs(result);
    });
  };
  return llvm::all_of(path, isFine) && llvm::all_of(loads, isFine) &&
         llvm::all_of(carried, [&](OpResult result) {
           auto serial = cast<scf::ForOp>(result.getOwner());
           return isOnlyOurs(serial.getRegionIterArg(result.getResultNumber()));
         });
}

/// True if nothing writes to the element between the loads and the store, and
/// the indices of the element are computed before each step.
bool SharedUpdate::isUndisturbed() {
  const void *key = getStorageKey(store);
  // Accesses to different components reach different memory, whatever the
  // indices of the element are.
  auto isElsewhere = [&](DifferentiableAccessInterface access) {
    return !store.getAccessComponents().empty() &&
           !access.getAccessComponents().empty() &&
           areProvablyDistinct(store.getAccessComponents(),
                               access.getAccessComponents());
  };
  for (DifferentiableAccessInterface load : loads) {
    Operation *from = load, *to = store;
    Block *common = findCommonBlock(from, to);
    if (!common || from == to || !from->isBeforeInBlock(to))
      return false;
    // If a serial loop contains only the load or only the store, other
    // iterations of the loop come between the two.
    for (auto [inner, outer] :
         {std::pair<Operation *, Operation *>(load, from), {store, to}})
      for (Operation *op = inner; op != outer; op = op->getParentOp())
        if (!isa<scf::IfOp>(op->getParentOp()))
          return false;
    for (Operation *op = from; op; op = op->getNextNode()) {
      WalkResult result = op->walk([&](Operation *nested) {
        auto access = dyn_cast<DifferentiableAccessInterface>(nested);
        return access && access != store &&
                       access.getAccessKind() != AccessKind::Read &&
                       getStorageKey(access) == key && !isElsewhere(access)
                   ? WalkResult::interrupt()
                   : WalkResult::advance();
      });
      if (result.wasInterrupted())
        return false;
      if (op == to)
        break;
    }
  }
  DominanceInfo dominance(loop);
  SmallVector<DifferentiableAccessInterface> accesses(loads);
  accesses.push_back(store);
  return llvm::all_of(steps, [&](Step &step) {
    auto isKnown = [&](Value value) {
      return dominance.properlyDominates(value, step.at);
    };
    auto *place = llvm::find_if(accesses, [&](auto access) {
      return llvm::all_of(access.getAccessIndices(), isKnown) &&
             llvm::all_of(access.getAccessComponents(), isKnown);
    });
    if (place == accesses.end())
      return false;
    step.place = *place;
    return isKnown(step.value) &&
           llvm::all_of(step.conditions,
                        [&](auto &entry) { return isKnown(entry.first); });
  });
}

bool SharedUpdate::match() {
  bool isGuarded = false;
  for (Operation *op = store; op->getParentOp() != loop; op = op->getParentOp())
    if (auto branch = dyn_cast<scf::IfOp>(op->getParentOp()))
      isGuarded |= old.reaches(branch.getCondition());
  auto isUpdate = [&] { return isOnlyUsedHere() && isUndisturbed(); };
  if (!isGuarded && matchValue(store.getAccessedValue(), {}) &&
      !steps.empty() && isUpdate())
    return true;
  forget();
  return matchChosen() && isUpdate();
}

//===----------------------------------------------------------------------===//
// Rewriting
//===----------------------------------------------------------------------===//

/// Converts `value` to the type of the element that the update changes.
Value SharedUpdate::convert(OpBuilder &b, Location loc, Value value) {
  Type type = store.getAccessedValue().getType();
  if (value.getType() == type)
    return value;
  unsigned from = getNumberWidth(value.getType()), to = getNumberWidth(type);
  if (isa<FloatType>(getScalar(value)))
    return from > to ? arith::TruncFOp::create(b, loc, type, value).getResult()
                     : arith::ExtFOp::create(b, loc, type, value).getResult();
  return arith::TruncIOp::create(b, loc, type, value);
}

void SharedUpdate::emit(OpBuilder &b, Location loc, const Step &step) {
  Value value = convert(b, loc, step.value);
  AtomicKind kind = step.kind;
  DifferentiableAccessInterface place = step.place;
  if (FlatSymbolRefAttr field = store.getAccessedStorage().field) {
    AtomicOp::create(b, loc, kind, value, field, place.getAccessIndices(),
                     place.getAccessComponents());
    return;
  }
  using Kind = arith::AtomicRMWKind;
  bool isFloat = isa<FloatType>(value.getType());
  Kind combine = Kind::addf;
  switch (kind) {
  case AtomicKind::Sub:
    value =
        isFloat
            ? arith::NegFOp::create(b, loc, value).getResult()
            : arith::SubIOp::create(b, loc,
                                    arith::ConstantOp::create(
                                        b, loc, b.getZeroAttr(value.getType())),
                                    value)
                  .getResult();
    [[fallthrough]];
  case AtomicKind::Add:
    combine = isFloat ? Kind::addf : Kind::addi;
    break;
  case AtomicKind::Mul:
    combine = isFloat ? Kind::mulf : Kind::muli;
    break;
  case AtomicKind::Min:
    combine = isFloat ? Kind::minnumf : Kind::mins;
    break;
  case AtomicKind::Max:
    combine = isFloat ? Kind::maxnumf : Kind::maxs;
    break;
  case AtomicKind::MinU:
    combine = Kind::minu;
    break;
  case AtomicKind::MaxU:
    combine = Kind::maxu;
    break;
  case AtomicKind::And:
    combine = Kind::andi;
    break;
  case AtomicKind::Or:
    combine = Kind::ori;
    break;
  case AtomicKind::Xor:
    combine = Kind::xori;
    break;
  }
  memref::AtomicRMWOp::create(b, loc, combine, value,
                              store.getAccessedStorage().memref,
                              place.getAccessIndices());
}

/// Joins steps of an update that follow each other in one expression: `v + a +
/// b` is one addition of a + b.
static void joinSteps(SmallVectorImpl<Step> &steps) {
  SmallVector<Step> joined;
  for (Step &step : steps) {
    Step *before = joined.empty() ? nullptr : &joined.back();
    AtomicKind kind = getCombiningKind(step.kind);
    bool canJoin = before && before->at->getBlock() == step.at->getBlock() &&
                   before->conditions == step.conditions &&
                   before->type == step.type &&
                   before->value.getType() == step.value.getType() &&
                   !isa<arith::SelectOp>(step.at) &&
                   !isa<arith::SelectOp>(before->at) && !isExtremum(kind);
    if (!canJoin) {
      joined.push_back(std::move(step));
      continue;
    }
    OpBuilder b(step.at);
    Location loc = step.at->getLoc();
    // Terms with signs are joined: +a and -b become a - b, -a and -b become -(a
    // + b).
    bool isSum = kind == AtomicKind::Add;
    if (isSum && before->kind != step.kind) {
      Value plus = before->kind == AtomicKind::Add ? before->value : step.value;
      Value minus =
          before->kind == AtomicKind::Add ? step.value : before->value;
      before->value = emitCombination(b, loc, AtomicKind::Sub, plus, minus);
      before->kind = AtomicKind::Add;
    } else {
      before->value = emitCombination(b, loc, kind, before->value, step.value);
    }
    before->at = step.at;
    before->place = step.place;
  }
  steps = std::move(joined);
}

void SharedUpdate::rewrite() {
  joinSteps(steps);
  for (Step &step : steps) {
    OpBuilder b(step.at);
    Location loc = step.at->getLoc();
    for (auto [condition, holds] : step.conditions) {
      Value test = condition;
      if (!holds)
        test = arith::XOrIOp::create(
            b, loc, test, arith::ConstantIntOp::create(b, loc, 1, 1));
      auto branch = scf::IfOp::create(b, loc, test, /*withElseRegion=*/false);
      b.setInsertionPointToStart(branch.thenBlock());
    }
    emit(b, loc, step);
  }
  if (chosen)
    chosen->rewrite(path, loads, [&](OpBuilder &b, Value value) {
      Step step{store, chosenKind, value, value.getType(), {}, store};
      emit(b, store->getLoc(), step);
    });
  else
    store->erase();
  // The results of these branches have no users any more. The branches yield
  // zeros from now on, so that the former value of the element has no user
  // either.
  for (OpResult result : branches) {
    auto branch = cast<scf::IfOp>(result.getOwner());
    for (Region *region : branch.getRegions()) {
      Operation *yield = region->front().getTerminator();
      OpBuilder b(yield);
      Value none = arith::ConstantOp::create(b, yield->getLoc(),
                                             b.getZeroAttr(result.getType()));
      yield->setOperand(result.getResultNumber(), none);
    }
    path.remove(branch);
    if (!old.reaches(branch.getCondition()))
      continue;
    OpBuilder b(branch);
    branch.getConditionMutable().assign(
        arith::ConstantIntOp::create(b, branch.getLoc(), 0, 1));
  }
  // Serial loops now carry totals, which start at the identity of the
  // operation.
  for (auto [result, kind] : totals) {
    auto serial = cast<scf::ForOp>(result.getOwner());
    OpBuilder b(serial);
    TypedAttr nothing = getIdentity(kind, getScalar(result));
    if (auto shaped = dyn_cast<ShapedType>(result.getType()))
      nothing = DenseElementsAttr::get(shaped, nothing);
    serial.getInitArgsMutable()[result.getResultNumber()].assign(
        arith::ConstantOp::create(b, serial.getLoc(), nothing));
    path.remove(serial);
  }
  SmallVector<Operation *> dead(path.begin(), path.end());
  for (DifferentiableAccessInterface load : loads)
    if (!llvm::is_contained(dead, load.getOperation()))
      dead.push_back(load);
  while (true) {
    auto *unused =
        llvm::find_if(dead, [](Operation *op) { return op->use_empty(); });
    if (unused == dead.end())
      break;
    // Erasing a branch also erases the ops inside of it, so these are dropped
    // from `dead` first.
    Operation *op = *unused;
    llvm::erase_if(dead,
                   [&](Operation *other) { return op->isAncestor(other); });
    op->erase();
  }
}
