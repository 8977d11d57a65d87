//===- InstrumentAccesses.cpp - Checks of accesses at run time ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The run-time form of `tai-check-access-rules`. Each component of a field with
// an adjoint has four numbers in a shadow array: the access that read it last,
// the access that wrote it last, and, of that write, the loop of the launch and
// the iteration. An access compares them, reports violations, and stores its
// own number.
//
// Iterations on other threads do the same concurrently. Every update is atomic,
// so there are no false reports; some of several races may be missed.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Owners.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/AccessLog/AccessShadow.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/MapVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_INSTRUMENTACCESSES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

SmallVector<FieldOp> mlir::tai::getShadowedFields(ModuleOp module) {
  return llvm::filter_to_vector(module.getOps<FieldOp>(), [](FieldOp field) {
    return field.getAdjointAttr() && isFloatOrVector(field.getType());
  });
}

namespace {
/// Adds to one kernel the code that logs violations of the data access rules.
class Instrumentation {
public:
  explicit Instrumentation(KernelOp kernel)
      : b(kernel.getLoc(), kernel.getContext()), kernel(kernel) {}

  LogicalResult run(ArrayRef<FieldOp> fields);

private:
  struct Shadow {
    Value array;
    FieldLayout layout;
    SmallVector<int64_t> elementShape;
  };

  LogicalResult instrument(Operation *access);
  void check(Operation *access, FieldUse use, bool isClearing, Value component);
  void createReport(Value condition, Value before, Value component,
                    ViolationKind kind);
  Value createComponent(const Shadow &shadow, ValueRange indices,
                        ValueRange components, Value &isInside);
  std::pair<Value, Value> getIteration(Operation *access);

  Value integer(int64_t value) {
    return arith::ConstantIntOp::create(b, value, 32);
  }
  Value index(int64_t value) {
    return arith::ConstantIndexOp::create(b, value);
  }
  Value slot(Value component, ShadowWord word) {
    Value first = b.createOrFold<arith::MulIOp>(component, index(kShadowWords));
    return b.createOrFold<arith::AddIOp>(first,
                                         index(static_cast<int64_t>(word)));
  }
  Value read(Value component, ShadowWord word) {
    return memref::LoadOp::create(b, current->array, slot(component, word));
  }
  void write(Value value, Value component, ShadowWord word) {
    memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::assign, value,
                                current->array, slot(component, word));
  }
  Value isNot(Value value, Value other) {
    return arith::CmpIOp::create(b, arith::CmpIPredicate::ne, value, other);
  }

  ImplicitLocOpBuilder b;
  KernelOp kernel;
  llvm::MapVector<const void *, Shadow> shadows;
  Value log, base;
  SmallVector<Attribute> described;
  llvm::MapVector<Operation *, int64_t> loops;
  Shadow *current = nullptr;
  /// The number of the access that is being instrumented, which is unique over
  /// all launches.
  Value id;
  int64_t ordinal = 0;
};
} // namespace

/// Emits the row-major number of a component in the whole field, and in
/// `isInside` whether the component exists.
Value Instrumentation::createComponent(const Shadow &shadow, ValueRange indices,
                                       ValueRange components, Value &isInside) {
  Value number = index(0);
  isInside = arith::ConstantIntOp::create(b, 1, 1);
  auto add = [&](Value position, int64_t first, int64_t extent) {
    position = b.createOrFold<arith::SubIOp>(position, index(first));
    // Components out of range are left out, since the checks of indices report
    // them.
    Value fits = arith::CmpIOp::create(b, arith::CmpIPredicate::ult, position,
                                       index(extent));
    isInside = b.createOrFold<arith::AndIOp>(isInside, fits);
    number = b.createOrFold<arith::MulIOp>(number, index(extent));
    number = b.createOrFold<arith::AddIOp>(number, position);
  };
  for (auto [position, first, extent] :
       llvm::zip_equal(indices, shadow.layout.offset, shadow.layout.shape))
    add(position, first, extent);
  if (components.empty()) {
    for (int64_t extent : shadow.elementShape)
      number = b.createOrFold<arith::MulIOp>(number, index(extent));
    return number;
  }
  for (auto [position, extent] :
       llvm::zip_equal(components, shadow.elementShape))
    add(position, 0, extent);
  return number;
}

