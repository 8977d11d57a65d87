//===- SCFModels.cpp - Reverses of structured control flow ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A branch is mirrored, a serial loop runs backwards. Adjoints of captured
// values leave a region as results of its op: each region first sums its
// contributions, and then the op is rebuilt with the additional results.
//
//===----------------------------------------------------------------------===//

#include "Models.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Reverse/LoopHistory.h"
#include "tai/AD/Reverse/ParallelReverse.h"
#include "tai/Dialect/Tai/IR/Guards.h"

using namespace mlir;
using namespace mlir::tai;

using Captured = llvm::MapVector<Value, Value>;

namespace {

struct IfModel : AdjointLoopInterface::ExternalModel<IfModel, scf::IfOp> {
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    return extendIf(cast<scf::IfOp>(op), b);
  }
  LogicalResult buildReverse(Operation *op, AdjointBuilder &b) const {
    auto primal = cast<scf::IfOp>(op);
    Value condition = b.getPrimal(primal.getCondition());
    SmallVector<Value> seeds;
    for (OpResult result : primal.getResults())
      seeds.push_back(b.getAdjoint(result));

    auto draft = scf::IfOp::create(b, TypeRange(), condition,
                                   /*addThenBlock=*/false,
                                   /*addElseBlock=*/false);
    Captured captured[2];
    for (auto [i, region] : llvm::enumerate(primal->getRegions())) {
      if (region.empty())
        continue;
      OpBuilder::InsertionGuard guard(b);
      Block *mirror = b.createBlock(&draft->getRegion(i));
      Operation *yield = region.front().getTerminator();
      auto begin = [&](Frame &) {
        for (auto [value, seed] : llvm::zip(yield->getOperands(), seeds))
          b.addAdjoint(value, seed);
      };
      auto end = [&, i = i](Frame &frame) {
        captured[i] = b.takeCaptured(frame);
      };
      if (failed(b.reverseBlock(&region.front(), mirror, begin, end)))
        return failure();
    }

    // The values to which either arm contributes; an arm that does not
    // contribute to a value yields zero for it.
    llvm::SetVector<Value> values;
    SmallVector<Type> types;
    for (Captured &arm : captured)
      for (auto &[value, adjoint] : arm)
        if (values.insert(value))
          types.push_back(value.getType());
    auto mirrored = scf::IfOp::create(b, types, condition,
                                      /*addThenBlock=*/false,
                                      /*addElseBlock=*/false);
    if (b.wantsGuards())
      mirrored->setAttr(kAdjointBranch, b.getUnitAttr());
    mirrored.getThenRegion().takeBody(draft.getThenRegion());
    mirrored.getElseRegion().takeBody(draft.getElseRegion());
    draft.erase();
    for (auto [i, region] : llvm::enumerate(mirrored->getRegions())) {
      OpBuilder::InsertionGuard guard(b);
      if (region.empty()) {
        if (values.empty())
          continue;
        b.createBlock(&region);
      }
      b.setInsertionPointToEnd(&region.front());
      SmallVector<Value> yields;
      for (Value value : values) {
        Value adjoint = captured[i].lookup(value);
        yields.push_back(adjoint ? adjoint : b.createZero(value.getType()));
      }
      scf::YieldOp::create(b, yields);
    }
    b.setInsertionPointAfter(mirrored);
    for (auto [value, result] : llvm::zip(values, mirrored.getResults()))
      b.addAdjoint(value, result);
    return success();
  }
};

