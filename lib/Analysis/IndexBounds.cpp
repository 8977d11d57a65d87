//===- IndexBounds.cpp - Indices and the loops around them ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of IndexBounds that looks at loops and conditions, and decides.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IndexBounds.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "tai/Support/BoundsMode.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

/// So many ways in which conditions can hold are told apart. Each takes the
/// time of a system.
static constexpr size_t kMaxPieces = 8;

bool tai::checksIndices(Operation *op) {
  auto kernel = dyn_cast<KernelOp>(op);
  if (!kernel)
    kernel = op->getParentOfType<KernelOp>();
  return kernel && kernel->hasAttr(kChecksIndicesAttrName);
}

//===----------------------------------------------------------------------===//
// Conditions
//===----------------------------------------------------------------------===//

void IndexBounds::addRow(Domain &domain, const LinearSum &row) {
  for (SmallVector<LinearSum> &piece : domain.pieces)
    piece.push_back(row);
}

void IndexBounds::addFacts(Domain &domain, const Form &form) {
  for (const LinearSum &fact : form.facts)
    addRow(domain, fact);
  domain.isCertain &= form.isCertain;
  domain.isComplete &= form.isComplete;
}

/// lhs - rhs >= gap.
void IndexBounds::addComparison(Domain &domain, Value lhs, Value rhs,
                                int64_t gap) {
  Form difference = combine(formOf(lhs), formOf(rhs), -1);
  addFacts(domain, difference);
  addRow(domain, difference.sum.plus(-gap));
}

/// The union of what the two make of the domain.
void IndexBounds::addEither(Domain &domain, function_ref<void(Domain &)> first,
                            function_ref<void(Domain &)> second) {
  Domain other = domain;
  first(domain);
  second(other);
  domain.isCertain &= other.isCertain;
  domain.isComplete &= other.isComplete;
  domain.pieces.append(other.pieces.begin(), other.pieces.end());
}

void IndexBounds::addCondition(Domain &domain, Value condition, bool holds) {
  auto give = [&] { domain.isCertain = false; };
  if (domain.pieces.size() >= kMaxPieces)
    return give();
  APInt constant;
  if (matchPattern(condition, m_ConstantInt(&constant))) {
    if (constant.isOne() != holds)
      domain.pieces.clear();
    return;
  }
  auto both = [&](Value a, bool aHolds, Value b, bool bHolds) {
    addCondition(domain, a, aHolds);
    addCondition(domain, b, bHolds);
  };
  auto either = [&](Value a, bool aHolds, Value b, bool bHolds) {
    addEither(
        domain, [&](Domain &one) { addCondition(one, a, aHolds); },
        [&](Domain &one) { addCondition(one, b, bHolds); });
  };
  Operation *op = condition.getDefiningOp();
  if (auto conjunction = dyn_cast_if_present<arith::AndIOp>(op))
    return holds ? both(conjunction.getLhs(), true, conjunction.getRhs(), true)
                 : either(conjunction.getLhs(), false, conjunction.getRhs(),
                          false);
  if (auto disjunction = dyn_cast_if_present<arith::OrIOp>(op))
    return holds
               ? either(disjunction.getLhs(), true, disjunction.getRhs(), true)
               : both(disjunction.getLhs(), false, disjunction.getRhs(), false);
  if (auto difference = dyn_cast_if_present<arith::XOrIOp>(op)) {
    if (matchPattern(difference.getRhs(), m_One()))
      return addCondition(domain, difference.getLhs(), !holds);
    return give();
  }
  if (auto select = dyn_cast_if_present<arith::SelectOp>(op)) {
    // "and" and "or" that ask for the second only where it matters.
    if (matchPattern(select.getFalseValue(), m_Zero()))
      return holds ? both(select.getCondition(), true, select.getTrueValue(),
                          true)
                   : either(select.getCondition(), false, select.getTrueValue(),
                            false);
    if (matchPattern(select.getTrueValue(), m_One()))
      return holds ? either(select.getCondition(), true, select.getFalseValue(),
                            true)
                   : both(select.getCondition(), false, select.getFalseValue(),
                          false);
  }
  if (isLaunchValue(condition)) {
    Form form = formOf(condition);
    addFacts(domain, form);
    return addRow(domain,
                  holds ? form.sum.plus(-1) : LinearSum().plus(form.sum, -1));
  }
  auto compare = dyn_cast_if_present<arith::CmpIOp>(op);
  if (!compare || compare.getLhs().getType().isInteger(1))
    return give();
  using Predicate = arith::CmpIPredicate;
  Predicate predicate = compare.getPredicate();
  if (!holds)
    predicate = arith::invertPredicate(predicate);
  Value a = compare.getLhs(), b = compare.getRhs();
  switch (predicate) {
  case Predicate::sge:
    return addComparison(domain, a, b, 0);
  case Predicate::sgt:
    return addComparison(domain, a, b, 1);
  case Predicate::sle:
    return addComparison(domain, b, a, 0);
  case Predicate::slt:
    return addComparison(domain, b, a, 1);
  case Predicate::eq:
    addComparison(domain, a, b, 0);
    return addComparison(domain, b, a, 0);
  case Predicate::ne:
    return addEither(
        domain, [&](Domain &one) { addComparison(one, a, b, 1); },
        [&](Domain &one) { addComparison(one, b, a, 1); });
  case Predicate::ult:
  case Predicate::ule:
    // 0 <= a < b, where b is not negative.
    if (rangeOf(b).low < 0)
      return give();
    addRow(domain, formOf(a).sum);
    return addComparison(domain, b, a, predicate == Predicate::ult);
  case Predicate::uge:
  case Predicate::ugt:
    if (rangeOf(a).low < 0 || rangeOf(b).low < 0)
      return give();
    return addComparison(domain, a, b, predicate == Predicate::ugt);
  }
}

