//===- ShadowExecution.cpp - Floats with shadows --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The last pass before LLVM IR: here, every float is a value of the LLVM
// dialect, whatever op it was lowered from, and has a source location. Shadows
// are values too; each float block argument gets a block argument for its
// shadow.
//
// Operands that have lost digits make most results computed from them wrong as
// well. So a result is reported only if its operands are right: these tests,
// mostly shared with the tests of earlier results, are outside the branch that
// reports.
//
//===----------------------------------------------------------------------===//

#include "ShadowOps.h"
#include "ShadowReports.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/RegionGraphTraits.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToHost/RuntimeCalls.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Support/Places.h"
#include "llvm/ADT/PostOrderIterator.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SHADOWEXECUTION
#include "tai/Conversion/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kTable = "tai_rt_shadows";
/// The branch weight of shadow reports: the number of results that are not
/// reported for each reported result.
static constexpr uint32_t kRightToWrong = 100;

static bool isFloat(Type type) {
  return isa<FloatType>(getElementTypeOrSelf(type)) &&
         (isa<FloatType>(type) || isa<VectorType>(type));
}

static int64_t countLanes(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? vector.getNumElements() : 1;
}

static Type withElement(Type type, Type element) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? Type(vector.clone(element)) : element;
}

namespace {
/// Computes shadows (values in higher precision) of the floats in one function.
class Shadows {
public:
  Shadows(LLVM::LLVMFuncOp function, RuntimeCalls &runtime,
          ShadowReports::Texts &texts, Type largest, unsigned mostPrecision)
      : b(function.getLoc(), function.getContext()), function(function),
        runtime(runtime), reports(b, function, runtime, texts),
        largest(largest), mostPrecision(mostPrecision) {}

  void run();

private:
  /// An operation whose result is compared with its shadow value at run time.
  struct Site {
    Operation *op;
    /// An i1 that is true if there may be an error to report, or one i1 for
    /// each lane.
    Value fires;
    Value a, b;
    /// The result that is compared with its shadow value; null for comparisons
    /// and conversions.
    Value result;
  };

  Type shadowType(Type type) {
    Type element = getElementTypeOrSelf(type);
    return withElement(type, element.isF64() ? largest : Type(b.getF64Type()));
  }
  /// Returns the number of significand bits of a float type.
  static unsigned getPrecision(Type type) {
    return APFloat::semanticsPrecision(
        cast<FloatType>(getElementTypeOrSelf(type)).getFloatSemantics());
  }
  /// Returns the number of bits that can be right in a value of the type: if
  /// the program extends narrower floats to f64, results in f64 have no more
  /// correct bits than those floats.
  unsigned getMeasure(Type type) {
    return std::min(getPrecision(type), mostPrecision);
  }
  /// Emits a constant of a type in which shadow values are computed.
  Value constant(Type type, const APFloat &value);
  Value constant(Type type, double value) {
    return constant(type, APFloat(value));
  }
  Value integer(unsigned bits, int64_t value) {
    return LLVM::ConstantOp::create(b, b.getIntegerType(bits), value);
  }
  Value convert(Value value, Type type);
  Value extend(Value value) {
    return convert(value, shadowType(value.getType()));
  }
  Value getShadow(Value value);
  /// Emits the shadow minus the value, in the shadow's type.
  Value getError(Value value) {
    return LLVM::FSubOp::create(b, getShadow(value), extend(value));
  }

  Value emitIsOff(Value value);
  Value emitIsTainted(Value value);
  Value emitFires(const Site &site);
  Value either(Value a, Value b) {
    return !a ? b : !b ? a : Value(LLVM::OrOp::create(this->b, a, b));
  }

  Value makeShadow(Operation *op);
  Value makeWideChoice(Operation *op);
  Value makeAtomic(LLVM::AtomicRMWOp op);
  void visit(Operation *op);
  void addSite(Operation *op, Value a, Value other);
  void addFlip(Operation *op);
  void store(LLVM::StoreOp op);
  Value load(LLVM::LoadOp op);
  void move(Operation *op, Value to, Value from, Value bytes);
  Value entryOf(Value address);
  void flush(Operation *before);
  void report(const Site &site);