struct ForModel : AdjointLoopInterface::ExternalModel<ForModel, scf::ForOp> {
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    return extendFor(cast<scf::ForOp>(op), b);
  }
  LogicalResult buildReverse(Operation *op, AdjointBuilder &b) const {
    auto primal = cast<scf::ForOp>(op);
    if (primal.getUnsignedCmp()) {
      b.emitError(op, "cannot reverse a loop with unsigned bounds").attachNote()
          << "count in 'index', from zero to the number of iterations";
      return failure();
    }
    // The reversed loop carries the adjoints of the active values that the loop
    // carries.
    SmallVector<unsigned> carried;
    SmallVector<Value> inits;
    for (auto [i, argument] : llvm::enumerate(primal.getRegionIterArgs()))
      if (b.isActive(argument) || b.isActive(primal.getResult(i))) {
        carried.push_back(i);
        inits.push_back(b.getAdjointOrZero(primal.getResult(i)));
      }
    Value count = b.createTripCount(primal);
    Value lower = b.getPrimal(primal.getLowerBound());
    Value step = b.getPrimal(primal.getStep());

    LoopHistory history(b, primal, count);
    scf::ForOp draft = history.createReverse(inits);
    Captured captured;
    SmallVector<Value> yields;
    auto begin = [&](Frame &frame) {
      history.beginIteration(frame);
      Value iv = frame.iteration;
      if (!lower.getType().isIndex())
        iv = arith::IndexCastOp::create(b, lower.getType(), iv);
      if (!matchPattern(step, m_One()))
        iv = arith::MulIOp::create(b, iv, step);
      if (!matchPattern(lower, m_Zero()))
        iv = arith::AddIOp::create(b, lower, iv);
      frame.values.map(primal.getInductionVar(), iv);
      for (auto [i, argument] : llvm::zip(carried, draft.getRegionIterArgs()))
        b.addAdjoint(primal.getYieldedValues()[i], argument);
    };
    auto end = [&](Frame &frame) {
      for (unsigned i : carried)
        yields.push_back(b.getAdjointOrZero(primal.getRegionIterArg(i)));
      captured = b.takeCaptured(frame);
      history.endIteration();
    };
    if (failed(b.reverseBlock(primal.getBody(), draft.getBody(), begin, end)))
      return failure();
    for (auto [i, result] : llvm::zip(carried, history.close(yields, captured)))
      b.addAdjoint(primal.getInitArgs()[i], result);
    return success();
  }
};

