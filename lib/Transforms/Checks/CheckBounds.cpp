//===- CheckBounds.cpp - Checks of indices --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Hoists bounds checks out of a kernel: a few comparisons for each launch,
// instead of some for each access. See docs/decisions/0018-hoisted-bounds.md.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/IRMapping.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Support/BoundsMode.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CHECKBOUNDS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Writes bounds checks as preconditions at the top of a kernel.
class PreconditionWriter {
public:
  PreconditionWriter(KernelOp kernel, IndexBounds &bounds)
      : bounds(bounds),
        builder(OpBuilder::atBlockBegin(&kernel.getBody().front())) {}

  /// Emits a precondition that refuses launches in which index `number` of the
  /// access is out of range.
  void refuse(const IndexedAccess &access, size_t number,
              const Violation &violation);

private:
  Value constant(int64_t value) {
    return arith::ConstantIntOp::create(builder, loc, value, 64);
  }
  Value clone(Value value);
  Value emitLaunchValue(const LaunchValue &launch);
  Value emit(unsigned variable);
  Value emit(const LinearSum &sum);
  Value emitHolds(const LinearSum &row);
  Value emitLeast(const Violation::Step &step);

  IndexBounds &bounds;
  OpBuilder builder;
  Location loc = builder.getUnknownLoc();
  IRMapping clones;
  /// Values of the variables of the index forms, as i64. `iteration` has the
  /// loop variables of an example of one violation.
  llvm::DenseMap<unsigned, Value> launchValues, iteration;
  /// Systems of inequalities whose launches are refused by preconditions
  /// already.
  SmallVector<LinearSystem> refused;
};
} // namespace

/// Emits, at the top of the kernel, a value that depends on arguments alone.
Value PreconditionWriter::clone(Value value) {
  Operation *op = value.getDefiningOp();
  if (!op)
    return value;
  if (Value known = clones.lookupOrNull(value))
    return known;
  for (Value operand : op->getOperands())
    clones.map(operand, clone(operand));
  builder.clone(*op, clones);
  return clones.lookup(value);
}

Value PreconditionWriter::emitLaunchValue(const LaunchValue &launch) {
  if (!launch.factors.empty()) {
    Value first = emit(launch.factors[0]);
    return arith::MulIOp::create(builder, loc, first, emit(launch.factors[1]));
  }
  Value value = launch.array ? memref::DimOp::create(builder, loc, launch.array,
                                                     launch.dimension)
                                   .getResult()
                             : clone(launch.value);
  Type i64 = builder.getI64Type();
  if (value.getType() == i64)
    return value;
  if (value.getType().isIndex())
    return arith::IndexCastOp::create(builder, loc, i64, value);
  if (value.getType().isInteger(1))
    return arith::ExtUIOp::create(builder, loc, i64, value);
  return arith::ExtSIOp::create(builder, loc, i64, value);
}

Value PreconditionWriter::emit(unsigned variable) {
  const LaunchValue *launch = bounds.getForms().getLaunchValue(variable);
  auto &values = launch ? launchValues : iteration;
  if (Value known = values.lookup(variable))
    return known;
  if (ArrayRef<LinearSum> factors = bounds.getForms().getFactors(variable);
      !factors.empty()) {
    Value first = emit(factors[0]);
    return values[variable] =
               arith::MulIOp::create(builder, loc, first, emit(factors[1]));
  }
  return values[variable] = emitLaunchValue(*launch);
}

Value PreconditionWriter::emit(const LinearSum &sum) {
  Value result;
  auto add = [&](Value value) {
    result =
        result ? arith::AddIOp::create(builder, loc, result, value).getResult()
               : value;
  };
  for (auto [variable, factor] : sum.terms) {
    Value value = emit(variable);
    add(factor == 1
            ? value
            : arith::MulIOp::create(builder, loc, value, constant(factor))
                  .getResult());
  }
  if (!result || sum.constant != 0)
    add(constant(sum.constant));
  return result;
}

/// Emits the condition that the linear sum `row` is >= 0. A sum of one or two
/// variables becomes a comparison of numbers, since their difference might wrap
/// around.
Value PreconditionWriter::emitHolds(const LinearSum &row) {
  auto compare = [&](arith::CmpIPredicate predicate, Value a, Value b) {
    return arith::CmpIOp::create(builder, loc, predicate, a, b).getResult();
  };
  auto [variable, factor] = row.terms.front();
  if (row.terms.size() == 1 && factor == 1)
    return compare(arith::CmpIPredicate::sge, emit(variable),
                   constant(-row.constant));
  if (row.terms.size() == 1 && factor == -1)
    return compare(arith::CmpIPredicate::sle, emit(variable),
                   constant(row.constant));
  auto [second, otherFactor] = row.terms.back();
  if (row.terms.size() == 2 && factor == -otherFactor &&
      std::abs(factor) == 1 && (row.constant == 0 || row.constant == -1))
    return compare(row.constant == 0 ? arith::CmpIPredicate::sge
                                     : arith::CmpIPredicate::sgt,
                   emit(factor == 1 ? variable : second),
                   emit(factor == 1 ? second : variable));
  return compare(arith::CmpIPredicate::sge, emit(row), constant(0));
}