//===----------------------------------------------------------------------===//
// Loops
//===----------------------------------------------------------------------===//

/// lower <= iv < upper.
void IndexBounds::addLoop(Domain &domain, BlockArgument iv, Value lower,
                          Value upper) {
  Form index = formOf(iv);
  for (auto [variable, factor] : index.sum.terms)
    if (variables[variable].kind == Variable::Kind::Loop &&
        !llvm::is_contained(domain.loops, variable))
      domain.loops.push_back(variable);
  addComparison(domain, iv, lower, 0);
  addComparison(domain, upper, iv, 1);
}

void IndexBounds::addLoop(Domain &domain, ParallelForOp loop) {
  if (!loop.isStructFor()) {
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      addLoop(domain, iv, lower, upper);
    return;
  }
  FailureOr<FieldLayout> layout =
      getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  if (failed(layout)) {
    domain.isCertain = false;
    return;
  }
  for (auto [iv, first, extent] :
       llvm::zip(loop.getInductionVars(), layout->offset, layout->shape)) {
    Form index = formOf(iv);
    // An axis of one element has no variable.
    for (auto [variable, factor] : index.sum.terms)
      domain.loops.push_back(variable);
    addRow(domain, index.sum.plus(-first));
    addRow(domain, LinearSum::of(first + extent - 1).plus(index.sum, -1));
  }
  // Active cells are some of these.
  domain.isCertain &= !loop.getLevel() && !layout->path.getFirstSparse();
}

IndexBounds::Domain IndexBounds::domainOf(Block *block) {
  if (auto known = domains.find(block); known != domains.end())
    return known->second;
  Operation *parent = block->getParentOp();
  Domain domain;
  if (parent == kernel) {
    domain.pieces.emplace_back();
    return domains[block] = domain;
  }
  domain = domainOf(parent->getBlock());
  if (auto loop = dyn_cast<ParallelForOp>(parent)) {
    addLoop(domain, loop);
  } else if (auto serial = dyn_cast<scf::ForOp>(parent)) {
    std::optional<int64_t> step = getConstantIntValue(serial.getStep());
    auto iv = cast<BlockArgument>(serial.getInductionVar());
    size_t outer = domain.loops.size();
    if (serial.getUnsignedCmp()) {
      domain.isCertain = false;
    } else {
      addLoop(domain, iv, serial.getLowerBound(), serial.getUpperBound());
      domain.isCertain &= step && *step > 0;
    }
    // Counted from zero, unless there is one iteration and nothing to count.
    if (step && *step > 1 && domain.loops.size() > outer)
      addRow(domain, LinearSum::variable(domain.loops.back()));
  } else if (auto branch = dyn_cast<scf::IfOp>(parent)) {
    addCondition(domain, branch.getCondition(), block == branch.thenBlock());
  } else {
    domain.isCertain = false;
  }
  return domains[block] = domain;
}

//===----------------------------------------------------------------------===//
// Decisions
//===----------------------------------------------------------------------===//