  ImplicitLocOpBuilder b;
  LLVM::LLVMFuncOp function;
  RuntimeCalls &runtime;
  ShadowReports reports;
  /// The type of the shadows of f64: f80 or f128.
  Type largest;
  unsigned mostPrecision;
  Value table;
  DenseMap<Value, Value> shadows, off, tainted;
  /// For each loaded value, its shadow minus the value, as memory holds it.
  DenseMap<Value, Value> parts;
  SmallVector<Site> sites;
};
} // namespace

Value Shadows::constant(Type type, const APFloat &value) {
  auto element = cast<FloatType>(getElementTypeOrSelf(type));
  APFloat converted = value;
  bool losesInfo;
  converted.convert(element.getFloatSemantics(), APFloat::rmNearestTiesToEven,
                    &losesInfo);
  TypedAttr attribute = FloatAttr::get(element, converted);
  if (auto vector = dyn_cast<VectorType>(type))
    attribute = DenseElementsAttr::get(vector, Attribute(attribute));
  return LLVM::ConstantOp::create(b, type, attribute);
}

Value Shadows::convert(Value value, Type type) {
  unsigned from = getPrecision(value.getType()), to = getPrecision(type);
  if (from == to)
    return value;
  if (from < to)
    return LLVM::FPExtOp::create(b, type, value);
  return LLVM::FPTruncOp::create(b, type, value);
}

/// Returns the shadow of a value. A value without a computed shadow is its own
/// shadow.
Value Shadows::getShadow(Value value) {
  Value &shadow = shadows[value];
  if (shadow)
    return shadow;
  OpBuilder::InsertionGuard guard(b);
  b.setInsertionPointAfterValue(value);
  auto known = value.getDefiningOp<LLVM::ConstantOp>();
  auto number = known ? dyn_cast<FloatAttr>(known.getValue()) : FloatAttr();
  Value made = number ? constant(shadowType(value.getType()), number.getValue())
                      : extend(value);
  return shadows[value] = made;
}

/// Emits the test whether less than half of the bits of a value v with shadow s
/// are right: |s - v| > 2^-p/2 |s| + least. True for NaN.
Value Shadows::emitIsOff(Value value) {
  Value shadow = getShadow(value);
  Type type = shadow.getType();
  auto element = cast<FloatType>(getElementTypeOrSelf(value.getType()));
  // The error of a loaded value is in `parts`; any other error is computed.
  Value error = parts.lookup(value);
  error = LLVM::FAbsOp::create(b, error ? error : getError(value));
  Value most = LLVM::FMulAddOp::create(
      b, LLVM::FAbsOp::create(b, shadow),
      constant(type, std::ldexp(1, -int(getMeasure(value.getType()) / 2))),
      constant(type,
               APFloat::getSmallestNormalized(element.getFloatSemantics())));
  return LLVM::FCmpOp::create(b, LLVM::FCmpPredicate::ugt, error, most);
}

/// Returns the scalar that all lanes of a vector equal, if it is known.
static Value getSplat(Value value) {
  auto lanes = value.getDefiningOp<LLVM::ShuffleVectorOp>();
  auto first =
      lanes ? lanes.getV1().getDefiningOp<LLVM::InsertElementOp>() : nullptr;
  llvm::APInt position;
  if (!first || !matchPattern(first.getPosition(), m_ConstantInt(&position)) ||
      !position.isZero() ||
      llvm::any_of(lanes.getMask(), [](int32_t lane) { return lane != 0; }))
    return {};
  return first.getValue();
}

/// Emits a test whether operands from which the value was computed by rounding
/// alone differ from their shadows; null if they cannot.
Value Shadows::emitIsTainted(Value value) {
  if (auto known = tainted.find(value); known != tainted.end())
    return known->second;
  Operation *op = value.getDefiningOp();
  Value any;
  if (isa_and_nonnull<LLVM::ConstantOp, LLVM::SIToFPOp, LLVM::UIToFPOp>(op)) {
    any = {};
  } else if (Value scalar = getSplat(value)) {
    any = emitIsTainted(scalar);
    if (any)
      any = emitSplat(b, any, value.getType());
  } else if (!op || !onlyRounds(op) || !shadows.contains(value) ||
             isa<LLVM::ExtractElementOp, LLVM::InsertElementOp,
                 LLVM::ShuffleVectorOp>(op)) {
    any = off.lookup(value);
    if (!any)
      any = emitIsOff(value);
  } else {
    for (Value operand : op->getOperands())
      if (isFloat(operand.getType()))
        any = either(any, emitIsTainted(operand));
  }
  return tainted[value] = any;
}

