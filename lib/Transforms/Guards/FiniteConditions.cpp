//===- FiniteConditions.cpp - When guards are not needed ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "FiniteConditions.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/ZeroTests.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::passesOn(OpOperand &use) {
  Operation *op = use.getOwner();
  if (isa<arith::DivFOp>(op) || isa<arith::SelectOp>(op))
    return isa<arith::DivFOp>(op) ? use.getOperandNumber() == 0
                                  : use.getOperandNumber() != 0;
  return isa<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::MulFOp,
             arith::ExtFOp, arith::TruncFOp, vector::BroadcastOp,
             vector::ExtractOp, vector::FromElementsOp, vector::InsertOp,
             vector::ShapeCastOp, vector::ToElementsOp, vector::FMAOp,
             math::FmaOp, SumOp, TransposeOp, MatmulOp, OuterOp, CrossOp,
             DotOp>(op);
}

bool mlir::tai::keepsNonFinite(OpOperand &use) {
  Operation *op = use.getOwner();
  if (isa<math::AbsFOp, math::SqrtOp, math::LogOp, math::Log2Op, math::Log10Op,
          math::Log1pOp, NormOp, DeterminantOp, TraceOp>(op))
    // A trace drops the elements off the diagonal of its operand; the other ops
    // drop none.
    return !isa<TraceOp>(op);
  return passesOn(use) && !isa<arith::SelectOp, vector::ExtractOp,
                               vector::InsertOp, vector::ToElementsOp>(op);
}

int64_t mlir::tai::countComponents(ArrayRef<Value> values) {
  int64_t count = 0;
  for (Value value : values)
    if (auto vector = dyn_cast<VectorType>(value.getType()))
      count += vector.getNumElements();
    else
      ++count;
  return count;
}

/// Combines values by twos, as a tree, to keep chains of dependences short.
static Value createTree(SmallVector<Value> values,
                        function_ref<Value(Value, Value)> create) {
  while (values.size() > 1) {
    SmallVector<Value> pairs;
    for (size_t i = 0; i + 1 < values.size(); i += 2)
      pairs.push_back(create(values[i], values[i + 1]));
    if (values.size() % 2)
      pairs.push_back(values.back());
    values = std::move(pairs);
  }
  return values.front();
}

static Value createAnd(OpBuilder &builder, Location loc, Value a, Value b) {
  return a ? Value(arith::AndIOp::create(builder, loc, a, b)) : b;
}

/// If all values are finite and their sum does not overflow, zero times the sum
/// is not NaN. The product is not compared with zero, since LLVM assumes that
/// floats are unlikely to be equal, and likely to be ordered.
Value mlir::tai::createTestOfFinite(OpBuilder &builder, Location loc,
                                    ArrayRef<Value> values) {
  llvm::SmallMapVector<Type, SmallVector<Value>, 2> terms;
  for (Value term : values) {
    if (isa<VectorType>(term.getType()))
      term = SumOp::create(builder, loc, getElementTypeOrSelf(term.getType()),
                           term);
    terms[term.getType()].push_back(term);
  }
  Value all;
  for (auto &[type, values] : terms) {
    Value sum = createTree(values, [&](Value a, Value b) {
      return arith::AddFOp::create(builder, loc, a, b).getResult();
    });
    Value zero = arith::ConstantOp::create(
        builder, loc, cast<TypedAttr>(builder.getZeroAttr(type)));
    Value product = arith::MulFOp::create(builder, loc, sum, zero);
    all =
        createAnd(builder, loc, all,
                  arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::ORD,
                                        product, product));
  }
  return all;
}

//===----------------------------------------------------------------------===//
// Conditions
//===----------------------------------------------------------------------===//

namespace {
/// Finds the values of a guarded product that depend on the adjoint which the
/// guard tests.
class Product {
public:
  explicit Product(arith::SelectOp guard)
      : block(guard->getBlock()), seed(getGuarded(guard)) {}
  bool dependsOnSeed(Value value) {
    if (!seed || value == seed)
      return static_cast<bool>(seed);
    Operation *op = value.getDefiningOp();
    if (!op || op->getBlock() != block || op->getNumRegions() != 0)
      return false;
    auto [it, isNew] = known.try_emplace(value, false);
    if (!isNew)
      return it->second;
    bool depends = llvm::any_of(op->getOperands(), [&](Value operand) {
      return dependsOnSeed(operand);
    });
    return known[value] = depends;
  }

private:
  Block *block;
  Value seed;
  DenseMap<Value, bool> known;
};
} // namespace