void IndexBounds::checkPiece(const Domain &domain, LinearSystem system,
                             BoundsAnswer &answer, bool &isExact) {
  // Whether it happens in no launch at all. Ranges of what the launch is given
  // help there, and stay out of what it is to check.
  LinearSystem all = system;
  SmallVector<unsigned> used = system.getVariables();
  for (unsigned number : used) {
    NumberRange range = variables[number].range;
    LinearSum self = LinearSum::variable(number);
    if (range.low != INT64_MIN)
      all.require(self.plus(LinearSum::of(range.low), -1));
    if (range.high != INT64_MAX)
      all.require(LinearSum::of(range.high).plus(self, -1));
  }
  bool ignored = true;
  for (unsigned number : llvm::reverse(used))
    if (!all.isContradictory() && !all.isUnknown())
      all = all.eliminate(number, LinearSystem::Shadow::Real, ignored);
  if (all.isContradictory())
    return;
  isExact &= !all.isUnknown();
  answer.isInRange = false;
  if (!domain.isCertain)
    return;

  eliminateLoops(domain, std::move(system), {}, answer, isExact);
}

/// Adds the violation of launches in which the system holds in an iteration,
/// of which `violation` tells some loop indices.
void IndexBounds::eliminateLoops(const Domain &domain, LinearSystem system,
                                 Violation violation, BoundsAnswer &answer,
                                 bool &isExact) {
  // Innermost first. Loops are kept for the report.
  SmallVector<Violation::Step> known = std::move(violation.iteration);
  violation.iteration.clear();
  SmallVector<unsigned> used = system.getVariables(), order;
  for (unsigned number : used)
    if (variables[number].kind == Variable::Kind::Quotient)
      order.push_back(number);
  for (unsigned number : llvm::reverse(domain.loops))
    if (llvm::is_contained(used, number))
      order.push_back(number);
  for (unsigned number : order) {
    violation.iteration.push_back({number, system});
    system = system.eliminate(number, LinearSystem::Shadow::Dark, isExact);
    if (system.isContradictory() || system.isUnknown())
      break;
  }
  std::reverse(violation.iteration.begin(), violation.iteration.end());
  violation.iteration.insert(violation.iteration.begin(), known.begin(),
                             known.end());
  if (system.isUnknown()) {
    isExact = false;
    return;
  }
  if (system.isContradictory())
    return;
  for (const LinearSum &row : system.getRows()) {
    for (auto [variable, factor] : row.terms)
      if (!getLaunchValue(variable)) {
        isExact = false;
        return;
      }
    if (rangeOfSum(row).low < 0)
      violation.launch.require(row);
  }
  answer.violations.push_back(std::move(violation));
}

/// The index is beyond one end of its range in an iteration.
void IndexBounds::checkSide(const Domain &domain, const LinearSum &beyond,
                            BoundsAnswer &answer, bool &isExact) {
  // Nearly all indices are a loop's, or next to it.
  if (rangeOfSum(beyond).high < 0)
    return;
  for (const SmallVector<LinearSum> &piece : domain.pieces) {
    LinearSystem system;
    system.require(piece);
    system.require(beyond);
    if (hasProduct(beyond))
      checkCorners(domain, piece, beyond, answer, isExact);
    else
      checkPiece(domain, std::move(system), answer, isExact);
  }
}

BoundsAnswer IndexBounds::check(const IndexedAccess &access, size_t number,
                                bool proves) {
  BoundsAnswer answer;
  Value index = access.indices[number]->get();
  int64_t first = access.first[number];
  const Extent &extent = access.extents[number];
  NumberRange range = rangeOf(index);
  if (!extent.array && range.isWithin({first, first + extent.number - 1})) {
    answer.isInRange = answer.isDecided = true;
    return answer;
  }
  Form form = formOf(index);
  if (!form.isCertain && !proves)
    return answer;
  Form size;
  size.sum = LinearSum::of(extent.number);
  if (extent.array)
    size = makeLaunchForm({{}, extent.array, extent.number},
                          NumberRange{0, int64_t(1) << 47});
  Domain domain = domainOf(access.op->getBlock());
  addFacts(domain, form);
  answer.isInRange = true;
  bool isExact = true;
  // first - 1 - index >= 0, and index - (first + size) >= 0.
  checkSide(domain, LinearSum::of(first - 1).plus(form.sum, -1), answer,
            isExact);
  checkSide(domain, form.sum.plus(size.sum, -1).plus(-first), answer, isExact);
  answer.isInRange &= domain.isComplete;
  answer.isDecided =
      answer.isInRange || (domain.isComplete && domain.isCertain && isExact);
  return answer;
}

//===----------------------------------------------------------------------===//
// Accesses
//===----------------------------------------------------------------------===//

std::string tai::describeField(const FieldLayout &layout) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "field '@" << FieldOp(layout.field).getSymName() << "' of shape [";
  llvm::interleaveComma(layout.shape, os);
  os << "]";
  if (llvm::any_of(layout.offset, [](int64_t o) { return o != 0; })) {
    os << " from [";
    llvm::interleaveComma(layout.offset, os);
    os << "]";
  }
  return text;
}

