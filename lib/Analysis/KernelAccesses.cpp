//===- KernelAccesses.cpp - Access summaries of kernels -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/KernelAccesses.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "mlir/IR/Matchers.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "llvm/ADT/StringMap.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the number of argument slots that a value of the type occupies; see
/// Abi.h.
static int64_t countSlots(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return vector.getNumElements();
  if (auto memref = dyn_cast<MemRefType>(type))
    return 1 + memref.getRank();
  return 1;
}

int64_t mlir::tai::countSlots(TypeRange types) {
  int64_t slots = 0;
  for (Type type : types)
    slots += ::countSlots(type);
  return slots;
}

/// Maps the integer arguments of all kernels to their argument slots.
static DenseMap<Value, int64_t> findIntegerArguments(ModuleOp module) {
  DenseMap<Value, int64_t> slots;
  for (KernelOp kernel : module.getOps<KernelOp>()) {
    int64_t next = 0;
    for (BlockArgument argument : kernel.getArguments()) {
      if (argument.getType().isSignlessInteger() &&
          argument.getType().getIntOrFloatBitWidth() <= 64)
        slots[argument] = next;
      next += ::countSlots(argument.getType());
    }
  }
  return slots;
}

using ArgumentSlots = DenseMap<Value, int64_t>;

/// Describes the index along `dimension` in terms of the launch's arguments, if
/// it is a sum of constants and integer arguments; otherwise none.
static std::optional<runtime::FixedIndex>
evaluateOnLaunch(const IndexExpr &form, size_t dimension,
                 const ArgumentSlots &slots) {
  runtime::FixedIndex fixed{
      static_cast<int64_t>(dimension), form.constant, {}, form.width};
  for (const auto &[atom, factor] : form.terms) {
    Value term = atom.getValue();
    auto slot = slots.find(term);
    if (slot == slots.end())
      return std::nullopt;
    unsigned bits =
        term.getType().isIndex() ? 64 : term.getType().getIntOrFloatBitWidth();
    fixed.terms.push_back({slot->second, bits, factor});
  }
  return fixed;
}

/// Replaces the index of a loop by the lower bound, if the loop has at most one
/// iteration.
static void replaceIfSingle(IndexExpr &form, Value iv, Value lower, Value upper,
                            int64_t step) {
  if (!form.mentions(iv))
    return;
  IndexExpr from = getIndexExpr(lower), to = getIndexExpr(upper);
  IndexExpr length = to;
  length.add(from, -1);
  if (from.isExact() && to.isExact() && length.isConstant() &&
      length.constant <= step)
    form = form.substitute([&](Value value) -> std::optional<IndexExpr> {
      return value == iv ? std::optional(from) : std::nullopt;
    });
}

/// Returns the form of an index of `op`, in which loops with at most one
/// iteration do not occur.
static IndexExpr getOwnForm(Operation *op, Value index) {
  IndexExpr form = getIndexExpr(index);
  for (Operation *parent = op->getParentOp();
       parent && !form.isConstant() && !isa<KernelOp>(parent);
       parent = parent->getParentOp()) {
    if (auto loop = dyn_cast<scf::ForOp>(parent)) {
      std::optional<int64_t> step = getConstantIntValue(loop.getStep());
      if (step && *step > 0 && !loop.getUnsignedCmp())
        replaceIfSingle(form, loop.getInductionVar(), loop.getLowerBound(),
                        loop.getUpperBound(), *step);
      continue;
    }
    auto loop = dyn_cast<ParallelForOp>(parent);
    if (!loop || loop.isStructFor() || loop.getLevel())
      continue;
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      replaceIfSingle(form, iv, lower, upper, 1);
  }
  return form;
}

/// Returns those indices of an access that are sums of constants and integer
/// arguments.
static std::vector<runtime::FixedIndex>
getFixedIndices(Operation *op, ValueRange indices, const ArgumentSlots &slots) {
  std::vector<runtime::FixedIndex> found;
  for (auto [dimension, index] : llvm::enumerate(indices))
    if (auto fixed = evaluateOnLaunch(getOwnForm(op, index), dimension, slots))
      found.push_back(std::move(*fixed));
  return found;
}

//===----------------------------------------------------------------------===//
// Elements that a kernel certainly stores
//===----------------------------------------------------------------------===//

namespace {
/// A loop around a store: its induction variable, and its bounds in terms of
/// the launch's arguments.
struct LoopRange {
  Value iv;
  runtime::StoredBox::Range range;
  bool isUsed = false;
};
} // namespace