/// True for the divisor in the derivative of a norm, which divides by the norm
/// or its product with a power of two, and selects zero where the norm is zero.
static bool isDivisorOfNorm(OpOperand &use) {
  Operation *op = use.getOwner();
  if (!isa<arith::DivFOp>(op) || use.getOperandNumber() != 1 ||
      !op->hasOneUse())
    return false;
  Value norm = use.get();
  if (auto product = norm.getDefiningOp<arith::MulFOp>())
    norm = product.getLhs();
  auto select = dyn_cast<arith::SelectOp>(*op->user_begin());
  if (!norm.getDefiningOp<NormOp>() || !select ||
      select.getFalseValue() != op->getResult(0))
    return false;
  return getTestedForZero(select) == norm;
}

/// Requires that the factors of the adjoint in the guard's product are finite,
/// and its divisors far from zero.
bool FiniteConditions::requirePartial(arith::SelectOp guard) {
  Product product(guard);
  Value result = guard.getFalseValue();
  if (!product.dependsOnSeed(result))
    return requireFinite(result, guard);
  SmallVector<Value> pending = {result};
  DenseSet<Value> seen;
  while (!pending.empty()) {
    Value value = pending.pop_back_val();
    Operation *op = value.getDefiningOp();
    if (!seen.insert(value).second || value == getGuarded(guard))
      continue;
    for (OpOperand &operand : op->getOpOperands()) {
      if (product.dependsOnSeed(operand.get())) {
        if (!passesOn(operand))
          return false;
        pending.push_back(operand.get());
        continue;
      }
      bool isDivisor = isa<arith::DivFOp>(op) &&
                       operand.getOperandNumber() == 1 &&
                       !isDivisorOfNorm(operand);
      if (isDivisor ? !requireClear(operand.get(), op)
                    : !requireFinite(operand.get(), op))
        return false;
    }
  }
  return true;
}

/// Requires that those values are finite on which `value` depends and which
/// come from iterations or from outside of the block.
bool FiniteConditions::requireSeeds(Value value, Block &block) {
  if (!isFloatOrVector(value.getType()) || !followed.insert(value).second)
    return true;
  if (isa<BlockArgument>(value)) {
    finite.insert(value);
    return true;
  }
  Operation *op = value.getDefiningOp();
  if (apart.contains(op)) {
    finite.insert(value);
    return true;
  }
  // The conditions of guards outside of the block are not required here: values
  // from outside may be infinite.
  bool comesFromAround = !block.findAncestorOpInBlock(*op);
  if (isa<LoopLikeOpInterface>(op) ||
      (comesFromAround && facts.mayBeNonFinite(value))) {
    finite.insert(value);
    return true;
  }
  if (comesFromAround)
    return true;
  bool all = true;
  if (auto branch = dyn_cast<scf::IfOp>(op)) {
    unsigned number = cast<OpResult>(value).getResultNumber();
    for (Region &region : branch->getRegions())
      all &= requireSeeds(region.front().getTerminator()->getOperand(number),
                          block);
    return all;
  }
  if (op->getNumRegions() != 0)
    return false;
  for (Value operand : op->getOperands())
    all &= requireSeeds(operand, block);
  return all;
}

bool FiniteConditions::require(arith::SelectOp guard, Block &block) {
  scope = &block;
  return guard->hasAttr(kInfiniteGuard)
             ? requireSeeds(guard.getFalseValue(), block)
             : requirePartial(guard);
}

/// True if a value is not analyzed further: it is read from memory, or it is an
/// argument of a block or a result of an op with regions.
static bool isLeaf(Value value) {
  Operation *op = value.getDefiningOp();
  return !op || op->getNumRegions() != 0 || !isMemoryEffectFree(op);
}

/// True for ops whose results are finite if their operands are, apart from
/// overflow.
static bool isFiniteOfFinite(Operation *op) {
  return isa<arith::AddFOp, arith::SubFOp, arith::NegFOp, arith::MulFOp,
             math::FmaOp, vector::FMAOp, arith::ExtFOp, arith::TruncFOp,
             arith::MaximumFOp, arith::MinimumFOp, arith::MaxNumFOp,
             arith::MinNumFOp, arith::SIToFPOp, arith::UIToFPOp, math::AbsFOp,
             math::CopySignOp, math::SinOp, math::CosOp, math::TanhOp,
             math::AtanOp, math::Atan2Op, math::ErfOp, math::ErfcOp,
             vector::BroadcastOp, vector::ExtractOp, vector::FromElementsOp,
             vector::InsertOp, vector::ShapeCastOp, vector::ToElementsOp, SumOp,
             TransposeOp, MatmulOp, DotOp, CrossOp, OuterOp, NormOp, TraceOp,
             DeterminantOp, StopGradientOp>(op);
}

