//===- RaceExamples.cpp - Two iterations that meet ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Proves a race by an example. Iterations near the bounds of the loop are tried
// for one access; the element that it reaches there is then solved for the
// iteration of the other access. The example is finally evaluated as a whole,
// with all conditions, so that the search needs no rules about conditions: red
// and black cells, mirrored and transposed indices and periodic borders all
// need no special treatment. A search that ends without an example proves
// nothing.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Races.h"
#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// The maximum number of places and conditions that one search evaluates.
static constexpr unsigned kMostSteps = 4096;

using Numbers = llvm::SmallDenseMap<Value, int64_t, 8>;

//===----------------------------------------------------------------------===//
// Evaluation
//===----------------------------------------------------------------------===//

static std::optional<int64_t> combine(IndexNode::Kind kind, int64_t lhs,
                                      int64_t rhs) {
  using Kind = IndexNode::Kind;
  int64_t result;
  switch (kind) {
  case Kind::Quotient:
  case Kind::Remainder:
    if (rhs == 0 || rhs == -1)
      return std::nullopt;
    result = llvm::divideFloorSigned(lhs, rhs);
    return kind == Kind::Quotient ? result : lhs - result * rhs;
  case Kind::TruncatedQuotient:
  case Kind::TruncatedRemainder:
    if (rhs == 0 || rhs == -1)
      return std::nullopt;
    return kind == Kind::TruncatedQuotient ? lhs / rhs : lhs % rhs;
  case Kind::Product:
    if (llvm::MulOverflow(lhs, rhs, result))
      return std::nullopt;
    return result;
  case Kind::Min:
    return std::min(lhs, rhs);
  case Kind::Max:
    return std::max(lhs, rhs);
  }
  return std::nullopt;
}

/// Substitutes numbers for the values in `expr` that have an entry in
/// `numbers`.
static IndexExpr evaluate(const IndexExpr &expr, const Numbers &numbers) {
  IndexExpr result(expr.constant);
  for (const auto &[atom, factor] : expr.terms) {
    if (const IndexNode *node = atom.getNode()) {
      IndexExpr lhs = evaluate(node->lhs, numbers);
      IndexExpr rhs = evaluate(node->rhs, numbers);
      std::optional<int64_t> value;
      if (lhs.isConstant() && rhs.isConstant())
        value = combine(node->kind, lhs.constant, rhs.constant);
      result.add(value ? IndexExpr(*value)
                       : IndexExpr(IndexNode{node->kind, lhs, rhs}),
                 factor);
    } else if (auto known = numbers.find(atom.getValue());
               known != numbers.end()) {
      result.add(IndexExpr(known->second), factor);
    } else {
      result.add(IndexExpr(atom), factor);
    }
  }
  result.width = expr.width;
  if (result.isConstant() && !result.isExact()) {
    result.constant = llvm::SignExtend64(result.constant, result.width);
    result.width = 64;
  }
  return result;
}

namespace {
/// Evaluates conditions.
class ConditionEvaluator {
public:
  ConditionEvaluator(IndexBuilder &builder, const Numbers &numbers)
      : builder(builder), numbers(numbers) {}