/// The iterations of a loop that carries no derivative and does not read its
/// own writes are independent as far as derivatives go: a copy of the loop runs
/// their reverses in the original order. Any other loop is run forward first,
/// and its reverse is a loop over the iterations that it took.
struct WhileModel
    : AdjointLoopInterface::ExternalModel<WhileModel, scf::WhileOp> {
  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    return extendWhile(cast<scf::WhileOp>(op), b);
  }
  LogicalResult buildReverse(Operation *op, AdjointBuilder &b) const {
    auto primal = cast<scf::WhileOp>(op);
    return isIndependent(primal, b) ? repeat(primal, b) : reverse(primal, b);
  }

  static bool isIndependent(scf::WhileOp op, AdjointBuilder &b) {
    auto isActive = [&](Value value) { return b.isActive(value); };
    if (b.isRecordedLoop(op) || llvm::any_of(op.getResults(), isActive) ||
        llvm::any_of(op.getBeforeArguments(), isActive) ||
        llvm::any_of(op.getAfterArguments(), isActive))
      return false;
    bool isIndependent = true;
    llvm::SmallDenseSet<const void *> reads, writes;
    op->walk([&](DifferentiableAccessInterface access) {
      if (!b.isReversed(access))
        return;
      isIndependent &= !b.zeroesAdjoint(access);
      const void *key = access.getAccessedStorage().getOpaque();
      bool isRead = access.getAccessKind() == AccessKind::Read;
      (isRead ? reads : writes).insert(key);
      isIndependent &= !(isRead ? writes : reads).contains(key) &&
                       !op.getBefore().isAncestor(access->getParentRegion());
    });
    return isIndependent;
  }

  static LogicalResult repeat(scf::WhileOp primal, AdjointBuilder &b) {
    SmallVector<Value> inits = b.getPrimals(primal.getInits());
    auto draft = scf::WhileOp::create(b, TypeRange(), ValueRange());
    Captured captured;
    SmallVector<Value> next;
    Block *before = b.createBlock(&draft.getBefore());
    for (BlockArgument argument : primal.getBeforeArguments())
      before->addArgument(argument.getType(), argument.getLoc());
    b.recomputeBlock(primal.getBeforeBody(), before);
    Block *after = b.createBlock(&draft.getAfter());
    for (BlockArgument argument : primal.getAfterArguments())
      after->addArgument(argument.getType(), argument.getLoc());
    auto begin = [&](Frame &frame) {
      for (auto [from, to] :
           llvm::zip(primal.getAfterArguments(), after->getArguments()))
        frame.values.map(from, to);
    };
    auto end = [&](Frame &frame) {
      next = b.getPrimals(primal.getYieldOp().getOperands());
      captured = b.takeCaptured(frame);
    };
    if (failed(b.reverseBlock(primal.getAfterBody(), after, begin, end)))
      return failure();

    // The reversed scf.while carries, beside primal values, the sums of the
    // adjoints of captured values.
    auto condition = cast<scf::ConditionOp>(before->getTerminator());
    SmallVector<Type> types(primal.getResultTypes());
    SmallVector<Value> passed(condition.getArgs());
    b.setInsertionPointToEnd(after);
    for (auto &[value, adjoint] : captured) {
      types.push_back(value.getType());
      passed.push_back(before->addArgument(value.getType(), value.getLoc()));
      Value sum = after->addArgument(value.getType(), value.getLoc());
      next.push_back(arith::AddFOp::create(b, sum, adjoint));
    }
    scf::YieldOp::create(b, next);
    condition.getArgsMutable().assign(passed);
    b.setInsertionPoint(draft);
    for (auto &[value, adjoint] : captured)
      inits.push_back(b.createZero(value.getType()));
    auto mirrored = scf::WhileOp::create(b, types, inits);
    mirrored.getBefore().takeBody(draft.getBefore());
    mirrored.getAfter().takeBody(draft.getAfter());
    draft.erase();
    b.setInsertionPointAfter(mirrored);
    for (auto [entry, result] :
         llvm::zip(captured, mirrored.getResults().take_back(captured.size())))
      b.addAdjoint(entry.first, result);
    return success();
  }

  static LogicalResult reverse(scf::WhileOp primal, AdjointBuilder &b) {
    Block *before = primal.getBeforeBody(), *after = primal.getAfterBody();
    ValueRange passed = primal.getConditionOp().getArgs();
    SmallVector<unsigned> carried;
    for (BlockArgument argument : before->getArguments())
      if (b.isActive(argument))
        carried.push_back(argument.getArgNumber());
    SmallVector<Value> seeds =
        llvm::map_to_vector(primal.getResults(),
                            [&](Value result) { return b.getAdjoint(result); });
    LoopHistory history(b, primal);

    // The last evaluation of the condition is reversed here: the operands of
    // its terminator are the results of the loop.
    SmallVector<Value> inits;
    Captured captured;
    auto beginLast = [&](Frame &frame) {
      history.beginLast(frame);
      for (auto [value, seed] : llvm::zip(passed, seeds))
        b.addAdjoint(value, seed);
    };
    auto endLast = [&](Frame &frame) {
      for (unsigned i : carried)
        inits.push_back(b.getAdjointOrZero(before->getArgument(i)));
      captured = b.takeCaptured(frame);
    };
    if (failed(
            b.reverseBlock(before, b.getInsertionBlock(), beginLast, endLast)))
      return failure();
    for (auto &[value, adjoint] : captured)
      b.addAdjoint(value, adjoint);

    // The iterations are reversed from the last to the first: the body, and
    // then the condition that let the iteration run.
    scf::ForOp draft = history.createReverse(inits);
    SmallVector<Value> yields;
    LogicalResult result = success();
    auto begin = [&](Frame &frame) { history.beginIteration(frame); };
    auto reverseBody = [&] {
      SmallVector<Value> contributions;
      Captured fromBody;
      auto beginBody = [&](Frame &frame) {
        frame.argumentValues.assign(passed.begin(), passed.end());
        for (auto [i, adjoint] : llvm::zip(carried, draft.getRegionIterArgs()))
          b.addAdjoint(primal.getYieldOp().getOperand(i), adjoint);
      };
      auto endBody = [&](Frame &frame) {
        for (BlockArgument argument : after->getArguments())
          contributions.push_back(b.getAdjoint(argument));
        fromBody = b.takeCaptured(frame);
      };
      result = b.reverseBlock(after, draft.getBody(), beginBody, endBody);
      for (auto &[value, adjoint] : fromBody)
        b.addAdjoint(value, adjoint);
      for (auto [value, contribution] : llvm::zip(passed, contributions))
        b.addAdjoint(value, contribution);
    };
    auto end = [&](Frame &frame) {
      for (unsigned i : carried)
        yields.push_back(b.getAdjointOrZero(before->getArgument(i)));
      captured = b.takeCaptured(frame);
      history.endIteration();
    };
    if (failed(
            b.reverseBlock(before, draft.getBody(), begin, end, reverseBody)) ||
        failed(result))
      return failure();
    for (auto [i, adjoint] :
         llvm::zip(carried, history.close(yields, captured)))
      b.addAdjoint(primal.getInits()[i], adjoint);
    return success();
  }
};