/// Emits the address of the copy of the float at `address` in the table of
/// shadows. The copy is followed by the shadow minus the float.
Value Shadows::entryOf(Value address) {
  Type i64 = b.getI64Type();
  Value bits = LLVM::PtrToIntOp::create(b, i64, address);
  bits = LLVM::AndOp::create(b, bits, integer(64, int64_t(TAI_SHADOW_MASK)));
  bits = LLVM::ShlOp::create(b, bits, integer(64, 1));
  return LLVM::GEPOp::create(b, runtime.getPointerType(), b.getI8Type(), table,
                             ArrayRef<LLVM::GEPArg>{bits});
}

static SmallVector<int32_t> everySecond(int64_t lanes, int32_t first) {
  SmallVector<int32_t> mask;
  for (int64_t i = 0; i < lanes; ++i)
    mask.push_back(static_cast<int32_t>(2 * i) + first);
  return mask;
}

static bool hasEntries(Type type) {
  Type element = getElementTypeOrSelf(type);
  return element.isF32() || element.isF64();
}

Value Shadows::load(LLVM::LoadOp op) {
  Type type = op.getType();
  if (!hasEntries(type))
    return {};
  int64_t lanes = countLanes(type);
  Type element = getElementTypeOrSelf(type);
  Value entry = entryOf(op.getAddr());
  Value pairs =
      LLVM::LoadOp::create(b, VectorType::get({2 * lanes}, element), entry,
                           element.getIntOrFloatBitWidth() / 8);
  Value copy, part;
  if (isa<VectorType>(type)) {
    copy =
        LLVM::ShuffleVectorOp::create(b, pairs, pairs, everySecond(lanes, 0));
    part =
        LLVM::ShuffleVectorOp::create(b, pairs, pairs, everySecond(lanes, 1));
  } else {
    copy = LLVM::ExtractElementOp::create(b, pairs, integer(32, 0));
    part = LLVM::ExtractElementOp::create(b, pairs, integer(32, 1));
  }
  Value same =
      LLVM::FCmpOp::create(b, LLVM::FCmpPredicate::oeq, copy, op.getResult());
  part = LLVM::SelectOp::create(b, same, part, constant(type, 0));
  part = convert(part, shadowType(type));
  parts[op.getResult()] = part;
  return LLVM::FAddOp::create(b, extend(op.getResult()), part);
}

void Shadows::store(LLVM::StoreOp op) {
  Value value = op.getValue();
  Type type = value.getType();
  if (!hasEntries(type))
    return;
  b.setInsertionPointAfter(op);
  int64_t lanes = countLanes(type);
  Value part = convert(getError(value), type);
  Type pairType = VectorType::get({2 * lanes}, getElementTypeOrSelf(type));
  Value pairs;
  if (isa<VectorType>(type)) {
    SmallVector<int32_t> mask;
    for (int64_t i = 0; i < lanes; ++i)
      llvm::append_values(mask, int32_t(i), int32_t(lanes + i));
    pairs = LLVM::ShuffleVectorOp::create(b, value, part, mask);
  } else {
    pairs = LLVM::UndefOp::create(b, pairType);
    pairs = LLVM::InsertElementOp::create(b, pairs, value, integer(32, 0));
    pairs = LLVM::InsertElementOp::create(b, pairs, part, integer(32, 1));
  }
  LLVM::StoreOp::create(b, pairs, entryOf(op.getAddr()),
                        getElementTypeOrSelf(type).getIntOrFloatBitWidth() / 8);
}

void Shadows::move(Operation *op, Value to, Value from, Value bytes) {
  b.setInsertionPointAfter(op);
  if (!bytes.getType().isInteger(64))
    bytes = LLVM::ZExtOp::create(b, b.getI64Type(), bytes);
  if (!from)
    from = LLVM::ZeroOp::create(b, runtime.getPointerType());
  runtime.tai_rt_shadow_move(b, b.getLoc(), function.getArgument(0), to, from,
                             bytes);
}

static std::optional<int32_t> getUpdate(LLVM::AtomicBinOp kind) {
  switch (kind) {
  case LLVM::AtomicBinOp::fadd:
    return TAI_SHADOW_ADD;
  case LLVM::AtomicBinOp::fsub:
    return TAI_SHADOW_SUB;
  case LLVM::AtomicBinOp::fmin:
  case LLVM::AtomicBinOp::fminimum:
    return TAI_SHADOW_MIN;
  case LLVM::AtomicBinOp::fmax:
  case LLVM::AtomicBinOp::fmaximum:
    return TAI_SHADOW_MAX;
  default:
    return std::nullopt;
  }
}

