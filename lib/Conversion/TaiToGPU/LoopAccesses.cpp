//===- LoopAccesses.cpp - Accesses of a parallel loop ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Addresses are sums of captured values, and of indices of the loop and of
// inner loops times constants. Any other index, such as one that is wrapped
// around a border or was read from memory, is only known to be in range:
// out-of-range accesses are undefined.
//
//===----------------------------------------------------------------------===//

#include "tai/Conversion/TaiToGPU/LoopAccesses.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include <numeric>

using namespace mlir;
using namespace mlir::tai;
using runtime::DeviceAccess;

/// The maximum number of memory accesses to analyse, which bounds the time of
/// the analysis.
static constexpr size_t kMostAccesses = 96;

static int64_t getSize(Type type) {
  return isa<LLVM::LLVMPointerType>(type) || type.isIndex()
             ? 8
             : llvm::divideCeil(type.getIntOrFloatBitWidth(), 8);
}

LoopAccesses::LoopAccesses(ParallelForOp loop)
    : loop(loop), expressions(loop), box(getConstantBox(loop)) {
  // The bounds of a box are used only within +-2^31, so that offsets computed
  // from them do not overflow.
  constexpr int64_t most = int64_t(1) << 31;
  if (box)
    for (auto [from, to] : llvm::zip(box->lower, box->upper))
      if (from < -most || to > most) {
        box.reset();
        break;
      }
  for (Value bound : loop->getOperands())
    addSlot(bound);
  loop.getBody().walk([&](Operation *op) { visit(op); });
}

void LoopAccesses::addSlot(Value value) {
  Operation *definition = value.getDefiningOp();
  if (definition && definition->hasAttr(kDeviceSlotAttrName) &&
      loop.isDefinedOutsideOfLoop(value)) {
    ruleOutTiles();
    add(definition->getOperand(0), value.getType(), DeviceAccess::Read, {});
  }
}

void LoopAccesses::visit(Operation *op) {
  for (Value operand : op->getOperands())
    addSlot(operand);
  // An update that the loop does itself is skipped, because addSum records the
  // target of its sum.
  if (isDoneByLoop(op))
    return;
  auto digits = op->getAttrOfType<DenseI64ArrayAttr>(kDigitsAttrName);
  op->removeAttr(kDigitsAttrName);
  if (auto load = dyn_cast<LLVM::LoadOp>(op))
    return add(load.getAddr(), load.getType(), DeviceAccess::Read, digits, op);
  if (auto store = dyn_cast<LLVM::StoreOp>(op))
    return add(store.getAddr(), store.getValue().getType(), DeviceAccess::Write,
               digits, op);
  if (isa<LLVM::AtomicCmpXchgOp, LLVM::AtomicRMWOp>(op))
    ruleOutTiles();
  if (auto exchange = dyn_cast<LLVM::AtomicCmpXchgOp>(op))
    return add(exchange.getPtr(), exchange.getVal().getType(),
               DeviceAccess::Write, digits);
  if (auto update = dyn_cast<LLVM::AtomicRMWOp>(op)) {
    using Kind = LLVM::AtomicBinOp;
    Kind kind = update.getBinOp();
    Type type = update.getVal().getType();
    bool isFloat = kind == Kind::fadd || kind == Kind::fsub;
    bool isSum =
        update->use_empty() &&
        (isFloat ? !loop.getOrder() : kind == Kind::add || kind == Kind::sub);
    return add(update.getPtr(), type,
               isSum ? DeviceAccess::Sum : DeviceAccess::Write, digits);
  }
  // These operations access memory of one thread only.
  if (isa<LLVM::AllocaOp, AllocaOp, LocalLoadOp, LocalStoreOp, StackCreateOp,
          StackPushOp, StackPopOp, StackDestroyOp>(op))
    return;
  if (op->getNumRegions() == 0 && !isMemoryEffectFree(op))
    isKnown = false;
  if (op->getNumRegions() != 0 &&
      !isa<ParallelForOp, scf::ForOp, scf::IfOp, scf::WhileOp,
           scf::IndexSwitchOp, scf::ExecuteRegionOp>(op))
    isKnown = false;
}