/// Emits the number of the parallel loop around the access, which no other loop
/// of any launch has, and the number of the running iteration.
std::pair<Value, Value> Instrumentation::getIteration(Operation *access) {
  Operation *loop = getEnclosingParallelLoop(access);
  int64_t number = loops.insert({loop, loops.size() + 1}).first->second;
  Value stamp = b.createOrFold<arith::AddIOp>(base, integer(number));
  Value iteration = integer(0);
  auto parallel = dyn_cast_if_present<ParallelForOp>(loop);
  if (!loop || (parallel && parallel.getSerialize()))
    return {stamp, iteration};
  for (Value iv : getParallelInductionVars(loop)) {
    Value position = arith::IndexCastOp::create(b, b.getI32Type(), iv);
    iteration = b.createOrFold<arith::MulIOp>(iteration, integer(1000003));
    iteration = b.createOrFold<arith::AddIOp>(iteration, position);
  }
  return {stamp, iteration};
}

/// Emits code that logs a violation where `condition` holds.
void Instrumentation::createReport(Value condition, Value before,
                                   Value component, ViolationKind kind) {
  auto branch = scf::IfOp::create(b, condition, /*withElseRegion=*/false);
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPointToStart(branch.thenBlock());
  auto number64 = [&](int64_t value) -> Value {
    return arith::ConstantIntOp::create(b, value, 64);
  };
  int64_t first = ordinal * kLogWords;
  Value count = memref::AtomicRMWOp::create(b, arith::AtomicRMWKind::addi,
                                            number64(1), log, index(first));
  Value fits = arith::CmpIOp::create(b, arith::CmpIPredicate::ult, count,
                                     number64(kLogEntries));
  auto room = scf::IfOp::create(b, fits, /*withElseRegion=*/false);
  b.setInsertionPointToStart(room.thenBlock());
  Value at = arith::IndexCastOp::create(b, b.getIndexType(), count);
  at = arith::MulIOp::create(b, at, index(3));
  at = arith::AddIOp::create(b, at, index(first + 1));
  Value words[] = {arith::ExtSIOp::create(b, b.getI64Type(), before),
                   arith::IndexCastOp::create(b, b.getI64Type(), component),
                   number64(static_cast<int64_t>(kind))};
  for (auto [i, word] : llvm::enumerate(words))
    memref::StoreOp::create(b, word, log,
                            ValueRange{arith::AddIOp::create(b, at, index(i))});
}

/// Emits the checks for an access to one component.
void Instrumentation::check(Operation *access, FieldUse use, bool isClearing,
                            Value component) {
  Value none = integer(0);
  auto [stamp, iteration] = getIteration(access);
  Value writer = read(component, ShadowWord::Writer);
  Value isOther = arith::AndIOp::create(
      b,
      arith::CmpIOp::create(b, arith::CmpIPredicate::eq,
                            read(component, ShadowWord::Loop), stamp),
      isNot(read(component, ShadowWord::Iteration), iteration));
  if (use == FieldUse::Read) {
    createReport(isOther, writer, component, ViolationKind::EarlyRead);
    write(id, component, ShadowWord::Reader);
    return;
  }
  Value reader = read(component, ShadowWord::Reader);
  Value wasRead = isNot(reader, none);
  createReport(wasRead, reader, component,
               use == FieldUse::Write ? ViolationKind::OverwrittenAfterRead
                                      : ViolationKind::AccumulatedAfterRead);
  if (use == FieldUse::Write) {
    Value wasWritten = isNot(writer, none);
    Value yes = arith::ConstantIntOp::create(b, 1, 1);
    Value wasOnlyWritten = arith::AndIOp::create(
        b, wasWritten, arith::XOrIOp::create(b, wasRead, yes));
    Value alone = arith::XOrIOp::create(b, isOther, yes);
    createReport(arith::AndIOp::create(b, wasOnlyWritten, isOther), writer,
                 component, ViolationKind::Race);
    createReport(arith::AndIOp::create(b, wasOnlyWritten, alone), writer,
                 component, ViolationKind::WrittenTwice);
  }
  // After a violation is logged, the shadow of the element is reset, so that
  // its checks start anew.
  write(none, component, ShadowWord::Reader);
  write(isClearing ? none : id, component, ShadowWord::Writer);
  write(isClearing ? none : stamp, component, ShadowWord::Loop);
  write(iteration, component, ShadowWord::Iteration);
}