  std::optional<bool> get(Value condition) {
    Operation *op = condition.getDefiningOp();
    if (!op)
      return std::nullopt;
    APInt constant;
    if (matchPattern(condition, m_ConstantInt(&constant)))
      return constant.isOne();
    if (auto both = dyn_cast<arith::AndIOp>(op))
      return getUnless(both, false);
    if (auto either = dyn_cast<arith::OrIOp>(op))
      return getUnless(either, true);
    if (auto differ = dyn_cast<arith::XOrIOp>(op)) {
      std::optional<bool> lhs = get(differ.getLhs());
      std::optional<bool> rhs = get(differ.getRhs());
      return lhs && rhs ? std::optional(*lhs != *rhs) : std::nullopt;
    }
    if (auto branch = dyn_cast<scf::IfOp>(op)) {
      std::optional<bool> taken = get(branch.getCondition());
      if (!taken)
        return std::nullopt;
      unsigned number = cast<OpResult>(condition).getResultNumber();
      return get((*taken ? branch.thenYield() : branch.elseYield())
                     .getOperand(number));
    }
    if (auto comparison = dyn_cast<arith::CmpIOp>(op))
      return getComparison(comparison);
    return std::nullopt;
  }

private:
  /// Evaluates an `and` or `or`: the result is `decisive` (false or true) as
  /// soon as one of the operands is.
  std::optional<bool> getUnless(Operation *op, bool decisive) {
    std::optional<bool> lhs = get(op->getOperand(0));
    if (lhs == decisive)
      return lhs;
    std::optional<bool> rhs = get(op->getOperand(1));
    if (rhs == decisive)
      return rhs;
    return lhs && rhs ? std::optional(!decisive) : std::nullopt;
  }

  std::optional<bool> getComparison(arith::CmpIOp comparison) {
    Type type = comparison.getLhs().getType();
    if (!type.isIntOrIndex() || type.isInteger(1))
      return std::nullopt;
    IndexExpr lhs = evaluate(builder.get(comparison.getLhs()), numbers);
    IndexExpr rhs = evaluate(builder.get(comparison.getRhs()), numbers);
    unsigned bits = type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
    if (bits > 64)
      return std::nullopt;
    if (lhs.isConstant() && rhs.isConstant()) {
      auto number = [&](const IndexExpr &expr) {
        return APInt(64, static_cast<uint64_t>(expr.constant)).trunc(bits);
      };
      return arith::applyCmpPredicate(comparison.getPredicate(), number(lhs),
                                      number(rhs));
    }
    // The two sides of the comparison are equal, so it is decided without
    // knowing their value.
    if (lhs == rhs)
      return arith::applyCmpPredicate(comparison.getPredicate(), APInt(64, 0),
                                      APInt(64, 0));
    return std::nullopt;
  }

  IndexBuilder &builder;
  const Numbers &numbers;
};
} // namespace

//===----------------------------------------------------------------------===//
// Sides
//===----------------------------------------------------------------------===//

namespace {
/// One of the two accesses of a race, and the loops and conditions that
/// determine whether the access runs and which element it reaches.
class Side {
public:
  Side(IndexBuilder &builder, DifferentiableAccessInterface access, LoopBox box)
      : builder(builder), box(std::move(box)) {
    place = builder.get(access.getAccessIndices());
    components = builder.get(access.getAccessComponents());
    LoopBox narrow = this->box;
    if (narrowToAccess(access, narrow))
      this->box = narrow;
    Operation *inner = access;
    for (Operation *op = access->getParentOp(); op != this->box.loop;
         inner = op, op = op->getParentOp()) {
      if (auto branch = dyn_cast<scf::IfOp>(op)) {
        bool holds =
            branch.getThenRegion().isAncestor(inner->getParentRegion());
        conditions.emplace_back(branch.getCondition(), holds);
      } else if (auto serial = dyn_cast<scf::ForOp>(op)) {
        serials.push_back(serial);
      } else {
        isKnown = false;
      }
    }
    std::reverse(serials.begin(), serials.end());
    llvm::append_range(ivs, this->box.ivs());
    for (scf::ForOp serial : serials)
      ivs.push_back(serial.getInductionVar());
  }

  size_t getRank() { return box.ivs().size(); }