/// Emits the least value of the step's variable for which the step's system of
/// inequalities can hold.
Value PreconditionWriter::emitLeast(const Violation::Step &step) {
  Value least;
  for (const LinearSum &row : step.system.getRows()) {
    int64_t factor = row.getFactor(step.variable);
    if (factor <= 0)
      continue;
    // The inequality factor x + rest >= 0 holds if x is at least -floor(rest /
    // factor).
    LinearSum rest = row.plus(LinearSum::variable(step.variable), -factor);
    Value bound;
    if (factor == 1) {
      bound = emit(LinearSum().plus(rest, -1));
    } else {
      Value quotient = arith::FloorDivSIOp::create(builder, loc, emit(rest),
                                                   constant(factor));
      bound = arith::SubIOp::create(builder, loc, constant(0), quotient);
    }
    least = least
                ? arith::MaxSIOp::create(builder, loc, least, bound).getResult()
                : bound;
  }
  return least ? least : constant(0);
}

void PreconditionWriter::refuse(const IndexedAccess &access, size_t number,
                                const Violation &violation) {
  auto isSame = [&](const LinearSystem &other) {
    return other.getRows() == violation.launch.getRows();
  };
  if (llvm::any_of(refused, isSame))
    return;
  refused.push_back(violation.launch);

  loc = access.op->getLoc();
  Value happens;
  for (const LinearSum &row : violation.launch.getRows()) {
    Value holds = emitHolds(row);
    happens =
        happens
            ? arith::AndIOp::create(builder, loc, happens, holds).getResult()
            : holds;
  }
  Value yes = arith::ConstantIntOp::create(builder, loc, 1, 1);
  Value isFine =
      happens ? arith::XOrIOp::create(builder, loc, happens, yes).getResult()
              : arith::ConstantIntOp::create(builder, loc, 0, 1);

  iteration.clear();
  for (const Violation::Step &step : violation.iteration) {
    Value least = emitLeast(step);
    iteration[step.variable] = least;
  }
  auto isKnown = [&](auto &&self, const LinearSum &sum) -> bool {
    return llvm::all_of(sum.terms, [&](auto term) {
      ArrayRef<LinearSum> factors = bounds.getForms().getFactors(term.first);
      return bounds.getForms().getLaunchValue(term.first) ||
             iteration.contains(term.first) ||
             (!factors.empty() && self(self, factors[1]));
    });
  };
  // The error message has a question mark for each index that depends on data.
  std::string message = "index [";
  SmallVector<Value> shown;
  bool isOfElement = number < access.rank;
  size_t first = isOfElement ? 0 : access.rank;
  size_t end = isOfElement ? access.rank : access.indices.size();
  for (size_t i = first; i != end; ++i) {
    std::optional<LinearSum> sum = bounds.getSum(access.indices[i]->get());
    bool known = sum && isKnown(isKnown, *sum);
    message += i != first ? ", " : "";
    message += known ? "{}" : "?";
    if (known)
      shown.push_back(emit(*sum));
  }
  message += "] is out of range for ";
  if (isOfElement) {
    message += access.what;
  } else {
    auto op = cast<FieldAccessOpInterface>(access.op);
    message += describeElement(lookupField(op, op.getFieldAttr()));
  }
  for (const Extent &extent : access.extents)
    if (extent.array)
      shown.push_back(arith::IndexCastOp::create(
          builder, loc, builder.getI64Type(),
          memref::DimOp::create(builder, loc, extent.array, extent.number)));
  PreconditionOp::create(builder, loc, isFine, builder.getStringAttr(message),
                         shown);
}

/// Replaces an index by the nearest index in range.
static void clamp(const IndexedAccess &access, size_t number) {
  OpBuilder builder(access.op);
  Location loc = access.op->getLoc();
  const Extent &extent = access.extents[number];
  int64_t first = access.first[number];
  auto constant = [&](int64_t value) -> Value {
    return arith::ConstantIndexOp::create(builder, loc, value);
  };
  Value last = extent.array
                   ? arith::SubIOp::create(builder, loc,
                                           memref::DimOp::create(builder, loc,
                                                                 extent.array,
                                                                 extent.number),
                                           constant(1))
                         .getResult()
                   : constant(first + extent.number - 1);
  OpOperand &operand = *access.indices[number];
  Value below = arith::MinSIOp::create(builder, loc, operand.get(), last);
  operand.set(arith::MaxSIOp::create(builder, loc, below, constant(first)));
}

namespace {
struct CheckBounds : tai::impl::CheckBoundsBase<CheckBounds> {
  using Base::Base;

  void runOnOperation() override {
    getOperation()->walk([&](KernelOp kernel) { process(kernel); });
  }

private:
  void process(KernelOp kernel) {
    SmallVector<IndexedAccess> accesses;
    kernel.walk([&](Operation *op) {
      if (std::optional<IndexedAccess> access = IndexedAccess::get(op))
        accesses.push_back(std::move(*access));
    });
    IndexBounds known(kernel);
    PreconditionWriter writer(kernel, known);
    kernel.setChecksIndices(false);
    for (const IndexedAccess &access : accesses) {
      bool isDecided = true;
      for (size_t i = 0; i != access.indices.size(); ++i) {
        BoundsAnswer answer =
            known.check(access, i, /*proves=*/bounds != BoundsMode::Off);
        isDecided &= answer.isDecided;
        if (bounds == BoundsMode::Clamp) {
          if (!answer.isDecided)
            clamp(access, i);
          continue;
        }
        for (const Violation &violation : answer.violations)
          writer.refuse(access, i, violation);
      }
      access.op->removeAttr(kInRangeAttrName);
      if (bounds != BoundsMode::Check)
        continue;
      if (isDecided)
        access.op->setAttr(kInRangeAttrName, UnitAttr::get(&getContext()));
      else
        kernel.setChecksIndices(true);
    }
  }
};
} // namespace