/// Returns the loops around a store, if the store is under loops only, and each
/// loop runs from a lower to an upper bound in steps of one; otherwise none.
static std::optional<SmallVector<LoopRange>>
findLoopRanges(Operation *store, const ArgumentSlots &slots) {
  SmallVector<LoopRange> ranges;
  auto add = [&](Value iv, Value lower, Value upper) {
    auto from = evaluateOnLaunch(getIndexExpr(lower), 0, slots);
    auto to = evaluateOnLaunch(getIndexExpr(upper), 0, slots);
    if (from && to)
      ranges.push_back({iv, {*from, *to}});
    return from && to;
  };
  Operation *parent = store->getParentOp();
  for (; !isa<KernelOp>(parent); parent = parent->getParentOp()) {
    if (auto loop = dyn_cast<scf::ForOp>(parent)) {
      if (!matchPattern(loop.getStep(), m_One()) || loop.getUnsignedCmp() ||
          !add(loop.getInductionVar(), loop.getLowerBound(),
               loop.getUpperBound()))
        return std::nullopt;
      continue;
    }
    auto loop = dyn_cast<ParallelForOp>(parent);
    if (!loop)
      return std::nullopt;
    if (std::optional<LoopBox> box = getConstantBox(loop)) {
      for (auto [iv, lower, upper] :
           llvm::zip(box->ivs(), box->lower, box->upper))
        ranges.push_back({iv, {{0, lower, {}}, {0, upper, {}}}});
      continue;
    }
    if (loop.isStructFor() || loop.getLevel())
      return std::nullopt;
    for (auto [iv, lower, upper] :
         llvm::zip(loop.getInductionVars(), loop.getLowerBounds(),
                   loop.getUpperBounds()))
      if (!add(iv, lower, upper))
        return std::nullopt;
  }
  return ranges;
}

static runtime::FixedIndex addTo(runtime::FixedIndex bound,
                                 const runtime::FixedIndex &offset) {
  bound.dimension = offset.dimension;
  bound.constant += offset.constant;
  bound.bits = std::min(bound.bits, offset.bits);
  bound.terms.insert(bound.terms.end(), offset.terms.begin(),
                     offset.terms.end());
  return bound;
}

/// Returns the elements that a store certainly reaches, whatever the fields
/// contain: each index is the index of a different loop plus sums of arguments,
/// or only such a sum.
static std::optional<runtime::StoredBox>
findStoredBox(Operation *store, ValueRange indices,
              const ArgumentSlots &slots) {
  auto loops = findLoopRanges(store, slots);
  if (!loops)
    return std::nullopt;
  runtime::StoredBox box;
  for (auto [dimension, index] : llvm::enumerate(indices)) {
    IndexExpr form = getIndexExpr(index);
    LoopRange *loop = nullptr;
    for (LoopRange &candidate : *loops) {
      int64_t factor = form.getCoefficient(candidate.iv);
      if (factor == 0)
        continue;
      if (loop || factor != 1 || candidate.isUsed)
        return std::nullopt;
      loop = &candidate;
      llvm::erase_if(form.terms, [&](auto &term) {
        return term.first.getValue() == candidate.iv;
      });
    }
    auto offset = evaluateOnLaunch(form, dimension, slots);
    if (!offset)
      return std::nullopt;
    if (!loop) {
      runtime::FixedIndex behind = *offset;
      ++behind.constant;
      box.ranges.push_back({*offset, behind});
      continue;
    }
    loop->isUsed = true;
    box.ranges.push_back(
        {addTo(loop->range.lower, *offset), addTo(loop->range.upper, *offset)});
  }
  for (const LoopRange &loop : *loops)
    if (!loop.isUsed)
      box.loops.push_back(loop.range);
  // The launch need not check loops that certainly have an iteration.
  llvm::erase_if(box.loops, [](const runtime::StoredBox::Range &loop) {
    return loop.lower.terms.empty() && loop.upper.terms.empty() &&
           loop.lower.constant < loop.upper.constant;
  });
  return box;
}

std::vector<std::vector<runtime::StoredBox>>
mlir::tai::findStoredBoxes(ModuleOp module, KernelOp kernel,
                           ArrayRef<NamedAccess> accesses) {
  ArgumentSlots slots = findIntegerArguments(module);
  using Boxes = std::vector<runtime::StoredBox>;
  // For each access, the boxes of elements that its stores reach; no value if
  // one of its stores has no box.
  std::vector<std::optional<Boxes>> found(accesses.size(), Boxes());
  auto add = [&](StringRef field, const std::vector<runtime::FixedIndex> &fixed,
                 std::optional<runtime::StoredBox> box) {
    for (auto [access, boxes] : llvm::zip(accesses, found)) {
      if (access.kind != runtime::AccessKind::Write || field != access.field ||
          !boxes)
        continue;
      // An access with one fixed index can stand for several stores with
      // further fixed indices, which were dropped (see mostPlaces).
      bool isPart = access.fixed.size() == 1 && fixed.size() > 1 &&
                    access.fixed.front() == fixed.front();
      if (access.fixed != fixed && !isPart)
        continue;
      if (box && !isPart)
        boxes->push_back(*box);
      else
        boxes.reset();
    }
  };
  for (Operation &root : *module.getBody()) {
    if (isa<KernelOp>(root) && &root != kernel)
      continue;
    root.walk([&](StoreOp store) {
      bool mayBeBox = isa<KernelOp>(root) && store.getComponents().empty();
      add(store.getField(), getFixedIndices(store, store.getIndices(), slots),
          mayBeBox ? findStoredBox(store, store.getIndices(), slots)
                   : std::nullopt);
    });
  }
  std::vector<Boxes> result;
  result.reserve(found.size());
  for (std::optional<Boxes> &boxes : found)
    result.push_back(boxes ? std::move(*boxes) : Boxes());
  return result;
}

