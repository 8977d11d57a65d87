//===- UnrollAndJam.cpp - Unroll and jam for reductions -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The additions of a serial sum form a dependence chain, because the order of a
// sum must be kept. Different iterations of the parallel loop around it are
// independent. So these are unrolled, and their serial loops jammed into one
// that carries all of their sums; if their terms are adjacent in memory, LLVM
// vectorises them. The order of each sum does not change.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Transforms/Passes.h"

namespace mlir::tai {
#define GEN_PASS_DEF_UNROLLANDJAM
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The number of bits of the sums that all copies of the loop carry: an AVX
/// vector, or two if there are enough registers.
static constexpr unsigned kBits = 256;
/// The most ops of an iteration, without the computation of indices, for which
/// there are enough registers to carry two vectors.
static constexpr unsigned kFewOps = 10;
/// The largest stride for which LLVM vectorises loads, by also loading the
/// elements in between.
static constexpr int64_t kMaxStride = 8;
/// The most ops in an iteration of a jammed loop: beyond this number, registers
/// or the instruction cache run out.
static constexpr unsigned kMaxOps = 64;
/// The least number of float operations for each load by a loaded index that
/// makes jammed copies with different bounds worth it.
static constexpr unsigned kFloatsOfScattered = 4;
/// The number of iterations that copies with different bounds must have in
/// common.
static constexpr int64_t kFewCommon = 8;
/// Loops of at most this number of instructions in all iterations are left to
/// LLVM, which unrolls them completely and then vectorises the loop around
/// them. LLVM does so up to 300 instructions, but above this number jamming is
/// faster.
static constexpr int64_t kUnrolledOps = 120;

static constexpr StringLiteral kLoopAnnotation = "llvm.loop_annotation";

/// Tells LLVM not to vectorise a loop: its vectors are across iterations of the
/// loop around it. With `isRest`, for the remainder of a copy, LLVM does not
/// unroll the loop either: such loops are many, and short.
static LLVM::LoopAnnotationAttr getNotVectorized(MLIRContext *context,
                                                 bool isRest = false) {
  BoolAttr yes = BoolAttr::get(context, true);
  auto vectorize = LLVM::LoopVectorizeAttr::get(context, /*disable=*/yes, {},
                                                {}, {}, {}, {}, {});
  LLVM::LoopUnrollAttr unroll;
  if (isRest)
    unroll = LLVM::LoopUnrollAttr::get(context, /*disable=*/yes, {}, {}, {}, {},
                                       {}, {});
  return LLVM::LoopAnnotationAttr::get(context, {}, vectorize, {}, unroll, {},
                                       {}, {}, {}, {}, {}, {}, {}, {}, {}, {});
}

namespace {
/// A parallel loop with a serial loop in it, and the facts found about both.
struct Candidate {
  scf::ForOp loop;
  /// The bits of the widest sum that a serial loop of the candidate carries; 0
  /// if there is none.
  unsigned sumBits = 0;
  unsigned ops = 0;
  /// The number of ops of an iteration, without the computation of indices,
  /// which copies share or addressing modes include.
  unsigned fewOps = 0;
  /// True if the copies have bounds of their own, and each copy has a loop for
  /// its remaining iterations.
  bool isUneven = false;

  void count(Operation &op) {
    if (isa<LLVM::GEPOp>(op) || op.hasTrait<OpTrait::ConstantLike>())
      return;
    ++ops;
    fewOps += !isa<arith::IndexCastOp>(op) &&
              llvm::none_of(op.getResultTypes(), llvm::IsaPred<IndexType>);
  }
};

/// Emits copies of several iterations of a parallel loop, interleaved op by op.
class Jammer {
public:
  Jammer(OpBuilder &builder, unsigned factor)
      : builder(builder), copies(factor) {}

  /// Maps a value to one emitted value that all copies share.
  void mapShared(Value from, Value to) {
    for (IRMapping &copy : copies)
      copy.map(from, to);
  }
  void map(unsigned copy, Value from, Value to) { copies[copy].map(from, to); }
  Value lookup(unsigned copy, Value value) const {
    return copies[copy].lookupOrDefault(value);
  }

  void emit(Block &body) {
    for (Operation &op : body.without_terminator())
      emit(op);
  }

private:
  void emit(Operation &op) {
    if (auto loop = dyn_cast<scf::ForOp>(op))
      return jam(loop);
    if (auto branch = dyn_cast<scf::IfOp>(op))
      return flatten(branch);
    if (isShared(op)) {
      Operation *clone = builder.clone(op, copies.front());
      for (auto [from, to] : llvm::zip(op.getResults(), clone->getResults()))
        mapShared(from, to);
      return;
    }
    for (IRMapping &copy : copies)
      builder.clone(op, copy);
  }