/// Replaces an atomic update by a call of the runtime, which updates the float
/// and its shadow in one step. The new value is compared with its shadow here.
Value Shadows::makeAtomic(LLVM::AtomicRMWOp op) {
  Value value = op.getVal();
  Type type = value.getType();
  std::optional<int32_t> kind = getUpdate(op.getBinOp());
  if (!kind || !isa<FloatType>(type) || !hasEntries(type))
    return {};
  Location loc = op.getLoc();
  Type f64 = b.getF64Type();
  Value room;
  {
    OpBuilder::InsertionGuard guard(b);
    b.setInsertionPointToStart(&function.getBody().front());
    room = LLVM::AllocaOp::create(b, runtime.getPointerType(), f64,
                                  integer(64, 1));
  }
  Value old = runtime.tai_rt_shadow_atomic(
      b, loc, function.getArgument(0), op.getPtr(), integer(32, *kind),
      integer(32, type.getIntOrFloatBitWidth()), convert(value, f64),
      convert(getError(value), f64), room);
  Value exact = LLVM::FAddOp::create(
      b, convert(old, shadowType(type)),
      convert(LLVM::LoadOp::create(b, f64, room), shadowType(type)));
  Value result = convert(old, type);
  shadows[result] = exact;
  op.getResult().replaceAllUsesWith(result);
  if (*kind == TAI_SHADOW_ADD || *kind == TAI_SHADOW_SUB) {
    bool adds = *kind == TAI_SHADOW_ADD;
    auto sum = [&](Value a, Value other) -> Value {
      if (adds)
        return LLVM::FAddOp::create(b, a, other);
      return LLVM::FSubOp::create(b, a, other);
    };
    Value made = sum(result, value);
    shadows[made] = sum(exact, getShadow(value));
    addSite(made.getDefiningOp(), result, value);
  }
  op.erase();
  return exact;
}

/// Emits the shadow of a minimum, a maximum or a copysign of f64. LLVM 22
/// cannot compile these operations on the shadow type f80, because their
/// expansions compare 80-bit integers, so the operands and result in f64 decide
/// the shadow.
Value Shadows::makeWideChoice(Operation *op) {
  if (op->getNumOperands() != 2 ||
      !getElementTypeOrSelf(op->getResult(0).getType()).isF64())
    return {};
  Value a = op->getOperand(0), other = op->getOperand(1);
  bool isMin = isa<LLVM::MinNumOp, LLVM::MinimumOp>(op);
  if (isMin || isa<LLVM::MaxNumOp, LLVM::MaximumOp>(op)) {
    // The shadow is the shadow of the chosen operand. If both operands are
    // equal, either shadow is right.
    Value takesA =
        LLVM::FCmpOp::create(b, LLVM::FCmpPredicate::oeq, op->getResult(0), a);
    return LLVM::SelectOp::create(b, takesA, getShadow(a), getShadow(other));
  }
  if (!isa<LLVM::CopySignOp>(op))
    return {};
  Value one = LLVM::CopySignOp::create(b, constant(a.getType(), 1), other);
  return LLVM::FMulOp::create(b, LLVM::FAbsOp::create(b, getShadow(a)),
                              extend(one));
}

