//===- LongLoops.cpp - Safepoints in loops of device code -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A running kernel cannot be stopped from outside. So loops of a thread that
// may run long poll a stop word periodically (`tai_rt_go_on`): loops with an
// unknown end, and those with more than some ten million operations in total.
// Loops known to be short do not poll, nor do loops with a data-dependent trip
// count and a short body, such as those over a particle's neighbours, unless
// they are run by a single thread. The loop over the iterations of a thread
// polls where there may be too many (mayBeCountless): a grid of some ten
// thousand threads ends soon enough with fewer iterations.
//
// The poll uses the device state, which kernels with polls get as an argument.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

/// A loop with at most this many operations, which take some tens of
/// milliseconds of one thread, does not poll for a request to stop.
static constexpr uint64_t kLongLoop = 20000000;
/// The number of operations between two polls, if the loop runs that long.
static constexpr uint64_t kBetween = 4096;
/// The number of iterations between two polls of a loop whose iterations have
/// an unknown length.
static constexpr uint64_t kIterationsBetween = 16;
/// The cost, as part of the body of another loop, of a loop that may be long.
static constexpr uint64_t kUnknown = UINT64_MAX;

namespace {
class LoopPolls {
public:
  LoopPolls(LLVM::LLVMFuncOp function, bool runsAlone, RuntimeCalls &runtime)
      : function(function), runsAlone(runsAlone), runtime(runtime) {}

  /// Returns the largest number of operations that one run of the block
  /// executes, and inserts polls into its loops.
  uint64_t visit(Block &block);
  /// Inserts polls for a request to stop into the loop over the iterations of a
  /// thread, and into loops inside of it.
  void visitIterations(scf::ForOp loop, bool areCountless);

private:
  uint64_t visitLoop(scf::ForOp loop);
  void poll(Block &body, Location loc, uint64_t perIteration);

  LLVM::LLVMFuncOp function;
  bool runsAlone;
  RuntimeCalls &runtime;
};
} // namespace

void LoopPolls::poll(Block &body, Location loc, uint64_t perIteration) {
  // If an iteration may be long, a loop inside it polls as well, so this loop
  // need not poll in each iteration.
  uint64_t every =
      perIteration == kUnknown
          ? kIterationsBetween
          : llvm::bit_floor(std::max<uint64_t>(
                1, kBetween / std::max<uint64_t>(1, perIteration)));
  OpBuilder builder = OpBuilder::atBlockBegin(&body);
  runtime.call(builder, loc, kGoOn, runtime.getPointerType(),
               {function.getArgument(0), runtime.i32(builder, loc, every)});
}

uint64_t LoopPolls::visitLoop(scf::ForOp loop) {
  uint64_t perIteration = visit(*loop.getBody());
  std::optional<APInt> count = loop.getStaticTripCount();
  if (count && perIteration != kUnknown) {
    uint64_t all = llvm::SaturatingMultiply(
        count->getLimitedValue(), std::max<uint64_t>(1, perIteration));
    if (all <= kLongLoop)
      return all;
  } else if (!runsAlone && (perIteration != kUnknown ||
                            (count && count->ule(kIterationsBetween)))) {
    // This loop does not poll, because a loop around it or a loop inside of it
    // does.
    return kUnknown;
  }
  poll(*loop.getBody(), loop.getLoc(), perIteration);
  return kUnknown;
}

uint64_t LoopPolls::visit(Block &block) {
  uint64_t sum = 0;
  // The iterator is advanced early, since polls are inserted between the
  // operations of the block.
  for (Operation &op : llvm::make_early_inc_range(block)) {
    uint64_t own = 1;
    if (auto loop = dyn_cast<scf::ForOp>(op)) {
      own = visitLoop(loop);
    } else if (auto loop = dyn_cast<scf::WhileOp>(op)) {
      uint64_t before = visit(*loop.getBeforeBody());
      uint64_t after = visit(*loop.getAfterBody());
      poll(*loop.getBeforeBody(), loop.getLoc(),
           llvm::SaturatingAdd(before, after));
      own = kUnknown;
    } else {
      for (Region &region : op.getRegions())
        for (Block &inner : region)
          own = llvm::SaturatingAdd(own, visit(inner));
    }
    sum = llvm::SaturatingAdd(sum, own);
  }
  return sum;
}

void LoopPolls::visitIterations(scf::ForOp loop, bool areCountless) {
  uint64_t perIteration = visit(*loop.getBody());
  if (areCountless)
    poll(*loop.getBody(), loop.getLoc(), perIteration);
}

/// True if a loop bound is a 64-bit integer that was not extended from fewer
/// bits.
static bool isLong(Value bound) {
  auto cast = bound.getDefiningOp<arith::IndexCastOp>();
  if (!cast || !cast.getIn().getType().isInteger(64))
    return false;
  Operation *definition = cast.getIn().getDefiningOp();
  return !isa_and_present<arith::ExtSIOp, arith::ExtUIOp>(definition);
}

bool tai::mayBeCountless(ParallelForOp loop) {
  // A number of iterations that takes a GPU hours even if all of its threads
  // work.
  constexpr uint64_t kCountless = uint64_t(1) << 40;
  uint64_t known = 1;
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    auto first = getConstantIntValue(lower), end = getConstantIntValue(upper);
    if ((!first && isLong(lower)) || (!end && isLong(upper)))
      return true;
    if (first && end)
      known = llvm::SaturatingMultiply(
          known, uint64_t(*end) - uint64_t(std::min(*first, *end)));
  }
  return known > kCountless;
}

void tai::pollLongLoops(LLVM::LLVMFuncOp function, scf::ForOp iterations,
                        bool runsAlone, bool areCountless,
                        RuntimeCalls &runtime) {
  LoopPolls polls(function, runsAlone, runtime);
  polls.visitIterations(iterations, areCountless);
}