LogicalResult Instrumentation::instrument(Operation *access) {
  auto *found = shadows.find(getStorageKey(access));
  if (found == shadows.end())
    return success();
  current = &found->second;
  ValueRange indices, components;
  FieldUse use = FieldUse::Accumulate;
  bool isClearing = false, usesOld = false;
  if (auto load = dyn_cast<LoadOp>(access)) {
    indices = load.getIndices();
    components = load.getComponents();
    use = FieldUse::Read;
  } else if (auto store = dyn_cast<StoreOp>(access)) {
    indices = store.getIndices();
    components = store.getComponents();
    use = FieldUse::Write;
    isClearing = matchPattern(store.getValue(), m_Constant());
  } else {
    auto atomic = cast<AtomicOp>(access);
    indices = atomic.getIndices();
    components = atomic.getComponents();
    usesOld = !atomic.getOld().use_empty();
  }
  b.setLoc(access->getLoc());
  b.setInsertionPoint(access);
  // In the original program, iterations that do not own the element store to it
  // as well, so they are checked, too.
  if (scf::IfOp branch =
          getOwnersBranch(access, getEnclosingParallelLoop(access))) {
    auto isKnown = [&](Value value) {
      return !branch->isAncestor(value.getParentBlock()->getParentOp());
    };
    if (llvm::all_of(indices, isKnown) && llvm::all_of(components, isKnown))
      b.setInsertionPoint(branch);
  }
  Builder attributes(access->getContext());
  described.push_back(attributes.getArrayAttr(
      {cast<FieldAccessOpInterface>(access).getFieldAttr(),
       attributes.getI32IntegerAttr(static_cast<int32_t>(use)),
       LocationAttr(access->getLoc())}));
  ++ordinal;
  id = b.createOrFold<arith::AddIOp>(base, integer(ordinal));
  Value isInside;
  Value number = createComponent(*current, indices, components, isInside);
  auto branch = scf::IfOp::create(b, isInside, /*withElseRegion=*/false);
  b.setInsertionPointToStart(branch.thenBlock());
  int64_t parts = 1;
  if (components.empty())
    for (int64_t extent : current->elementShape)
      parts *= extent;
  if (parts != 1) {
    auto loop = scf::ForOp::create(b, index(0), index(parts), index(1));
    b.setInsertionPointToStart(loop.getBody());
    number = arith::AddIOp::create(b, number, loop.getInductionVar());
  }
  check(access, use, isClearing, number);
  if (usesOld)
    write(id, number, ShadowWord::Reader);
  return success();
}

LogicalResult Instrumentation::run(ArrayRef<FieldOp> fields) {
  Location loc = kernel.getLoc();
  auto addArgument = [&](Type type) -> Value {
    unsigned position = kernel.getNumArguments();
    (void)kernel.insertArgument(position, type, {}, loc);
    return kernel.getArgument(position);
  };
  auto arrayOf = [&](Type type) {
    return MemRefType::get({ShapedType::kDynamic}, type);
  };
  SmallVector<Operation *> accesses;
  kernel.walk([&](Operation *op) {
    if (isa<LoadOp, StoreOp, AtomicOp>(op))
      accesses.push_back(op);
  });
  for (FieldOp field : fields) {
    FailureOr<FieldLayout> layout = getFieldLayout(field);
    if (failed(layout))
      return failure();
    Shadow shadow{addArgument(arrayOf(b.getI32Type())), *layout, {}};
    if (auto vector = dyn_cast<VectorType>(field.getType()))
      llvm::append_range(shadow.elementShape, vector.getShape());
    shadows.insert({getFieldStorageKey(field), std::move(shadow)});
  }
  log = addArgument(arrayOf(b.getI64Type()));
  base = addArgument(b.getI32Type());
  for (Operation *access : accesses)
    if (failed(instrument(access)))
      return failure();
  kernel.setCheckedAccessesAttr(b.getArrayAttr(described));
  return success();
}

namespace {
struct InstrumentAccesses
    : tai::impl::InstrumentAccessesBase<InstrumentAccesses> {
  void runOnOperation() override {
    WalkResult launches = getOperation().walk([](LaunchOp launch) {
      launch.emitOpError("of a kernel that would take more arguments then; "
                         "instruments modules without host programs");
      return WalkResult::interrupt();
    });
    if (launches.wasInterrupted())
      return signalPassFailure();
    SmallVector<FieldOp> fields = getShadowedFields(getOperation());
    for (KernelOp kernel : getOperation().getOps<KernelOp>()) {
      if (kernel.getCheckedAccesses()) {
        kernel.emitError("the accesses of this kernel are checked already");
        return signalPassFailure();
      }
      if (failed(Instrumentation(kernel).run(fields)))
        return signalPassFailure();
    }
  }
};
} // namespace