/// Emits the shadow of the result of an operation that yields a float; null if
/// it cannot be computed.
Value Shadows::makeShadow(Operation *op) {
  Value result = op->getResult(0);
  Type type = shadowType(result.getType());
  if (auto read = dyn_cast<LLVM::LoadOp>(op))
    return load(read);
  if (isa<LLVM::FPExtOp, LLVM::FPTruncOp>(op))
    return convert(getShadow(op->getOperand(0)), type);
  if (isa<LLVM::SIToFPOp>(op))
    return LLVM::SIToFPOp::create(b, type, op->getOperand(0));
  if (isa<LLVM::UIToFPOp>(op))
    return LLVM::UIToFPOp::create(b, type, op->getOperand(0));
  if (auto call = dyn_cast<LLVM::CallOp>(op)) {
    if (!call.getCallee() || isa<VectorType>(result.getType()))
      return {};
    std::string name = nameWiderCall(*call.getCallee(), result.getType(), type);
    SmallVector<Value> operands;
    for (Value operand : call.getArgOperands()) {
      if (operand.getType() != result.getType())
        return {};
      operands.push_back(getShadow(operand));
    }
    if (name.empty())
      return {};
    return runtime.call(b, op->getLoc(), name, type, operands, /*pure=*/true);
  }
  if (Value chosen = makeWideChoice(op))
    return chosen;
  bool computes =
      onlyRounds(op) ||
      isa<LLVM::FAddOp, LLVM::FSubOp, LLVM::FRemOp, LLVM::UndefOp,
          LLVM::PoisonOp, LLVM::ZeroOp>(op) ||
      (op->getName().stripDialect().starts_with("intr.") && isPure(op) &&
       llvm::all_of(op->getOperandTypes(), [&](Type operand) {
         return !isFloat(operand) ||
                getElementTypeOrSelf(operand) == getElementTypeOrSelf(result);
       }));
  if (!computes)
    return {};
  IRMapping mapping;
  for (Value operand : op->getOperands())
    if (isFloat(operand.getType()))
      mapping.map(operand, getShadow(operand));
  Operation *clone = b.clone(*op, mapping);
  clone->getResult(0).setType(type);
  if (auto flags = dyn_cast<LLVM::FastmathFlagsInterface>(clone)) {
    auto none =
        LLVM::FastmathFlagsAttr::get(b.getContext(), LLVM::FastmathFlags::none);
    clone->setAttr(flags.getFastmathAttrName(), none);
    // The op itself gets no fast-math flags either: the value that is compared
    // must be the value that is computed.
    op->setAttr(flags.getFastmathAttrName(), none);
  }
  return clone->getResult(0);
}

static bool leavesBlock(Value value) {
  return llvm::any_of(value.getUsers(), [&](Operation *user) {
    return user->getBlock() != value.getParentBlock() ||
           user->hasTrait<OpTrait::IsTerminator>() ||
           isa<LLVM::StoreOp, LLVM::CallOp>(user);
  });
}

void Shadows::addSite(Operation *op, Value a, Value other) {
  Value result = op->getResult(0);
  Value isOff = emitIsOff(result);
  off[result] = isOff;
  sites.push_back({op, isOff, a, other, result});
}

/// Emits the test, for each lane, whether the site has an error to report.
Value Shadows::emitFires(const Site &site) {
  if (!site.result)
    return site.fires;
  Value before = emitIsTainted(site.a);
  if (site.b)
    before = either(before, emitIsTainted(site.b));
  if (!before)
    return site.fires;
  TypedAttr all = b.getBoolAttr(true);
  if (auto vector = dyn_cast<VectorType>(before.getType()))
    all = DenseElementsAttr::get(vector, true);
  Value yes = LLVM::ConstantOp::create(b, before.getType(), all);
  return LLVM::AndOp::create(b, site.fires,
                             LLVM::XOrOp::create(b, before, yes));
}

/// Adds a site for a comparison or a conversion to an integer, whose result may
/// differ for the shadows.
void Shadows::addFlip(Operation *op) {
  Value a = op->getOperand(0), other;
  IRMapping mapping;
  for (Value operand : op->getOperands())
    mapping.map(operand, getShadow(operand));
  Value exact;
  if (isa<LLVM::FCmpOp>(op)) {
    other = op->getOperand(1);
    exact = b.clone(*op, mapping)->getResult(0);
  } else {
    // Freeze the conversion of the shadow, which may be out of the integer's
    // range.
    exact = b.clone(*op, mapping)->getResult(0);
    exact = LLVM::FreezeOp::create(b, exact);
  }
  Value known = op->getResult(0);
  if (!isa<LLVM::FCmpOp>(op))
    known = LLVM::FreezeOp::create(b, known);
  Value fires = LLVM::ICmpOp::create(b, LLVM::ICmpPredicate::ne, known, exact);
  sites.push_back({op, fires, a, other, {}});
}