  /// True if `op` would compute the same value in all copies.
  bool isShared(Operation &op) const {
    return isMemoryEffectFree(&op) &&
           llvm::all_of(op.getOperands(),
                        [&](Value operand) { return isShared(operand); });
  }
  bool isShared(Value value) const {
    Value first = lookup(0, value);
    return llvm::all_of(ArrayRef(copies), [&](const IRMapping &copy) {
      return copy.lookupOrDefault(value) == first;
    });
  }

  /// Emits both arms of a branch, and selects their results.
  void flatten(scf::IfOp branch) {
    emit(*branch.thenBlock());
    emit(*branch.elseBlock());
    for (IRMapping &copy : copies)
      for (auto [result, yes, no] :
           llvm::zip(branch.getResults(), branch.thenYield().getOperands(),
                     branch.elseYield().getOperands()))
        copy.map(result,
                 arith::SelectOp::create(
                     builder, branch.getLoc(),
                     copy.lookupOrDefault(branch.getCondition()),
                     copy.lookupOrDefault(yes), copy.lookupOrDefault(no)));
  }

  void jam(scf::ForOp loop) {
    if (isShared(loop.getLowerBound()) && isShared(loop.getUpperBound()))
      jam(loop, lookup(0, loop.getLowerBound()),
          lookup(0, loop.getUpperBound()), lookup(0, loop.getStep()),
          /*isCounter=*/false);
    else
      jamCommonPart(loop);
  }

  /// Emits one loop in place of the loops of all copies. Its index is the index
  /// of all of them, or, with `isCounter`, the distance from the start of each.
  void jam(scf::ForOp loop, Value lower, Value upper, Value step,
           bool isCounter) {
    Location loc = loop.getLoc();
    SmallVector<Value> inits, starts;
    for (unsigned copy = 0; copy < copies.size(); ++copy) {
      starts.push_back(lookup(copy, loop.getLowerBound()));
      for (Value init : loop.getInitArgs())
        inits.push_back(lookup(copy, init));
    }
    auto jammed =
        scf::ForOp::create(builder, loc, lower, upper, step, inits,
                           [](OpBuilder &, Location, Value, ValueRange) {});
    unsigned carried = loop.getNumResults();
    for (unsigned copy = 0; copy < copies.size(); ++copy)
      for (auto [i, argument] : llvm::enumerate(loop.getRegionIterArgs())) {
        map(copy, argument, jammed.getRegionIterArg(copy * carried + i));
        map(copy, loop.getResult(i), jammed.getResult(copy * carried + i));
      }
    OpBuilder::InsertionGuard guard(builder);
    builder.setInsertionPointToStart(jammed.getBody());
    mapShared(loop.getInductionVar(), jammed.getInductionVar());
    if (isCounter)
      for (auto [copy, start] : llvm::enumerate(starts))
        map(copy, loop.getInductionVar(),
            arith::AddIOp::create(builder, loc, start,
                                  jammed.getInductionVar()));
    emit(*loop.getBody());
    SmallVector<Value> yields;
    for (unsigned copy = 0; copy < copies.size(); ++copy)
      for (Value value : loop.getBody()->getTerminator()->getOperands())
        yields.push_back(lookup(copy, value));
    scf::YieldOp::create(builder, loop.getLoc(), yields);
    jammed->setDiscardableAttrs(loop->getDiscardableAttrDictionary());
    jammed->setAttr(kLoopAnnotation, getNotVectorized(loop.getContext()));
  }