/// True for a select of the operands that its condition compares: a maximum or
/// minimum.
static bool isGreatestOrLeast(Operation *op) {
  auto select = dyn_cast<arith::SelectOp>(op);
  if (!select)
    return false;
  Value condition = select.getCondition();
  // The condition of max(a, b) may be `a > b or isnan(b)`: look at its first
  // part.
  if (auto either = condition.getDefiningOp<arith::OrIOp>())
    condition = either.getLhs();
  auto test = condition.getDefiningOp<arith::CmpFOp>();
  return test && ((test.getLhs() == select.getTrueValue() &&
                   test.getRhs() == select.getFalseValue()) ||
                  (test.getRhs() == select.getTrueValue() &&
                   test.getLhs() == select.getFalseValue()));
}

/// True for a norm, or its product with a power of two, if a select replaces it
/// by a non-zero constant where it is zero.
static bool isNormOrNumber(Value value) {
  auto select = value.getDefiningOp<arith::SelectOp>();
  if (!select || !matchPattern(select.getTrueValue(), m_Constant()) ||
      matchPattern(select.getTrueValue(), m_AnyZeroFloat()))
    return false;
  Value norm = select.getFalseValue();
  if (auto product = norm.getDefiningOp<arith::MulFOp>())
    norm = product.getLhs();
  return norm.getDefiningOp<NormOp>() && getTestedForZero(select) == norm;
}

bool FiniteConditions::requireFinite(Value value, Operation *at) {
  if (!isFloatOrVector(value.getType()) || !required.insert(value).second)
    return true;
  Operation *op = value.getDefiningOp();
  if (isLeaf(value) || apart.contains(op)) {
    finite.insert(value);
    return true;
  }
  if (matchPattern(op, m_Constant()))
    return !facts.mayBeNonFinite(value);
  // A guarded product whose own conditions hold is finite if its adjoint factor
  // is. This factor may come from guards before this part of the block.
  if (isGuard(op))
    return requireSeeds(value, *scope);
  if (auto extract = dyn_cast<vector::ExtractOp>(op);
      extract && isLeaf(extract.getSource())) {
    finite.insert(value);
    return true;
  }
  if (auto division = dyn_cast<arith::DivFOp>(op)) {
    if (isa<VectorType>(value.getType()) ||
        facts.isNonZero(division.getRhs(), op))
      return requireQuotient(division.getLhs(), division.getRhs(), op);
    cleared.insert(division.getRhs());
    finite.insert(value);
    return true;
  }
  // The product of two large numbers may overflow, so the product itself is
  // tested.
  if (isa<arith::MulFOp>(op) && !isa<VectorType>(value.getType()) &&
      facts.mayBeNonFinite(value) &&
      !llvm::any_of(op->getOperands(), [](Value operand) {
        return matchPattern(operand, m_Constant());
      })) {
    finite.insert(value);
    return true;
  }
  if (auto inverse = dyn_cast<InverseOp>(op))
    for (Operation *user : inverse.getMatrix().getUsers())
      if (auto det = dyn_cast<DeterminantOp>(user);
          det && det->getBlock() == op->getBlock())
        return requireQuotient(inverse.getMatrix(), det, at);
  if (isFiniteOfFinite(op) || isGreatestOrLeast(op) || isNormOrNumber(value) ||
      (isa<arith::SelectOp>(op) && !facts.mayBeNonFinite(value)))
    return llvm::all_of(op->getOperands(), [&](Value operand) {
      return requireFinite(operand, at);
    });
  finite.insert(value);
  return true;
}

/// Requires that no component of a quotient overflows. A divisor that is not
/// zero is not enough.
bool FiniteConditions::requireQuotient(Value lhs, Value rhs, Operation *at) {
  while (auto broadcast = rhs.getDefiningOp<vector::BroadcastOp>())
    rhs = broadcast.getSource();
  if (!requireFinite(lhs, at) || !requireFinite(rhs, at))
    return false;
  cleared.insert(rhs);
  if (facts.isNonZero(rhs, at) || isNormOrNumber(rhs))
    return true;
  clear.insert(rhs);
  strict.insert(rhs);
  if (facts.isNonNegative(rhs, at))
    positive.insert(rhs);
  return true;
}