/// Widens the access to `count` places, each `step` bytes after the previous
/// one.
void LoopAccesses::widen(Address &address, int64_t count, int64_t step) {
  if (count <= 1 || step == 0)
    return;
  DeviceAccess &access = address.access;
  access.offset += std::min<int64_t>(step, 0) * (count - 1);
  access.window += std::abs(step) * (count - 1);
  access.step = std::gcd(access.step, std::abs(step));
}

/// The number of trips and the first index of a serial loop, given its
/// induction variable `iv`.
static std::optional<std::pair<int64_t, int64_t>> getTrips(BlockArgument iv,
                                                           int64_t &step) {
  Operation *parent = iv.getOwner()->getParentOp();
  std::optional<int64_t> lower, upper;
  step = 1;
  if (auto serial = dyn_cast<scf::ForOp>(parent)) {
    if (iv != serial.getInductionVar())
      return std::nullopt;
    lower = getConstantIntValue(serial.getLowerBound());
    upper = getConstantIntValue(serial.getUpperBound());
    step = getConstantIntValue(serial.getStep()).value_or(0);
    // As unsigned numbers, the lower bound may be greater than the upper bound
    // if either is negative.
    if (serial.getUnsignedCmp() && lower && upper && (*lower < 0 || *upper < 0))
      return std::nullopt;
  } else if (auto inner = dyn_cast<ParallelForOp>(parent)) {
    if (std::optional<LoopBox> box = getConstantBox(inner)) {
      lower = box->lower[iv.getArgNumber()];
      upper = box->upper[iv.getArgNumber()];
    }
  }
  constexpr int64_t most = int64_t(1) << 31;
  if (!lower || !upper || step <= 0 || *lower < -most || *upper > most)
    return std::nullopt;
  return std::pair(llvm::divideCeilSigned(*upper - *lower, step), *lower);
}

bool LoopAccesses::addTerms(Address &address, Value value, int64_t scale) {
  IndexExpr expr = expressions.get(value);
  // Sums in 8 or 16 bits, which may wrap around, stop the analysis.
  if (expr.width < 32)
    return false;
  DeviceAccess &access = address.access;
  access.offset += scale * expr.constant;
  for (const auto &[atom, factor] : expr.terms) {
    Value term = atom.getValue();
    if (!term || factor <= -(int64_t(1) << 31) || factor >= int64_t(1) << 31)
      return false;
    if (!expr.isExact() && std::abs(factor) > 1)
      access.unit = access.unit == 0 ? std::abs(scale)
                                     : std::min(access.unit, std::abs(scale));
    int64_t stride = scale * factor;
    if (loop.isDefinedOutsideOfLoop(term)) {
      Operation *definition = term.getDefiningOp();
      if ((definition && definition->hasAttr(kDeviceSlotAttrName)) ||
          !term.getType().isIntOrIndex())
        return false;
      address.terms.push_back({term, stride});
      continue;
    }
    auto argument = dyn_cast<BlockArgument>(term);
    if (argument && argument.getOwner() == &loop.getBody().front()) {
      if (!box)
        return false;
      unsigned d = argument.getArgNumber();
      access.offset += stride * box->lower[d];
      access.strides[d] += stride;
    } else if (argument) {
      int64_t step = 0;
      auto trips = getTrips(argument, step);
      if (!trips)
        return false;
      access.offset += stride * trips->second;
      widen(address, trips->first, stride * step);
    } else if (term == value || !addTerms(address, term, stride)) {
      // Any other term stops the analysis, because it is a narrow sum that may
      // wrap before it is extended.
      return false;
    }
  }
  return true;
}