  /// Jams the iterations that all copies have in common; each copy then runs
  /// its additional iterations.
  void jamCommonPart(scf::ForOp loop) {
    Location loc = loop.getLoc();
    Type type = loop.getInductionVar().getType();
    auto constant = [&](int64_t value) -> Value {
      return arith::ConstantOp::create(builder, loc,
                                       builder.getIntegerAttr(type, value));
    };
    Value zero = constant(0), common;
    for (unsigned copy = 0; copy < copies.size(); ++copy) {
      Value lower = lookup(copy, loop.getLowerBound());
      Value upper = lookup(copy, loop.getUpperBound());
      // The bounds are compared first, because the difference of bounds that
      // are far apart may overflow.
      Value some = arith::CmpIOp::create(
          builder, loc, arith::CmpIPredicate::slt, lower, upper);
      Value count = arith::SubIOp::create(builder, loc, upper, lower);
      count = arith::SelectOp::create(builder, loc, some, count, zero);
      common =
          common ? arith::MinSIOp::create(builder, loc, common, count) : count;
    }
    Value isWorth = arith::CmpIOp::create(
        builder, loc, arith::CmpIPredicate::sge, common, constant(kFewCommon));
    common = arith::SelectOp::create(builder, loc, isWorth, common, zero);
    bool isCounter = !isShared(loop.getLowerBound());
    Value lower = zero, upper = common;
    if (!isCounter) {
      lower = lookup(0, loop.getLowerBound());
      upper = arith::AddIOp::create(builder, loc, lower, common);
    }
    jam(loop, lower, upper, constant(1), isCounter);
    for (IRMapping &copy : copies) {
      IRMapping own = copy;
      for (BlockArgument argument : loop.getBody()->getArguments())
        own.erase(argument);
      auto remainder = cast<scf::ForOp>(builder.clone(*loop, own));
      Value from = arith::AddIOp::create(builder, loc,
                                         remainder.getLowerBound(), common);
      from.getDefiningOp()->moveBefore(remainder);
      remainder.getLowerBoundMutable().assign(from);
      remainder->setAttr(kLoopAnnotation,
                         getNotVectorized(loop.getContext(), /*isRest=*/true));
      for (auto [init, result] :
           llvm::zip(remainder.getInitArgsMutable(), loop.getResults()))
        init.assign(copy.lookup(result));
      copy.map(loop.getResults(), remainder.getResults());
    }
  }