std::vector<runtime::StoredBox>
mlir::tai::findStoredBoxes(KernelOp kernel, BlockArgument array) {
  ArgumentSlots slots;
  int64_t next = 0;
  for (BlockArgument argument : kernel.getArguments()) {
    if (argument.getType().isSignlessInteger() &&
        argument.getType().getIntOrFloatBitWidth() <= 64)
      slots[argument] = next;
    // In the slots, the extents of an array follow its pointer.
    for (Operation *user : argument.getUsers())
      if (auto dim = dyn_cast<memref::DimOp>(user))
        if (std::optional<int64_t> index = dim.getConstantIndex())
          slots[dim.getResult()] = next + 1 + *index;
    next += ::countSlots(argument.getType());
  }
  std::vector<runtime::StoredBox> boxes;
  for (Operation *user : array.getUsers())
    if (auto store = dyn_cast<memref::StoreOp>(user))
      if (auto box = findStoredBox(store, store.getIndices(), slots))
        boxes.push_back(std::move(*box));
  return boxes;
}

//===----------------------------------------------------------------------===//
// Accesses
//===----------------------------------------------------------------------===//

/// If a field is accessed at more places than this, only the first fixed index
/// of each place is kept: each launch examines all places.
static constexpr unsigned mostPlaces = 8;

std::vector<NamedAccess> mlir::tai::listAccesses(Operation *root) {
  using Kind = runtime::AccessKind;
  auto module = root->getParentOfType<ModuleOp>();
  DenseMap<Value, int64_t> slots =
      findIntegerArguments(module ? module : cast<ModuleOp>(root));
  std::vector<NamedAccess> list;
  llvm::StringMap<unsigned> places;
  Operation *current = nullptr;
  auto add = [&](FlatSymbolRefAttr field, Kind kind, ValueRange indices = {}) {
    NamedAccess access{field.getValue().str(), kind,
                       getFixedIndices(current, indices, slots)};
    if (llvm::is_contained(list, access))
      return;
    ++places[access.field];
    list.push_back(std::move(access));
  };
  // An op that has effects and names a field without describing its access may
  // do anything to it.
  auto addNamed = [&](Operation *op) {
    if (op->getNumRegions() != 0 || isa<SymbolOpInterface>(op) ||
        isMemoryEffectFree(op))
      return;
    for (NamedAttribute attribute : op->getAttrs())
      if (auto name = dyn_cast<FlatSymbolRefAttr>(attribute.getValue());
          name && lookupField(op, name)) {
        add(name, Kind::Read);
        add(name, Kind::Write);
      }
  };
  root->walk([&](Operation *op) {
    current = op;
    if (isa<ParallelForOp>(op))
      return;
    auto access = dyn_cast<FieldAccessOpInterface>(op);
    FlatSymbolRefAttr field = getNamedField(op);
    if (!field)
      return addNamed(op);
    bool isElement = access && access.isElementAccess();
    if (access && !access.writesField())
      return add(field, Kind::Read,
                 isElement ? access.getIndices() : ValueRange());
    if (access && !access.readsField())
      return add(field, Kind::Write,
                 isElement ? access.getIndices() : ValueRange());
    if (auto atomic = dyn_cast<AtomicOp>(op)) {
      bool isSum = atomic.getKind() == AtomicKind::Add ||
                   atomic.getKind() == AtomicKind::Sub;
      if (!isSum || !atomic.getOld().use_empty())
        add(field, Kind::Read, atomic.getIndices());
      return add(field, isSum ? Kind::Accumulate : Kind::Write,
                 atomic.getIndices());
    }
    // Any other operation that names a field may read and write all of it.
    add(field, Kind::Read);
    add(field, Kind::Write);
  });
  std::vector<NamedAccess> result;
  for (NamedAccess &access : list) {
    // A matrix of weights may be accessed element by element, with constant
    // indices.
    if (places[access.field] > mostPlaces && access.fixed.size() > 1)
      access.fixed.erase(access.fixed.begin() + 1, access.fixed.end());
    if (!llvm::is_contained(result, access))
      result.push_back(std::move(access));
  }
  return result;
}
