//===- FixedPoint.cpp - Additions whose order does not matter -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In deterministic mode, float additions to elements that the data chooses are
// done in integers (lib/DeviceLibrary/FixedPoint.cpp), whose unit depends on
// the largest value of an element. So the loop runs twice for its values alone,
// without its other effects, to find the units and to add up. What follows adds
// the sums to the field: a loop over the elements, or, where the loop has other
// effects or reaches few of the elements, the loop itself.
//
//===----------------------------------------------------------------------===//

#include "Offload.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Transforms/Utils/Accumulation.h"
#include "tai/Transforms/Utils/IndexMath.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The accumulators of one group of additions.
struct Accumulators {
  const FieldInfo *field;
  /// For each dimension, the index that all additions share, or null.
  SmallVector<Value> fixed;
  int64_t count;
  Value fieldBase, sums, scales;
  std::string suffix;

  int64_t getNumIntegers() const { return field->scalarType.isF64() ? 2 : 1; }
};

/// One of the three passes.
enum class Pass { Scale, Add, Round };

class Splitter {
public:
  Splitter(ParallelForOp loop, Value frame, DeviceLowering &lowering)
      : loop(loop), frame(frame), lowering(lowering) {}
  LogicalResult run(ArrayRef<AtomicOp> atomics);

private:
  Accumulators create(const AccumulationGroup &group);
  void emitPass(ParallelForOp in, Pass pass);
  void emitCall(OpBuilder &builder, Location loc, Pass pass,
                const Accumulators &to, Value number, Value operand);
  void roundElements(const Accumulators &accumulators);
  bool isWorthVisiting(ArrayRef<AccumulationGroup> groups);

  ParallelForOp loop;
  Value frame;
  DeviceLowering &lowering;
  SmallVector<Accumulators> all;
};
} // namespace

static bool isInBuffer(Operation *op) {
  auto atomic = dyn_cast<AtomicOp>(op);
  return atomic && atomic.getStrategy() == AccumulationStrategy::Private;
}

/// True for memory of one iteration.
static bool isPrivate(ParallelForOp loop, Value pointer) {
  while (auto element = pointer.getDefiningOp<LLVM::GEPOp>())
    pointer = element.getBase();
  return pointer.getDefiningOp<LLVM::AllocaOp>() &&
         !loop.isDefinedOutsideOfLoop(pointer);
}

/// True for an op that others can see the effect of, besides additions in
/// fixed point.
static bool isSeen(ParallelForOp loop, Operation *op) {
  if (isInBuffer(op))
    return false;
  if (auto store = dyn_cast<LLVM::StoreOp>(op))
    return !isPrivate(loop, store.getAddr());
  if (auto update = dyn_cast<LLVM::AtomicRMWOp>(op))
    return !isPrivate(loop, update.getPtr());
  return isa<AtomicOp, AssertOp, LLVM::AtomicCmpXchgOp>(op);
}

/// Leaves what values are computed from.
static void removeEffects(ParallelForOp loop) {
  SmallVector<Operation *> seen;
  loop.getBody().walk([&](Operation *op) {
    if (isSeen(loop, op))
      seen.push_back(op);
  });
  for (Operation *op : seen)
    op->erase();
}

/// Removes what only removed ops used.
static void removeDeadOps(ParallelForOp loop) {
  SmallVector<Operation *> ops;
  // Backwards, users come before what they use, and what is in an op before
  // the op itself, with which it would be freed.
  loop.getBody().walk<WalkOrder::PreOrder>(
      [&](Operation *op) { ops.push_back(op); });
  for (Operation *op : llvm::reverse(ops))
    if (isOpTriviallyDead(op))
      op->erase();
}