void Shadows::visit(Operation *op) {
  b.setLoc(op->getLoc());
  b.setInsertionPointAfter(op);
  if (auto write = dyn_cast<LLVM::StoreOp>(op)) {
    if (isFloat(write.getValue().getType()))
      store(write);
    return;
  }
  if (auto atomic = dyn_cast<LLVM::AtomicRMWOp>(op)) {
    (void)makeAtomic(atomic);
    return;
  }
  if (auto copy = dyn_cast<LLVM::MemcpyOp>(op))
    return move(op, copy.getDst(), copy.getSrc(), copy.getLen());
  if (auto copy = dyn_cast<LLVM::MemmoveOp>(op))
    return move(op, copy.getDst(), copy.getSrc(), copy.getLen());
  if (auto fill = dyn_cast<LLVM::MemsetOp>(op))
    return move(op, fill.getDst(), {}, fill.getLen());
  if (isa<LLVM::FCmpOp, LLVM::FPToSIOp, LLVM::FPToUIOp>(op))
    return addFlip(op);
  if (op->getNumResults() != 1 || !isFloat(op->getResult(0).getType()) ||
      isa<LLVM::ConstantOp>(op))
    return;
  Value shadow = makeShadow(op);
  if (!shadow)
    return;
  Value result = op->getResult(0);
  shadows[result] = shadow;
  b.setInsertionPointAfterValue(shadow);
  bool compared =
      isa<LLVM::FAddOp, LLVM::FSubOp, LLVM::FRemOp, LLVM::CallOp>(op) ||
      (onlyRounds(op) ? !onlyMoves(op) && leavesBlock(result)
                      : op->getName().stripDialect().starts_with("intr."));
  if (!compared)
    return;
  SmallVector<Value> operands =
      llvm::filter_to_vector(op->getOperands(), [&](Value operand) {
        return operand.getType() == result.getType();
      });
  if (!operands.empty())
    addSite(op, operands[0], operands.size() > 1 ? operands[1] : Value());
}

void Shadows::report(const Site &site) {
  b.setLoc(site.op->getLoc());
  Type f64 = b.getF64Type();
  Value typed = site.result ? site.result : site.a;
  unsigned precision = getMeasure(typed.getType());
  Type type = withElement(typed.getType(), f64);
  ShadowReports::Numbers numbers;
  auto set = [&](Value value, Value &number, Value &error) {
    number = value ? convert(value, type) : constant(type, 0);
    error = value ? convert(getError(value), type) : constant(type, 0);
  };
  set(site.a, numbers.a, numbers.errorOfA);
  set(site.b, numbers.b, numbers.errorOfB);
  numbers.isUnary = !site.b;
  if (site.result) {
    set(site.result, numbers.result, numbers.error);
    numbers.exact = convert(getShadow(site.result), type);
    return reports.emitResult(site.op, precision, site.fires, numbers);
  }
  if (!isa<VectorType>(type))
    return reports.emitFlip(site.op, precision, numbers);
  for (int64_t lane = 0, lanes = countLanes(type); lane < lanes; ++lane) {
    auto pick = [&](Value value) -> Value {
      return LLVM::ExtractElementOp::create(b, value, integer(32, lane));
    };
    // Branch around the report for each lane, since only some lanes may have an
    // error.
    Block *here = b.getInsertionBlock();
    Block *rest = here->splitBlock(b.getInsertionPoint());
    Block *told = b.createBlock(rest);
    b.setInsertionPointToEnd(here);
    LLVM::CondBrOp::create(b, pick(site.fires), told, rest);
    b.setInsertionPointToEnd(told);
    ShadowReports::Numbers own;
    own.a = pick(numbers.a);
    own.errorOfA = pick(numbers.errorOfA);
    own.b = pick(numbers.b);
    own.errorOfB = pick(numbers.errorOfB);
    reports.emitFlip(site.op, precision, own);
    LLVM::BrOp::create(b, rest);
    b.setInsertionPointToStart(rest);
  }
}

/// Emits, for each pending site, a branch that reports its error.
void Shadows::flush(Operation *before) {
  b.setInsertionPoint(before);
  for (Site &site : sites) {
    b.setLoc(site.op->getLoc());
    site.fires = emitFires(site);
    Value any = site.fires;
    if (isa<VectorType>(any.getType()))
      any = LLVM::vector_reduce_or::create(b, b.getI1Type(), any);
    Block *here = before->getBlock();
    Block *rest = here->splitBlock(before);
    Block *told = b.createBlock(rest);
    b.setInsertionPointToEnd(here);
    LLVM::CondBrOp::create(b, any, told, ValueRange(), rest, ValueRange(),
                           std::make_pair(uint32_t(1), kRightToWrong));
    b.setInsertionPointToEnd(told);
    report(site);
    LLVM::BrOp::create(b, rest);
    b.setInsertionPoint(before);
  }
  sites.clear();
}

