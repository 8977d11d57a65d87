//===- Cost.cpp - Cost estimates ------------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Cost.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

int64_t tai::estimateTrips(Operation *loop) {
  if (auto forOp = dyn_cast<scf::ForOp>(loop)) {
    std::optional<int64_t> lower = getConstantIntValue(forOp.getLowerBound());
    std::optional<int64_t> upper = getConstantIntValue(forOp.getUpperBound());
    std::optional<int64_t> step = getConstantIntValue(forOp.getStep());
    if (lower && upper && step && *step > 0)
      return std::max<int64_t>(0, (*upper - *lower + *step - 1) / *step);
    return kAssumedTrips;
  }
  return isa<scf::WhileOp>(loop) ? kAssumedTrips : 1;
}

/// Estimates the nanoseconds of one op without its regions, for one component.
/// The numbers are measured throughputs of a 3 GHz core, rounded.
static double estimateScalar(Operation *op) {
  if (op->hasTrait<OpTrait::ConstantLike>() || op->getNumRegions() != 0)
    return 0;
  if (isa<arith::DivFOp, math::SqrtOp, arith::RemSIOp, arith::RemUIOp,
          arith::DivSIOp, arith::DivUIOp, arith::FloorDivSIOp>(op))
    return 1.5;
  if (isa<arith::RemFOp, math::RsqrtOp>(op))
    return 4;
  if (isa<math::AbsFOp, math::FloorOp, math::CeilOp, math::FmaOp,
          math::CopySignOp>(op))
    return 0.3;
  if (isa<math::PowFOp, math::Atan2Op>(op))
    return 25;
  if (isa_and_present<math::MathDialect>(op->getDialect()))
    return 10;
  if (isa<AtomicOp>(op))
    return cast<AtomicOp>(op).getExclusive() ? 1 : 5;
  if (isa<LLVM::AtomicRMWOp, LLVM::AtomicCmpXchgOp>(op))
    return 5;
  if (isa<LoadOp, StoreOp, LLVM::LoadOp, LLVM::StoreOp>(op))
    return 0.5;
  if (isa<RandomOp>(op))
    return 10;
  if (isa<SvdOp, SymEigOp>(op))
    return 60;
  if (isa<LLVM::CallOp, PrintOp>(op))
    return 20;
  return 0.25;
}

double tai::estimateNanoseconds(Operation *op) {
  double components = 1;
  for (Type type : op->getResultTypes())
    if (auto vector = dyn_cast<VectorType>(type))
      components = std::max<double>(components, vector.getNumElements());
  // A branch costs as much as its most expensive arm, a loop as much as all its
  // regions, in each trip.
  double inside = 0;
  bool isLoop = isa<LoopLikeOpInterface>(op);
  for (Region &region : op->getRegions())
    for (Block &inner : region) {
      double cost = estimateNanoseconds(inner);
      inside = isLoop ? inside + cost : std::max(inside, cost);
    }
  return components * estimateScalar(op) + inside * estimateTrips(op);
}

double tai::estimateNanoseconds(Block &block) {
  double sum = 0;
  for (Operation &op : block)
    sum += estimateNanoseconds(&op);
  return sum;
}