  OpBuilder &builder;
  SmallVector<IRMapping> copies;
};
} // namespace

/// Returns the access groups of accesses that do not depend on accesses of
/// other iterations.
static ArrayRef<LLVM::AccessGroupAttr> getParallelAccesses(scf::ForOp loop) {
  auto annotation =
      loop->getAttrOfType<LLVM::LoopAnnotationAttr>(kLoopAnnotation);
  return annotation ? annotation.getParallelAccesses()
                    : ArrayRef<LLVM::AccessGroupAttr>();
}

/// True if an op may be reordered with ops of other iterations.
static bool isIndependent(Operation *op,
                          ArrayRef<LLVM::AccessGroupAttr> groups) {
  if (isMemoryEffectFree(op))
    return true;
  if (!isa<LLVM::LoadOp, LLVM::StoreOp>(op))
    return false;
  auto load = dyn_cast<LLVM::LoadOp>(op);
  if (load && load.getInvariant())
    return true;
  auto access = cast<LLVM::AccessGroupOpInterface>(op);
  ArrayAttr own = access.getAccessGroupsOrNull();
  return own && llvm::any_of(own, [&](Attribute group) {
           return llvm::is_contained(groups, group);
         });
}

/// True if the value does not depend on the index of the loop. `known` keeps
/// the answers, because an index may use one value many times.
static bool isUniform(Value value, scf::ForOp loop,
                      DenseMap<Value, bool> &known) {
  Operation *op = value.getDefiningOp();
  if (!op || loop.isDefinedOutsideOfLoop(value))
    return value != loop.getInductionVar();
  if (auto found = known.find(value); found != known.end())
    return found->second;
  bool is = llvm::all_of(op->getOperands(), [&](Value operand) {
    return isUniform(operand, loop, known);
  });
  return known[value] = is;
}

/// Returns the difference of an index from one iteration to the next; nullopt
/// if it is not constant.
static std::optional<int64_t> getStride(IndexBuilder &builder, Value index,
                                        scf::ForOp loop) {
  DenseMap<Value, bool> known;
  IndexExpr expr = builder.get(index);
  int64_t stride = expr.getCoefficient(loop.getInductionVar());
  expr.add(IndexExpr(loop.getInductionVar()), -stride);
  if (!expr.allOf([&](Value value) { return isUniform(value, loop, known); }))
    return std::nullopt;
  return stride;
}

/// True if vectors over the iterations of this loop would gather elements that
/// are far apart.
static bool readsColumns(scf::ForOp loop) {
  IndexBuilder builder;
  return llvm::any_of(loop.getBody()->getOps<LLVM::LoadOp>(), [&](auto load) {
    auto address = load.getAddr().template getDefiningOp<LLVM::GEPOp>();
    if (!address)
      return false;
    return llvm::any_of(address.getDynamicIndices(), [&](Value index) {
      std::optional<int64_t> stride = getStride(builder, index, loop);
      return !stride || *stride > kMaxStride || *stride < -kMaxStride;
    });
  });
}

/// Returns the width of the widest sum that the loop carries, an operation on
/// the float of the previous iteration, whose order must be kept; 0 if there is
/// none.
static unsigned getSumBits(scf::ForOp loop) {
  unsigned bits = 0;
  for (auto [argument, yielded] :
       llvm::zip(loop.getRegionIterArgs(),
                 loop.getBody()->getTerminator()->getOperands())) {
    auto type = dyn_cast<FloatType>(argument.getType());
    Operation *update = yielded.getDefiningOp();
    if (!type || !update || update->getParentOp() != loop.getOperation())
      continue;
    bits = std::max(bits, type.getWidth());
  }
  return bits;
}

/// Counts the ops of a branch. False if its two arms cannot both be executed.
static bool visit(scf::IfOp branch, Candidate &candidate) {
  if (!branch.getNumResults())
    return false;
  WalkResult result = branch.walk([&](Operation *op) {
    bool isFrame = isa<scf::IfOp, scf::YieldOp>(op);
    if (!isFrame && (op->getNumRegions() || !isPure(op)))
      return WalkResult::interrupt();
    if (!isFrame)
      candidate.count(*op);
    return WalkResult::advance();
  });
  candidate.ops += branch.getNumResults();
  candidate.fewOps += branch.getNumResults();
  return !result.wasInterrupted();
}

/// True if LLVM will unroll the loop completely. Computations of addresses do
/// not count as ops.
static bool isUnrolledByLLVM(scf::ForOp loop) {
  std::optional<llvm::APInt> trips = loop.getStaticTripCount();
  if (!trips)
    return false;
  // Only ops that depend on the loop index or on carried values are counted;
  // the others are hoisted out of the loop.
  llvm::SmallDenseSet<Value> varying;
  varying.insert(loop.getInductionVar());
  varying.insert_range(loop.getRegionIterArgs());
  int64_t ops = 1; // that of the index
  loop.getBody()->walk<WalkOrder::PreOrder>([&](Operation *op) {
    bool isVarying = llvm::any_of(op->getOperands(), [&](Value value) {
      return varying.contains(value);
    });
    if (!isVarying && op->getNumRegions() == 0)
      return;
    varying.insert_range(op->getResults());
    ops +=
        !isa<LLVM::GEPOp, arith::IndexCastOp, arith::AddIOp, scf::YieldOp>(op);
  });
  return trips->ule(kUnrolledOps / ops);
}

/// True if a value is computed from loads, or carried values, of ops within
/// `scope`.
static bool dependsOnLoads(Value value, Operation *scope) {
  llvm::SmallDenseSet<Value> seen;
  SmallVector<Value> list = {value};
  while (!list.empty()) {
    Value next = list.pop_back_val();
    Operation *op = next.getDefiningOp();
    if (!op || !scope->isProperAncestor(op) || !seen.insert(next).second)
      continue;
    if (isa<LLVM::LoadOp>(op) || op->getNumRegions())
      return true;
    llvm::append_range(list, op->getOperands());
  }
  return false;
}

/// True if it pays to jam a loop whose bounds differ between copies. If loaded
/// data decide where the copies start, the copies read from places that are far
/// apart. Loads by loaded indices do so as well, and pay if there are enough
/// operations on floats.
static bool paysUnevenly(scf::ForOp loop, Operation *around) {
  if (dependsOnLoads(loop.getLowerBound(), around))
    return false;
  unsigned scattered = 0, floats = 0;
  for (Operation &op : loop.getBody()->without_terminator()) {
    if (auto load = dyn_cast<LLVM::LoadOp>(op))
      scattered += dependsOnLoads(load.getAddr(), loop);
    else
      floats += llvm::any_of(op.getResultTypes(), llvm::IsaPred<FloatType>);
  }
  return floats >= kFloatsOfScattered * scattered;
}

/// Examines the ops in an iteration of `candidate.loop`, or of a serial loop in
/// it.
static bool visit(Block &body, Candidate &candidate,
                  ArrayRef<LLVM::AccessGroupAttr> groups, bool reassociate) {
  auto isUniform = [&](Value bound) {
    return candidate.loop.isDefinedOutsideOfLoop(bound) ||
           matchPattern(bound, m_Constant());
  };
  for (Operation &op : body.without_terminator()) {
    if (auto branch = dyn_cast<scf::IfOp>(op)) {
      if (!visit(branch, candidate))
        return false;
      continue;
    }
    auto loop = dyn_cast<scf::ForOp>(op);
    if (!loop) {
      if (op.getNumRegions() || !isIndependent(&op, groups))
        return false;
      candidate.count(op);
      continue;
    }
    // Jammed loops compare their indices as signed numbers, so unsigned loops
    // are not jammed.
    if (loop.getUnsignedCmp())
      return false;
    unsigned bits = getSumBits(loop);
    bool holdsLoops = !loop.getBody()->getOps<scf::ForOp>().empty();
    // If the bounds are equal in all copies, the copies leave the loop
    // together.
    bool isUniformLoop =
        isUniform(loop.getLowerBound()) && isUniform(loop.getUpperBound());
    if (!isUniform(loop.getStep()) ||
        (!isUniformLoop &&
         (holdsLoops || !matchPattern(loop.getStep(), m_One()) ||
          !paysUnevenly(loop, candidate.loop))))
      return false;
    // A loop that carries no sums is not jammed, since it is better vectorised
    // by itself.
    if ((!bits && !holdsLoops) || isUnrolledByLLVM(loop))
      return false;
    // A loop whose sums may be added up in any order is not jammed either,
    // since LLVM vectorises it.
    if (reassociate && !holdsLoops && !readsColumns(loop))
      return false;
    candidate.sumBits = std::max(candidate.sumBits, bits);
    candidate.isUneven |= !isUniformLoop;
    if (!visit(*loop.getBody(), candidate, groups, reassociate))
      return false;
  }
  return true;
}

static std::optional<Candidate> match(scf::ForOp loop, bool reassociate) {
  ArrayRef<LLVM::AccessGroupAttr> groups = getParallelAccesses(loop);
  if (groups.empty() || loop.getNumResults() || loop.getUnsignedCmp() ||
      !matchPattern(loop.getStep(), m_One()))
    return std::nullopt;
  Candidate candidate{loop};
  if (!visit(*loop.getBody(), candidate, groups, reassociate) ||
      !candidate.sumBits || candidate.ops > kMaxOps)
    return std::nullopt;
  return candidate;
}

static void apply(const Candidate &candidate) {
  scf::ForOp loop = candidate.loop;
  int64_t factor = kBits / std::max(candidate.sumBits, 32u);
  if (candidate.fewOps <= kFewOps && !candidate.isUneven)
    factor *= 2;
  // With more copies than iterations, all iterations would be left to the
  // remainder loop.
  std::optional<llvm::APInt> trips = loop.getStaticTripCount();
  while (trips && factor > 2 && trips->ult(factor))
    factor /= 2;
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  Type type = loop.getInductionVar().getType();
  auto constant = [&](OpBuilder &at, int64_t value) -> Value {
    return arith::ConstantOp::create(at, loc, at.getIntegerAttr(type, value));
  };
  // The iterations [lower, middle) run in steps of the factor, which is a power
  // of two, and then the remaining iterations.
  Value lower = loop.getLowerBound(), upper = loop.getUpperBound();
  Value count = arith::SubIOp::create(builder, loc, upper, lower);
  count = arith::MaxSIOp::create(builder, loc, count, constant(builder, 0));
  Value whole =
      arith::AndIOp::create(builder, loc, count, constant(builder, -factor));
  Value middle = arith::AddIOp::create(builder, loc, lower, whole);
  auto main = scf::ForOp::create(builder, loc, lower, middle,
                                 constant(builder, factor));
  OpBuilder nested = OpBuilder::atBlockTerminator(main.getBody());
  Jammer jammer(nested, factor);
  for (int64_t copy = 0; copy < factor; ++copy) {
    Value own = main.getInductionVar();
    if (copy)
      own = arith::AddIOp::create(nested, loc, own, constant(nested, copy));
    jammer.map(copy, loop.getInductionVar(), own);
  }
  jammer.emit(*loop.getBody());
  loop.getLowerBoundMutable().assign(middle);
}

namespace {
struct UnrollAndJam : tai::impl::UnrollAndJamBase<UnrollAndJam> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<Candidate> candidates;
    walkOwned(getOperation(), [&](Operation *owned) {
      owned->walk([&](scf::ForOp loop) {
        if (std::optional<Candidate> candidate = match(loop, reassociate))
          candidates.push_back(*candidate);
      });
    });
    for (const Candidate &candidate : candidates)
      apply(candidate);
  }
};
} // namespace