std::string tai::describeArray(MemRefType type) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "an array of " << type.getElementType() << " of shape [";
  llvm::interleaveComma(type.getShape(), os, [&](int64_t extent) {
    if (ShapedType::isDynamic(extent))
      os << '?';
    else
      os << extent;
  });
  os << "]";
  return text;
}

/// The index along which the innermost list above a field grows; it is not
/// among the indices of the list.
static std::optional<unsigned> findListDimension(const FieldLayout &layout) {
  for (const PathLevel &level : llvm::reverse(layout.path.levels))
    if (level.type.isList())
      for (auto [dimension, axis] : llvm::enumerate(layout.axisOfIndex))
        if (llvm::is_contained(level.type.getAxes(), axis))
          return dimension;
  return std::nullopt;
}

static std::optional<IndexedAccess> getFieldAccess(Operation *op,
                                                   FlatSymbolRefAttr name,
                                                   MutableOperandRange indices,
                                                   bool isOfList = false) {
  FieldOp field = lookupField(op, name);
  FailureOr<FieldLayout> layout =
      field ? getFieldLayout(field) : FailureOr<FieldLayout>();
  if (failed(layout))
    return std::nullopt;
  IndexedAccess access{op, describeField(*layout), {}, {}, {}};
  std::optional<unsigned> left =
      isOfList ? findListDimension(*layout) : std::nullopt;
  if (isOfList && !left)
    return std::nullopt;
  for (size_t d = 0; d != layout->shape.size(); ++d) {
    if (left && *left == d)
      continue;
    access.first.push_back(layout->offset[d]);
    access.extents.push_back({layout->shape[d]});
  }
  for (OpOperand &index : indices)
    access.indices.push_back(&index);
  access.rank = access.indices.size();
  if (access.rank != access.extents.size())
    return std::nullopt;
  return access;
}

static void addComponents(IndexedAccess &access, FieldOp field,
                          MutableOperandRange components) {
  auto type = dyn_cast<VectorType>(field.getType());
  if (!type)
    return;
  for (auto [number, component] : llvm::enumerate(components)) {
    access.indices.push_back(&component);
    access.first.push_back(0);
    access.extents.push_back({type.getDimSize(number)});
  }
}

static std::optional<IndexedAccess>
getArrayAccess(Operation *op, Value array, MutableOperandRange indices) {
  auto type = cast<MemRefType>(array.getType());
  // Others are memory of the kernel itself.
  if (!isa<BlockArgument>(array))
    return std::nullopt;
  IndexedAccess access{op, describeArray(type), {}, {}, {}};
  for (auto [d, index] : llvm::enumerate(indices)) {
    access.indices.push_back(&index);
    access.first.push_back(0);
    access.extents.push_back(type.isDynamicDim(d)
                                 ? Extent{int64_t(d), array}
                                 : Extent{type.getDimSize(d), {}});
  }
  access.rank = access.indices.size();
  return access;
}

std::optional<IndexedAccess> IndexedAccess::get(Operation *op) {
  auto ofField = [&](auto access) {
    std::optional<IndexedAccess> result =
        getFieldAccess(op, access.getFieldAttr(), access.getIndicesMutable());
    if (result)
      addComponents(*result, lookupField(op, access.getFieldAttr()),
                    access.getComponentsMutable());
    return result;
  };
  auto ofCell = [&](auto access, bool isOfList) {
    return getFieldAccess(op, access.getFieldAttr(), access.getIndicesMutable(),
                          isOfList);
  };
  return llvm::TypeSwitch<Operation *, std::optional<IndexedAccess>>(op)
      .Case<LoadOp, StoreOp, AtomicOp>(ofField)
      .Case<ActivateOp, DeactivateOp, IsActiveOp>(
          [&](auto access) { return ofCell(access, false); })
      .Case<LengthOp, AppendOp>(
          [&](auto access) { return ofCell(access, true); })
      .Case([&](memref::LoadOp load) {
        return getArrayAccess(op, load.getMemRef(), load.getIndicesMutable());
      })
      .Case([&](memref::StoreOp store) {
        return getArrayAccess(op, store.getMemRef(), store.getIndicesMutable());
      })
      .Case([&](memref::AtomicRMWOp atomic) {
        return getArrayAccess(op, atomic.getMemref(),
                              atomic.getIndicesMutable());
      })
      .Default([](Operation *) { return std::nullopt; });
}