  /// Returns the values to try for loop index number `number`, given the
  /// indices of the loops around that loop.
  SmallVector<int64_t> getCandidates(unsigned number, const Numbers &numbers) {
    SmallVector<int64_t> values;
    if (number >= getRank()) {
      auto range = getRange(serials[number - getRank()], numbers);
      if (!range)
        return values;
      auto [lower, count, step] = *range;
      for (int64_t i : {int64_t(0), int64_t(1), count - 1})
        if (i >= 0 && i < count &&
            !llvm::is_contained(values, lower + i * step))
          values.push_back(lower + i * step);
      return values;
    }
    int64_t lower = box.lower[number], upper = box.upper[number];
    int64_t middle = lower + (upper - lower) / 2;
    int64_t atEnds = getRank() == 1 ? 8 : getRank() == 2 ? 3 : 2;
    auto add = [&](int64_t value) {
      if (value >= lower && value < upper && !llvm::is_contained(values, value))
        values.push_back(value);
    };
    // Small numbers are tried first, since they make better examples.
    for (int64_t i = 0; i != atEnds; ++i)
      add(lower + i);
    add(middle);
    for (int64_t i = 0; i != atEnds; ++i)
      add(upper - 1 - i);
    return values;
  }

  /// True if the access certainly runs in the iteration with the loop indices
  /// `numbers`.
  bool runs(const Numbers &numbers) {
    for (auto [dim, iv] : llvm::enumerate(box.ivs())) {
      int64_t value = numbers.lookup(iv);
      if (value < box.lower[dim] || value >= box.upper[dim])
        return false;
    }
    for (scf::ForOp serial : serials) {
      auto range = getRange(serial, numbers);
      if (!range)
        return false;
      auto [lower, count, step] = *range;
      int64_t passed = numbers.lookup(serial.getInductionVar()) - lower;
      if (passed < 0 || passed % step != 0 || passed / step >= count)
        return false;
    }
    ConditionEvaluator evaluator(builder, numbers);
    return llvm::all_of(conditions, [&](auto &condition) {
      return evaluator.get(condition.first) == condition.second;
    });
  }

  IndexBuilder &builder;
  LoopBox box;
  SmallVector<IndexExpr> place, components;
  /// The indices of the parallel loop, then those of the serial loops within
  /// it, outermost first.
  SmallVector<Value> ivs;
  /// True if nothing but serial loops and branches is between the parallel loop
  /// and the access.
  bool isKnown = true;

private:
  struct Range {
    int64_t lower, count, step;
  };

  std::optional<Range> getRange(scf::ForOp serial, const Numbers &numbers) {
    IndexExpr lower = evaluate(builder.get(serial.getLowerBound()), numbers);
    IndexExpr upper = evaluate(builder.get(serial.getUpperBound()), numbers);
    IndexExpr step = evaluate(builder.get(serial.getStep()), numbers);
    if (!lower.isConstant() || !upper.isConstant() || !step.isConstant() ||
        step.constant <= 0 || serial.getUnsignedCmp())
      return std::nullopt;
    int64_t extent;
    if (llvm::SubOverflow(upper.constant, lower.constant, extent))
      return std::nullopt;
    int64_t count = extent <= 0 ? 0 : (extent - 1) / step.constant + 1;
    return Range{lower.constant, count, step.constant};
  }

  SmallVector<scf::ForOp> serials;
  SmallVector<std::pair<Value, bool>> conditions;
};

/// Searches for an example.
class Search {
public:
  Search(Side &first, Side &second) : first(first), second(second) {
    // If only one access has component indices, only the elements are compared:
    // a whole element overlaps each of its components.
    compares = first.components.size() == second.components.size();
  }

  std::optional<IterationPair> run() {
    return tryFirst(0) ? std::optional(found) : std::nullopt;
  }

private:
  bool step() { return ++steps < kMostSteps; }

  SmallVector<IndexExpr> getPlace(Side &side, const Numbers &numbers) {
    SmallVector<IndexExpr> place;
    for (const IndexExpr &index : side.place)
      place.push_back(evaluate(index, numbers));
    if (compares)
      for (const IndexExpr &index : side.components)
        place.push_back(evaluate(index, numbers));
    return place;
  }