void Shadows::run() {
  Region &body = function.getBody();
  SmallVector<Block *> order;
  for (Block *block : llvm::ReversePostOrderTraversal<Region *>(&body))
    order.push_back(block);
  SmallVector<SmallVector<Operation *>> operations;
  for (Block *block : order) {
    operations.emplace_back();
    for (Operation &op : *block)
      operations.back().push_back(&op);
  }
  Block *entry = &body.front();
  b.setInsertionPointToStart(entry);
  Value address =
      LLVM::AddressOfOp::create(b, runtime.getPointerType(), kTable);
  auto base = LLVM::LoadOp::create(b, runtime.getPointerType(), address);
  base.setInvariant(true);
  table = base;

  // For each block, the positions of its arguments that are floats.
  DenseMap<Block *, SmallVector<unsigned>> passed;
  for (Block *block : order) {
    if (block == entry)
      continue;
    for (unsigned i = 0, e = block->getNumArguments(); i < e; ++i) {
      BlockArgument argument = block->getArgument(i);
      if (!isFloat(argument.getType()))
        continue;
      passed[block].push_back(i);
      shadows[argument] =
          block->addArgument(shadowType(argument.getType()), argument.getLoc());
    }
  }
  for (SmallVector<Operation *> &ops : operations) {
    // The list of tested values is cleared at each block, because a value that
    // was tested in one block may be untested in another.
    tainted.clear();
    for (Operation *op : ops) {
      if (op->hasTrait<OpTrait::IsTerminator>())
        continue;
      Operation *next = op->getNextNode();
      visit(op);
      flush(next);
    }
  }
  // All shadows of the function have been computed, and are now passed to
  // successor blocks.
  for (SmallVector<Operation *> &ops : operations) {
    auto branch = dyn_cast<BranchOpInterface>(ops.back());
    if (!branch)
      continue;
    b.setLoc(branch.getLoc());
    for (unsigned i = 0, e = branch->getNumSuccessors(); i < e; ++i) {
      SuccessorOperands operands = branch.getSuccessorOperands(i);
      SmallVector<Value> more;
      for (unsigned position : passed.lookup(branch->getSuccessor(i)))
        more.push_back(getShadow(operands[position]));
      operands.append(more);
    }
  }
  reports.finish();
}

namespace {
struct ShadowExecution : tai::impl::ShadowExecutionBase<ShadowExecution> {
  using Base::Base;

  void runOnOperation() override {
    ModuleOp module = getOperation();
    MLIRContext *context = &getContext();
    Type largest;
    if (f64Shadow == "f80")
      largest = Float80Type::get(context);
    else if (f64Shadow == "f128")
      largest = Float128Type::get(context);
    if (!largest) {
      module.emitError("the shadows of f64 are f80 or f128, not '")
          << f64Shadow << "'";
      return signalPassFailure();
    }
    SmallVector<LLVM::LLVMFuncOp> functions;
    for (auto function : module.getOps<LLVM::LLVMFuncOp>())
      if (!function.isExternal() && function.getNumArguments() &&
          isa<LLVM::LLVMPointerType>(function.getArgument(0).getType()) &&
          isTaiCode(function))
        functions.push_back(function);
    if (functions.empty())
      return;
    if (Operation *table = SymbolTable::lookupSymbolIn(module, kTable)) {
      table->emitError("the floats of this module have shadows already");
      return signalPassFailure();
    }
    auto b = OpBuilder::atBlockBegin(module.getBody());
    LLVM::GlobalOp::create(
        b, module.getLoc(), LLVM::LLVMPointerType::get(context),
        /*isConstant=*/false, LLVM::Linkage::External, kTable, Attribute());
    RuntimeCalls runtime(module);
    ShadowReports::Texts texts;
    unsigned mostPrecision = ~0u;
    for (LLVM::LLVMFuncOp function : functions)
      function.walk([&](LLVM::FPExtOp op) {
        Type type = getElementTypeOrSelf(op.getArg().getType());
        mostPrecision = std::min(
            mostPrecision, APFloat::semanticsPrecision(
                               cast<FloatType>(type).getFloatSemantics()));
      });
    for (LLVM::LLVMFuncOp function : functions)
      Shadows(function, runtime, texts, largest, mostPrecision).run();
    ShadowReports::restrictEffects(module);
  }
};
} // namespace