Accumulators Splitter::create(const AccumulationGroup &group) {
  Accumulators made{group.field, group.fixed, getNumAccumulators(group), {}, {},
                    {},          ""};
  made.suffix = made.field->scalarType.isF64() ? "f64" : "f32";
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

/// `operand` is the value, or the address of the element.
void Splitter::emitCall(OpBuilder &builder, Location loc, Pass pass,
                        const Accumulators &to, Value number, Value operand) {
  IndexMath math(builder, loc);
  Value scale =
      emitPointer(builder, loc, builder.getI32Type(), to.scales, number);
  SmallVector<Value> operands{scale};
  if (pass != Pass::Scale)
    operands.push_back(emitPointer(builder, loc, builder.getI64Type(), to.sums,
                                   math.mul(number, to.getNumIntegers())));
  operands.push_back(operand);
  StringRef name = pass == Pass::Scale ? "tai_dev_fixed_scale_"
                   : pass == Pass::Add ? "tai_dev_fixed_add_"
                                       : "tai_dev_fixed_round_";
  lowering.device.runtime.call(builder, loc, (name + to.suffix).str(), Type(),
                               operands);
}

/// Replaces the additions of a copy of the loop.
void Splitter::emitPass(ParallelForOp in, Pass pass) {
  SmallVector<AtomicOp> atomics;
  in.walk([&](AtomicOp atomic) {
    if (isInBuffer(atomic))
      atomics.push_back(atomic);
  });
  for (AtomicOp atomic : atomics) {
    OpBuilder builder(atomic);
    Location loc = atomic.getLoc();
    const Accumulators &to = all[*atomic.getBuffer()];
    IndexMath math(builder, loc);
    SmallVector<Value> zeroBased =
        emitZeroBased(builder, loc, *to.field, atomic.getIndices());
    Value number = math.constant(0);
    for (auto [index, extent, fixed] :
         llvm::zip_equal(zeroBased, to.field->layout.shape, to.fixed))
      if (!fixed)
        number = math.add(math.mul(number, extent), index);
    if (to.field->numComponents != 1)
      number = math.add(math.mul(number, to.field->numComponents),
                        emitComponent(builder, loc, to.field->elementShape,
                                      atomic.getComponents()));
    Value operand = atomic.getValue();
    if (pass == Pass::Round)
      operand =
          emitPointer(builder, loc, to.field->scalarType, to.fieldBase,
                      emitElementOffset(builder, loc, *to.field, zeroBased,
                                        atomic.getComponents()));
    else if (atomic.getKind() == AtomicKind::Sub)
      operand = arith::NegFOp::create(builder, loc, operand);
    emitCall(builder, loc, pass, to, number, operand);
    atomic.erase();
  }
  removeDeadOps(in);
}

/// A loop over the accumulators.
void Splitter::roundElements(const Accumulators &accumulators) {
  const FieldInfo &field = *accumulators.field;
  OpBuilder outside(loop);
  Location loc = loop.getLoc();
  IndexMath around(outside, loc);
  // What they share is computed once.
  SmallVector<Value> zeroBased(field.layout.shape.size());
  for (auto [i, fixed] : llvm::enumerate(accumulators.fixed))
    if (fixed)
      zeroBased[i] = around.sub(fixed, field.layout.offset[i]);
  auto over = ParallelForOp::create(outside, loc, around.constant(0),
                                    around.constant(accumulators.count));
  OpBuilder builder = OpBuilder::atBlockBegin(&over.getBody().front());
  IndexMath math(builder, loc);
  Value number = over.getInductionVars().front(), rest = number;
  SmallVector<Value> components(field.elementShape.size());
  auto takeDigit = [&](int64_t extent) {
    Value digit = math.rem(rest, extent);
    rest = math.div(rest, extent);
    return digit;
  };
  for (size_t i = components.size(); i-- > 0;)
    components[i] = takeDigit(field.elementShape[i]);
  for (size_t i = zeroBased.size(); i-- > 0;)
    if (!accumulators.fixed[i])
      zeroBased[i] = takeDigit(field.layout.shape[i]);
  Value element = emitPointer(
      builder, loc, field.scalarType, accumulators.fieldBase,
      emitElementOffset(builder, loc, field, zeroBased, components));
  emitCall(builder, loc, Pass::Round, accumulators, number, element);
}

/// True if the elements are few against the additions.
bool Splitter::isWorthVisiting(ArrayRef<AccumulationGroup> groups) {
  bool hasEffects = loop.getBody()
                        .walk([&](Operation *op) {
                          return isSeen(loop, op) ? WalkResult::interrupt()
                                                  : WalkResult::advance();
                        })
                        .wasInterrupted();
  if (hasEffects)
    return false;
  double elements = 0, updates = 0;
  for (const AccumulationGroup &group : groups) {
    elements += double(getNumAccumulators(group));
    for (AtomicOp atomic : group.atomics)
      updates += estimateRuns(atomic, loop);
  }
  // A visit in order costs less than one by an index.
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
  bool visitsElements = isWorthVisiting(*groups);
  for (auto [number, group] : llvm::enumerate(*groups))
    for (AtomicOp atomic : group.atomics)
      atomic.setBuffer(number);
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
  for (const Accumulators &accumulators : all)
    roundElements(accumulators);
  loop.erase();
  return success();
}

LogicalResult tai::splitFixedPointLoops(LLVM::LLVMFuncOp host, Value frame,
                                        DeviceLowering &lowering) {
  llvm::MapVector<Operation *, SmallVector<AtomicOp>> atomics;
  WalkResult result = host.walk([&](AtomicOp atomic) {
    if (!isInBuffer(atomic))
      return WalkResult::advance();
    auto loop = atomic->getParentOfType<ParallelForOp>();
    Type type = atomic.getValue().getType();
    bool isKnown = loop && isDeviceLoop(loop) && atomic.getBuffer() &&
                   atomic.getOld().use_empty() &&
                   (type.isF32() || type.isF64()) &&
                   (atomic.getKind() == AtomicKind::Add ||
                    atomic.getKind() == AtomicKind::Sub);
    if (!isKnown) {
      atomic.emitOpError("has a private buffer, which on a GPU only additions "
                         "of f32 and f64 have whose old value nobody uses; "
                         "expects tai-relax-atomics=on-device to run before");
      return WalkResult::interrupt();
    }
    atomics[loop].push_back(atomic);
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return failure();
  for (auto &[loop, found] : atomics)
    if (failed(Splitter(cast<ParallelForOp>(loop), frame, lowering).run(found)))
      return failure();
  return success();
}