bool FiniteConditions::requireClear(Value value, Operation *at,
                                    bool isPositive) {
  cleared.insert(value);
  if (facts.isNonZero(value, at) || isNormOrNumber(value))
    return requireFinite(value, at);
  Operation *op = value.getDefiningOp();
  // Some ops yield values at least as far from zero as their operand, so the
  // operand is required to be far enough from zero.
  if (isa_and_nonnull<vector::BroadcastOp>(op))
    return requireClear(op->getOperand(0), at, isPositive);
  if (auto root = dyn_cast_if_present<math::SqrtOp>(op)) {
    finite.insert(value);
    return requireClear(root.getOperand(), at, /*isPositive=*/true);
  }
  if (auto sum = dyn_cast_if_present<arith::AddFOp>(op);
      sum && sum.getLhs() == sum.getRhs())
    return requireClear(sum.getLhs(), at, isPositive);
  if (auto product = dyn_cast_if_present<arith::MulFOp>(op))
    if (facts.getRange(product.getRhs(), at).low >= 1)
      return requireClear(product.getLhs(), at, isPositive);
  clear.insert(value);
  if (isPositive || facts.isNonNegative(value, at))
    positive.insert(value);
  return true;
}

DenseSet<Value> FiniteConditions::findNonZero() const {
  DenseSet<Value> result;
  SmallVector<Value> pending(cleared.begin(), cleared.end());
  while (!pending.empty()) {
    Value value = pending.pop_back_val();
    if (!result.insert(value).second)
      continue;
    // If the result of one of these ops is not zero, no operand is zero, so the
    // operands need no test.
    Operation *op = value.getDefiningOp();
    if (isa_and_nonnull<arith::MulFOp, arith::NegFOp, vector::BroadcastOp,
                        math::SqrtOp, math::AbsFOp>(op))
      llvm::append_range(pending, op->getOperands());
  }
  return result;
}

/// True if other tests show for each component of a vector that it is finite.
bool FiniteConditions::areComponentsTold(Value value) {
  auto type = dyn_cast<VectorType>(value.getType());
  if (!type)
    return false;
  DenseSet<ArrayRef<int64_t>> found;
  for (Operation *user : value.getUsers())
    if (auto extract = dyn_cast<vector::ExtractOp>(user);
        extract && !extract.hasDynamicPosition() &&
        !isa<VectorType>(extract.getType()) &&
        (finite.contains(extract.getResult()) || isTold(extract.getResult())))
      found.insert(extract.getStaticPosition());
  return static_cast<int64_t>(found.size()) == type.getNumElements();
}

bool FiniteConditions::isTold(Value value) {
  auto [it, isNew] = told.try_emplace(value, false);
  if (!isNew)
    return it->second;
  bool result = llvm::any_of(value.getUses(), [&](OpOperand &use) {
    Operation *user = use.getOwner();
    if (user->getNumResults() != 1 || !keepsNonFinite(use))
      return false;
    return finite.contains(user->getResult(0)) || isTold(user->getResult(0));
  });
  return told[value] = result || areComponentsTold(value);
}

bool FiniteConditions::isRequired(Value value) {
  return required.contains(value) || finite.contains(value) ||
         !facts.mayBeNonFinite(value);
}

/// Replaces tests that a value is not zero: a finite quotient or logarithm
/// shows that its operand is not zero.
void FiniteConditions::replaceClear(function_ref<bool(Value)> isAvailable) {
  SmallVector<Value> kept;
  for (Value value : clear) {
    Value witness;
    for (OpOperand &use : value.getUses()) {
      if (strict.contains(value))
        break;
      Operation *user = use.getOwner();
      bool isQuotient = isa<arith::DivFOp>(user) &&
                        use.getOperandNumber() == 1 &&
                        isRequired(user->getOperand(0));
      if ((isQuotient || isa<math::LogOp>(user)) &&
          !isa<VectorType>(user->getResult(0).getType()) &&
          isAvailable(user->getResult(0)) &&
          !(witness && finite.contains(witness)))
        witness = user->getResult(0);
    }
    if (witness) {
      finite.insert(witness);
      continue;
    }
    kept.push_back(value);
    // The least of several values does not show that one of them is NaN, so
    // these values are also tested to be finite.
    finite.insert(value);
  }
  clear.clear();
  clear.insert_range(kept);
}

