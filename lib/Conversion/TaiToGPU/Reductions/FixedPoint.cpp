//===- FixedPoint.cpp - Additions whose order does not matter -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In deterministic mode, float additions to data-dependent elements are done in
// integers (lib/DeviceLibrary/FixedPoint.cpp), whose unit depends on the
// largest value added to an element. So copies of the loop without its other
// effects run twice, to find the units and to add up. Then the sums are added
// to the field: by a loop over the elements, or, if the loop has other effects
// or reaches few of the elements, by the loop itself.
//
//===----------------------------------------------------------------------===//

#include "ScatterBuffers.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The integer sums (one or two integers each) of one group of additions, and
/// the scale of each sum.
struct FixedPointSums : ScatterBuffer {
  using ScatterBuffer::ScatterBuffer;
  Value scales;

  int64_t getNumIntegers() const { return field->scalarType.isF64() ? 2 : 1; }
  /// True if the field has 16-bit floats, which are added up as f32.
  bool isOfHalves() const {
    return field->scalarType.getIntOrFloatBitWidth() == 16;
  }
};

/// The three passes Scale, Add and Round; for elements of 16 bits, Take
/// replaces Round and only returns the sum.
enum class Pass { Scale, Add, Round, Take };

class Splitter {
public:
  Splitter(ParallelForOp loop, Value frame, DeviceLowering &lowering)
      : loop(loop), frame(frame), lowering(lowering) {}
  LogicalResult run(ArrayRef<AtomicOp> atomics);

private:
  FixedPointSums create(const AccumulationGroup &group);
  void emitPass(ParallelForOp in, Pass pass);
  Value emitCall(OpBuilder &builder, Location loc, Pass pass,
                 const FixedPointSums &to, Value number, Value operand = {});
  void emitSum(OpBuilder &builder, const FixedPointSums &from, Value number,
               Value element);
  bool hasEffects();
  bool isWorthVisiting(ArrayRef<AccumulationGroup> groups, bool hasEffects);

  ParallelForOp loop;
  Value frame;
  DeviceLowering &lowering;
  SmallVector<FixedPointSums> all;
};
} // namespace

/// True for memory that is private to one iteration of the loop.
static bool isPrivate(ParallelForOp loop, Value pointer) {
  while (auto element = pointer.getDefiningOp<LLVM::GEPOp>())
    pointer = element.getBase();
  return pointer.getDefiningOp<LLVM::AllocaOp>() &&
         !loop.isDefinedOutsideOfLoop(pointer);
}

static bool isFixed(Operation *op) {
  return isInBuffer(op, ReductionForm::Fixed);
}

/// True for an op with an effect visible outside its iteration, other than an
/// addition in fixed point.
static bool isSeen(ParallelForOp loop, Operation *op) {
  if (isFixed(op))
    return false;
  if (auto store = dyn_cast<LLVM::StoreOp>(op))
    return !isPrivate(loop, store.getAddr());
  if (auto update = dyn_cast<LLVM::AtomicRMWOp>(op))
    return !isPrivate(loop, update.getPtr());
  return isa<AtomicOp, AssertOp, LLVM::AtomicCmpXchgOp>(op);
}

/// Removes the ops with visible effects from a copy of the loop, but keeps
/// their operands.
static void removeEffects(ParallelForOp loop) {
  SmallVector<Operation *> seen;
  loop.getBody().walk([&](Operation *op) {
    if (isSeen(loop, op))
      seen.push_back(op);
  });
  for (Operation *op : seen)
    op->erase();
}

/// Removes ops whose results are unused.
static void removeDeadOps(ParallelForOp loop) {
  SmallVector<Operation *> ops;
  // In reverse order, an op comes before the ops that define its operands, and
  // ops inside an op before the op itself, whose removal would free them.
  loop.getBody().walk<WalkOrder::PreOrder>(
      [&](Operation *op) { ops.push_back(op); });
  for (Operation *op : llvm::reverse(ops))
    if (isOpTriviallyDead(op))
      op->erase();
}

FixedPointSums Splitter::create(const AccumulationGroup &group) {
  FixedPointSums made(group);
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  RuntimeCalls &runtime = lowering.host.runtime;
  made.fieldBase = emitFieldBase(builder, loc, *made.field);
  int64_t bytes = made.count * getAccumulatorBytes(made.field->scalarType);
  made.sums = runtime.tai_rt_device_scratch(builder, loc, frame,
                                            runtime.i64(builder, loc, bytes));
  IndexMath math(builder, loc);
  made.scales = emitPointer(builder, loc, builder.getI64Type(), made.sums,
                            math.constant(made.count * made.getNumIntegers()));
  return made;
}

/// Emits the addition of a finished sum to its element.
void Splitter::emitSum(OpBuilder &builder, const FixedPointSums &from,
                       Value number, Value element) {
  Location loc = loop.getLoc();
  if (!from.isOfHalves()) {
    emitCall(builder, loc, Pass::Round, from, number, element);
    return;
  }
  Value sum = emitCall(builder, loc, Pass::Take, from, number);
  emitRoundedAddition(builder, loc, from.field->scalarType, sum, element);
}