/// The loop stays parallel. Reductions by addition pass their adjoint to each
/// iteration.
struct ParallelModel
    : AdjointLoopInterface::ExternalModel<ParallelModel, scf::ParallelOp> {
  bool runsInParallel(Operation *) const { return true; }

  LogicalResult buildTangent(Operation *op, TangentBuilder &b) const {
    return extendParallel(cast<scf::ParallelOp>(op), b);
  }
  LogicalResult buildReverse(Operation *op, AdjointBuilder &b) const {
    auto primal = cast<scf::ParallelOp>(op);
    auto reduce = cast<scf::ReduceOp>(primal.getBody()->getTerminator());
    SmallVector<Value> seeds;
    for (auto [i, result] : llvm::enumerate(primal.getResults())) {
      Value seed = b.getAdjoint(result);
      seeds.push_back(seed);
      if (!seed)
        continue;
      if (!isSumReduction(reduce.getReductions()[i])) {
        b.emitError(op, "cannot differentiate a reduction that is not a sum")
                .attachNote()
            << "carry the value through an 'scf.for'";
        return failure();
      }
      b.addAdjoint(primal.getInitVals()[i], seed);
    }
    auto loop = scf::ParallelOp::create(b, b.getPrimals(primal.getLowerBound()),
                                        b.getPrimals(primal.getUpperBound()),
                                        b.getPrimals(primal.getStep()));
    OpBuilder::InsertionGuard guard(b);
    Block *mirror = loop.getBody();
    mirror->getTerminator()->erase();
    auto begin = [&](Frame &frame) {
      for (auto [from, to] :
           llvm::zip(primal.getInductionVars(), loop.getInductionVars()))
        frame.values.map(from, to);
      for (auto [value, seed] : llvm::zip(reduce.getOperands(), seeds))
        b.addAdjoint(value, seed);
    };
    return reverseParallelBody(b, loop, *primal.getBody(), *mirror, begin,
                               [&] { scf::ReduceOp::create(b); });
  }
};
} // namespace

void mlir::tai::registerSCFModels(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *context, scf::SCFDialect *) {
    scf::IfOp::attachInterface<IfModel>(*context);
    scf::ForOp::attachInterface<ForModel>(*context);
    scf::WhileOp::attachInterface<WhileModel>(*context);
    scf::ParallelOp::attachInterface<ParallelModel>(*context);
  });
}