/// Replaces tests of several values by a test of one result that is finite only
/// if all of them are.
bool FiniteConditions::replaceBySum(function_ref<bool(Value)> isAvailable) {
  constexpr unsigned mostSteps = 6, most = 100;
  if (finite.size() > most)
    return false;
  llvm::MapVector<Value, llvm::SmallSetVector<Value, 4>> tellsAbout;
  for (Value value : finite) {
    SmallVector<std::pair<Value, unsigned>> pending = {{value, 0}};
    while (!pending.empty()) {
      Value from = pending.back().first;
      unsigned steps = pending.pop_back_val().second;
      if (steps == mostSteps)
        continue;
      for (OpOperand &use : from.getUses()) {
        Operation *user = use.getOwner();
        if (user->getNumResults() != 1 || !keepsNonFinite(use) ||
            !(isFiniteOfFinite(user) || isa<arith::DivFOp>(user)))
          continue;
        auto isOther = [&](Value operand) {
          return operand != from && !isRequired(operand);
        };
        bool isOrdinary = isa<arith::DivFOp>(user)
                              ? cleared.contains(user->getOperand(1))
                              : llvm::none_of(user->getOperands(), isOther);
        Value result = user->getResult(0);
        if (isOrdinary && isAvailable(result) &&
            tellsAbout[result].insert(value))
          pending.push_back({result, steps + 1});
      }
    }
  }
  Value best;
  int64_t saved = 0;
  for (auto &[result, told] : tellsAbout) {
    int64_t gain =
        countComponents(told.getArrayRef()) - countComponents({result});
    if (gain > saved)
      best = result, saved = gain;
  }
  if (!best)
    return false;
  for (Value value : tellsAbout[best])
    finite.remove(value);
  finite.insert(best);
  return true;
}

void FiniteConditions::simplify(function_ref<bool(Value)> isAvailable) {
  replaceClear(isAvailable);
  auto prune = [&] {
    told.clear();
    SmallVector<Value> kept = llvm::filter_to_vector(
        finite, [&](Value value) { return !isTold(value); });
    finite.clear();
    finite.insert_range(kept);
  };
  prune();
  while (replaceBySum(isAvailable))
    prune();
}

Value FiniteConditions::createTest(OpBuilder &builder, Location loc,
                                   function_ref<bool(Value)> isIncluded) {
  SmallVector<Value> sums = llvm::filter_to_vector(finite, isIncluded);
  // The test of the size of a single value also tests that the value is finite.
  bool isSingle = sums.size() == 1 && isa<FloatType>(sums[0].getType()) &&
                  llvm::filter_to_vector(clear, isIncluded) == sums;
  Value all = isSingle ? Value() : createTestOfFinite(builder, loc, sums);
  llvm::SmallMapVector<Type, SmallVector<Value>, 2> sizes;
  for (Value value : clear) {
    if (!isIncluded(value))
      continue;
    SmallVector<Value> components = {value};
    if (auto type = dyn_cast<VectorType>(value.getType())) {
      components.clear();
      auto elements = vector::ToElementsOp::create(builder, loc, value);
      llvm::append_range(components, elements.getResults());
    }
    for (Value component : components)
      sizes[component.getType()].push_back(
          positive.contains(value)
              ? component
              : math::AbsFOp::create(builder, loc, component).getResult());
  }
  for (auto &[type, values] : sizes) {
    Value least = createTree(values, [&](Value a, Value b) {
      Value isLess =
          arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::OLT, a, b);
      return arith::SelectOp::create(builder, loc, isLess, a, b).getResult();
    });
    Value bound = arith::ConstantOp::create(
        builder, loc,
        builder.getFloatAttr(type, FloatFacts::getClearance(type)));
    all = createAnd(builder, loc, all,
                    arith::CmpFOp::create(
                        builder, loc, arith::CmpFPredicate::OGE, least, bound));
    if (!isSingle)
      continue;
    Value infinity = arith::ConstantOp::create(
        builder, loc,
        builder.getFloatAttr(
            type, APFloat::getInf(cast<FloatType>(type).getFloatSemantics())));
    all =
        createAnd(builder, loc, all,
                  arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::OLT,
                                        least, infinity));
  }
  return all;
}