/// Emits a call of the device library's function for `pass`. `operand`: the
/// term, or the address of the element.
Value Splitter::emitCall(OpBuilder &builder, Location loc, Pass pass,
                         const FixedPointSums &to, Value number,
                         Value operand) {
  IndexMath math(builder, loc);
  Value scale =
      emitPointer(builder, loc, builder.getI32Type(), to.scales, number);
  SmallVector<Value> operands{scale};
  if (pass != Pass::Scale)
    operands.push_back(emitPointer(builder, loc, builder.getI64Type(), to.sums,
                                   math.mul(number, to.getNumIntegers())));
  if (operand)
    operands.push_back(operand);
  StringRef name = pass == Pass::Scale  ? "tai_dev_fixed_scale_"
                   : pass == Pass::Add  ? "tai_dev_fixed_add_"
                   : pass == Pass::Take ? "tai_dev_fixed_take_"
                                        : "tai_dev_fixed_round_";
  StringRef suffix = to.field->scalarType.isF64() ? "f64" : "f32";
  Type result = pass == Pass::Take ? builder.getF64Type() : Type();
  return lowering.device.runtime.call(builder, loc, (name + suffix).str(),
                                      result, operands);
}

/// Replaces the fixed-point additions of `in`, a copy of the loop, by calls for
/// `pass`.
void Splitter::emitPass(ParallelForOp in, Pass pass) {
  SmallVector<AtomicOp> atomics;
  in.walk([&](AtomicOp atomic) {
    if (isFixed(atomic))
      atomics.push_back(atomic);
  });
  for (AtomicOp atomic : atomics) {
    OpBuilder builder(atomic);
    Location loc = atomic.getLoc();
    const FixedPointSums &to = all[*atomic.getReductionAttr().getBuffer()];
    Value number = emitSumNumber(builder, atomic, to);
    Value operand =
        pass == Pass::Round
            ? emitPointer(
                  builder, loc, to.field->scalarType, to.fieldBase,
                  emitElementOffset(builder, loc, *to.field,
                                    emitZeroBased(builder, loc, *to.field,
                                                  atomic.getIndices()),
                                    atomic.getComponents()))
            : emitTerm(builder, atomic);
    if (to.isOfHalves() && pass != Pass::Round)
      operand =
          arith::ExtFOp::create(builder, loc, builder.getF32Type(), operand);
    emitCall(builder, loc, pass, to, number, operand);
    atomic.erase();
  }
  removeDeadOps(in);
}

bool Splitter::hasEffects() {
  return loop.getBody()
      .walk([&](Operation *op) {
        return isSeen(loop, op) ? WalkResult::interrupt()
                                : WalkResult::advance();
      })
      .wasInterrupted();
}

/// True if a loop over the elements adds the finished sums: there are few
/// elements compared with the additions, or the field has 16-bit floats.
bool Splitter::isWorthVisiting(ArrayRef<AccumulationGroup> groups,
                               bool hasEffects) {
  if (llvm::any_of(all,
                   [](const FixedPointSums &to) { return to.isOfHalves(); }))
    return true;
  if (hasEffects)
    return false;
  double elements = 0, updates = 0;
  for (const AccumulationGroup &group : groups) {
    elements += double(getNumAccumulators(group));
    for (AtomicOp atomic : group.atomics)
      updates += estimateRuns(atomic, loop);
  }
  // The assumed factor by which visiting all elements in order is cheaper, for
  // each element, than visiting them by computed indices.
  constexpr double isCheaper = 8, guessedIterations = 1 << 17;
  std::optional<int64_t> iterations = getNumIterations(loop);
  return elements <= isCheaper * updates *
                         (iterations ? double(*iterations) : guessedIterations);
}

LogicalResult Splitter::run(ArrayRef<AtomicOp> atomics) {
  FailureOr<SmallVector<AccumulationGroup>> groups =
      groupAccumulations(loop, atomics, lowering.device.fields);
  if (failed(groups))
    return failure();
  for (const AccumulationGroup &group : *groups)
    all.push_back(create(group));
  bool keepsLoop = hasEffects();
  bool visitsElements = isWorthVisiting(*groups, keepsLoop);
  for (auto [number, group] : llvm::enumerate(*groups))
    for (AtomicOp atomic : group.atomics)
      atomic.setReductionAttr(atomic.getReductionAttr().withBuffer(number));
  for (Pass pass : {Pass::Scale, Pass::Add}) {
    OpBuilder builder(loop);
    auto copy = cast<ParallelForOp>(builder.clone(*loop));
    removeEffects(copy);
    emitPass(copy, pass);
  }
  if (!visitsElements) {
    emitPass(loop, Pass::Round);
    return success();
  }
  OpBuilder builder(loop->getContext());
  builder.setInsertionPointAfter(loop);
  for (const FixedPointSums &to : all)
    emitElementLoop(builder, loop.getLoc(), to,
                    [&](OpBuilder &in, Value number, Value element) {
                      emitSum(in, to, number, element);
                    });
  if (!keepsLoop) {
    loop.erase();
    return success();
  }
  SmallVector<AtomicOp> additions;
  loop.walk([&](AtomicOp atomic) {
    if (isFixed(atomic))
      additions.push_back(atomic);
  });
  for (AtomicOp addition : additions)
    addition.erase();
  removeDeadOps(loop);
  return success();
}

LogicalResult tai::splitFixedPointLoops(LLVM::LLVMFuncOp host, Value frame,
                                        DeviceLowering &lowering) {
  return splitBufferedLoops(
      host, ReductionForm::Fixed,
      [&](ParallelForOp loop, ArrayRef<AtomicOp> atomics) {
        return Splitter(loop, frame, lowering).run(atomics);
      });
}