bool LoopAccesses::addIndex(Address &address, Value index, int64_t size,
                            ArrayRef<int64_t> digits) {
  Address attempt = address;
  if (addTerms(attempt, index, size)) {
    address = std::move(attempt);
    return true;
  }
  // A digit that is not a sum of known terms can take any value in its range.
  // Digits of larger strides are summands multiplied by their strides.
  SmallVector<int64_t> strides, extents, begins;
  for (size_t i = 0; i + 2 < digits.size(); i += 3) {
    strides.push_back(digits[i]);
    extents.push_back(digits[i + 1]);
    begins.push_back(digits[i + 2]);
  }
  auto widenBy = [&](Address &grown, size_t digit) {
    grown.access.offset += begins[digit] * strides[digit];
    widen(grown, extents[digit], strides[digit]);
  };
  attempt = address;
  llvm::SmallDenseSet<size_t> seen;
  SmallVector<Value> rest;
  for (auto [part, value, factor] : getSummands(index)) {
    size_t digit = part == value
                       ? strides.size()
                       : llvm::find(strides, factor * size) - strides.begin();
    if (digit == strides.size()) {
      rest.push_back(part);
      continue;
    }
    // A digit with a constant value is no variable summand.
    if (extents[digit] == 1 || !seen.insert(digit).second)
      return false;
    Address with = attempt;
    if (addTerms(with, part, size))
      attempt = std::move(with);
    else
      widenBy(attempt, digit);
  }
  Address with = attempt;
  if (llvm::all_of(rest,
                   [&](Value part) { return addTerms(with, part, size); })) {
    address = std::move(with);
    return true;
  }
  // The constants of several digits are one summand in the program, and so are
  // digits that the program multiplies together, so each digit that has no
  // summand of its own takes any value in its range.
  size_t smallest = llvm::find(strides, size) - strides.begin();
  if (smallest == strides.size() || seen.contains(smallest))
    return false;
  for (size_t digit = 0; digit < strides.size(); ++digit)
    if (!seen.contains(digit))
      widenBy(attempt, digit);
  address = std::move(attempt);
  return true;
}

/// Follows `pointer` back to its definition outside of the loop; false for
/// memory that belongs to one thread, and for unknown memory.
bool LoopAccesses::follow(Address &address, Value pointer,
                          DenseI64ArrayAttr digits) {
  while (!loop.isDefinedOutsideOfLoop(pointer)) {
    if (pointer.getDefiningOp<LLVM::AllocaOp>())
      return false;
    auto element = pointer.getDefiningOp<LLVM::GEPOp>();
    isKnown = element && element.getIndices().size() == 1 &&
              element.getElemType().isIntOrFloat();
    if (!isKnown)
      return false;
    int64_t size = getSize(element.getElemType());
    auto index = element.getIndices()[0];
    if (auto constant = dyn_cast<IntegerAttr>(index))
      address.access.offset += constant.getInt() * size;
    else
      isKnown = addIndex(address, cast<Value>(index), size,
                         digits ? digits.asArrayRef() : ArrayRef<int64_t>());
    if (!isKnown)
      return false;
    pointer = element.getBase();
  }
  address.base = pointer;
  if (box)
    for (auto [stride, lower, upper] :
         llvm::zip(address.access.strides, box->lower, box->upper)) {
      if (upper - lower <= 1)
        stride = 0;
      address.access.step = std::gcd(address.access.step, std::abs(stride));
    }
  return true;
}

void LoopAccesses::add(Value pointer, Type type, DeviceAccess::Kind kind,
                       DenseI64ArrayAttr digits, Operation *op) {
  if (!isKnown)
    return;
  Address address;
  address.access.kind = kind;
  address.access.size = address.access.window = getSize(type);
  address.access.strides.assign(loop.getInductionVars().size(), 0);
  if (!follow(address, pointer, digits))
    return;
  if (op)
    addSite(op, address, pointer, digits);
  bool isNew = llvm::none_of(addresses, [&](const Address &other) {
    return other.access == address.access && other.base == address.base &&
           other.terms == address.terms;
  });
  if (isNew)
    addresses.push_back(std::move(address));
  if (addresses.size() > kMostAccesses)
    mergeNeighbours();
  if (addresses.size() > kMostAccesses && box) {
    foldIterations();
    mergeNeighbours();
  }
  isKnown = addresses.size() <= kMostAccesses;
}