  /// Tries values for the loop indices of the first access, from index number
  /// `number` on. True if an example is found.
  bool tryFirst(unsigned number) {
    if (!step())
      return false;
    if (number == first.ivs.size()) {
      if (!first.runs(ofFirst))
        return false;
      element = getPlace(first, ofFirst);
      // Parts of the element's indices that remain symbolic must have the same
      // value in both iterations.
      auto isFromOutside = [&](Value value) {
        return !first.box.loop->isAncestor(
            value.getParentBlock()->getParentOp());
      };
      return llvm::all_of(element,
                          [&](const IndexExpr &index) {
                            return index.allOf(isFromOutside);
                          }) &&
             trySecond(Numbers());
    }
    for (int64_t value : first.getCandidates(number, ofFirst)) {
      ofFirst[first.ivs[number]] = value;
      if (tryFirst(number + 1))
        return true;
      ofFirst.erase(first.ivs[number]);
    }
    return false;
  }

  /// Computes the indices of the second access that the element determines.
  /// False if the second access cannot reach the element.
  bool solve(Numbers &numbers) {
    bool changed = true;
    while (changed) {
      changed = false;
      for (auto [index, wanted] :
           llvm::zip(getPlace(second, numbers), element)) {
        Value unknown;
        unsigned count = 0;
        for (Value iv : second.ivs)
          if (!numbers.contains(iv) && index.mentions(iv)) {
            unknown = iv;
            ++count;
          }
        if (count > 1)
          continue;
        if (count == 0) {
          if (!(index == wanted))
            return false;
          continue;
        }
        int64_t factor = index.getCoefficient(unknown);
        IndexExpr rest = wanted;
        rest.add(index, -1).add(IndexExpr(unknown), factor);
        // The equation cannot be solved if the rest of it contains the unknown,
        // for example in a quotient.
        if (factor == 0 || !rest.isConstant())
          continue;
        if (rest.constant % factor != 0)
          return false;
        numbers[unknown] = rest.constant / factor;
        changed = true;
      }
    }
    return true;
  }

  bool trySecond(Numbers numbers) {
    if (!step() || !solve(numbers))
      return false;
    for (auto [number, iv] : llvm::enumerate(second.ivs)) {
      if (numbers.contains(iv))
        continue;
      for (int64_t value : second.getCandidates(number, numbers)) {
        Numbers more = numbers;
        more[iv] = value;
        if (trySecond(std::move(more)))
          return true;
      }
      return false;
    }
    auto get = [](Side &side, const Numbers &of) {
      return llvm::map_to_vector(
          side.box.ivs(), [&](Value iv) -> int64_t { return of.lookup(iv); });
    };
    found = {get(first, ofFirst), get(second, numbers)};
    return found.lhs != found.rhs && second.runs(numbers);
  }

  Side &first, &second;
  bool compares;
  Numbers ofFirst;
  SmallVector<IndexExpr> element;
  IterationPair found;
  unsigned steps = 0;
};
} // namespace

std::optional<IterationPair>
mlir::tai::findExample(DifferentiableAccessInterface lhs,
                       DifferentiableAccessInterface rhs) {
  auto loop = dyn_cast_if_present<ParallelForOp>(getEnclosingParallelLoop(lhs));
  if (!loop || loop.getSerialize() || getEnclosingParallelLoop(rhs) != loop ||
      lhs.getAccessIndices().size() != rhs.getAccessIndices().size())
    return std::nullopt;
  std::optional<LoopBox> box = getConstantBox(loop);
  if (!box)
    return std::nullopt;
  IndexBuilder builder;
  Side left(builder, lhs, *box), right(builder, rhs, *box);
  if (!left.isKnown || !right.isKnown)
    return std::nullopt;
  if (auto found = Search(left, right).run())
    return found;
  // The search is repeated with the accesses exchanged: an index in a quotient,
  // which cannot be solved for, is then tried.
  auto found = Search(right, left).run();
  if (found)
    std::swap(found->lhs, found->rhs);
  return found;
}