/// Merges accesses of one base that differ by a constant offset and leave no
/// gap between them into one access with a larger window: an unrolled sum over
/// a row of weights, say.
void LoopAccesses::mergeNeighbours() {
  SmallVector<std::pair<int64_t, size_t>> order;
  for (auto [i, address] : llvm::enumerate(addresses))
    order.emplace_back(address.access.offset, i);
  llvm::sort(order);
  SmallVector<Address> merged;
  for (auto [offset, i] : order) {
    Address &address = addresses[i];
    const DeviceAccess &access = address.access;
    auto *found = llvm::find_if(merged, [&](const Address &other) {
      const DeviceAccess &before = other.access;
      return before.kind == access.kind && before.size == access.size &&
             before.unit == access.unit && before.strides == access.strides &&
             other.base == address.base && other.terms == address.terms &&
             access.offset <= before.offset + before.window;
    });
    if (found == merged.end()) {
      merged.push_back(std::move(address));
      continue;
    }
    DeviceAccess &before = found->access;
    int64_t distance = access.offset - before.offset;
    before.step =
        std::gcd(std::gcd(before.step, access.step), std::abs(distance));
    before.window = std::max(before.window, distance + access.window);
  }
  addresses = std::move(merged);
}

/// Replaces the cells that each iteration accesses by the range that all
/// iterations access together: unrolled columns of weights are then adjacent.
void LoopAccesses::foldIterations() {
  for (Address &address : addresses)
    for (auto [stride, lower, upper] :
         llvm::zip(address.access.strides, box->lower, box->upper)) {
      widen(address, upper - lower, stride);
      stride = 0;
    }
}

void LoopAccesses::addSum(Value target, Type type, bool isAddition,
                          int64_t threads) {
  effects = Effects::Sums;
  Type storage = getStorageType(type);
  if (threads == 0)
    return add(target, storage,
               isAddition && (!loop.getOrder() || !isa<FloatType>(type))
                   ? DeviceAccess::Sum
                   : DeviceAccess::Write,
               {});
  // Partial sums belong to a fixed number of virtual threads; a thread of the
  // launch runs all iterations of a virtual thread.
  isGridStride = false;
  add(target, storage, DeviceAccess::Write, {});
  if (isKnown)
    widen(addresses.back(), threads, getSize(storage));
}

/// Replaces captured values in the address of an access by the numbers of the
/// parameters that hold them.
bool LoopAccesses::complete(Address &address, ParameterFinder getParameter) {
  DeviceAccess &access = address.access;
  auto slot = getParameter(address.base);
  if (!slot)
    return false;
  access.slot = slot->first;
  access.offset += slot->second;
  for (auto [value, factor] : address.terms) {
    auto term = getParameter(value);
    if (!term)
      return false;
    Type type = value.getType();
    // An i1 stops the analysis, because it is not sign-extended, contrary to
    // the values in `terms`.
    int64_t bits = type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
    if (bits == 1 || bits > 64)
      return false;
    access.terms.push_back({term->first, bits, factor});
  }
  return true;
}

DenseI64ArrayAttr LoopAccesses::encode(ParameterFinder getParameter) {
  if (!isKnown)
    return {};
  runtime::FunctionAccesses result;
  result.isGridStride = isGridStride;
  // For the order of memory accesses, a loop in one warp that synchronises
  // before and after the loop acts like one thread.
  bool inWarp = loop.getInWarp();
  bool isSingle = inWarp && box && effects != Effects::Sums;
  if (isSingle)
    foldIterations();
  else if (inWarp)
    result.isGridStride = false;
  for (size_t d = 0; d < loop.getInductionVars().size(); ++d)
    result.extents.push_back(
        isSingle ? 1
        : box    ? std::max<int64_t>(box->upper[d] - box->lower[d], 0)
                 : -1);
  for (Address &address : addresses) {
    if (!complete(address, getParameter))
      return {};
    result.accesses.push_back(std::move(address.access));
  }
  return DenseI64ArrayAttr::get(loop.getContext(), result.encode());
}
