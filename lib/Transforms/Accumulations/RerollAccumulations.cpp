//===- RerollAccumulations.cpp - Rerolls unrolled sums --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The adjoint of a dense layer whose sum is unrolled has an iteration for each
// output, a single warp in a small network, which adds to the adjoints of all
// weights and inputs, one after another, while the other warps of a block are
// idle. These additions differ only in constant indices. Here they become
// iterations themselves:
//
//   parallel for (i) { g = f(i); a[i, 0] += g * x[0]; …; a[i, 99] += g * x[99]
//   }
//
// becomes
//
//   parallel for (m, i) { g = f(i); a[i, m] += g * x[m] }
//
// Common values are computed by each of them. Besides more threads, this
// reduces the size of the code: straight-line code is fetched once for each
// execution, and a GPU waits for each cache line of it. (With the unrolled
// additions distributed over warps instead, a layer of 108 inputs and 32
// outputs took 38,700 clocks on an H200, and 6,500 in one warp.)
//
// Iterations of one m fill whole warps, which then add to the same elements
// together. Terms of a sum are added one by one. The remaining additions are
// done by one additional m.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "mlir/Transforms/LoopInvariantCodeMotionUtils.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/FieldAddress.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "llvm/ADT/EquivalenceClasses.h"
#include <map>

namespace mlir::tai {
#define GEN_PASS_DEF_REROLLACCUMULATIONS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

constexpr int64_t kWarpSize = 32;
/// The minimal number of terms of a sum that is divided into single additions,
/// and of members of a series of similar additions.
constexpr size_t kMinMembers = 4;
/// The target number of iterations: the threads of a block that uses many
/// registers.
constexpr int64_t kThreads = 512;

namespace {
/// An operation of the body that adds: an update, or a branch or loop that
/// contains the listed updates.
struct Effect {
  Operation *op;
  SmallVector<AtomicOp> updates;
};

/// An addition to an element of a field, or one of the terms of such an
/// addition.
struct Addition {
  Operation *effect;
  Value term;
  bool isNegative = false;
  bool isAlone = true;
};

/// A hole in the model of a series: an operand that is a constant index, as its
/// op and operand number. The indices of several additions may differ there.
using Hole = std::pair<Operation *, unsigned>;

/// A series of additions that differ in constant indices alone. Each index
/// changes by a constant step from one member to the next.
struct Series {
  SmallVector<unsigned> members;
  /// The number of the member of the series whose operands `holes` are.
  unsigned model = 0;
  SmallVector<Hole> holes;
  SmallVector<int64_t> first, step;
};

/// Compares the expressions of additions, apart from constant indices.
class Shapes {
public:
  explicit Shapes(Block &body) : body(body) {}

  llvm::hash_code hash(const Addition &addition);
  /// True if `other` equals `model` apart from constant indices. `holes` gets
  /// these operands of `model`, and `values` the indices that `other` has in
  /// their place.
  bool match(const Addition &model, const Addition &other,
             SmallVectorImpl<Hole> &holes, SmallVectorImpl<int64_t> &values);

private:
  llvm::hash_code hashOp(Operation *op);
  llvm::hash_code hashOperand(OpOperand &operand);
  bool matchOps(Operation *model, Operation *other);
  bool matchOperands(OpOperand &model, OpOperand &other);

  Block &body;
  llvm::DenseMap<Operation *, llvm::hash_code> hashes;
  llvm::DenseMap<Operation *, Operation *> matched;
  SmallVectorImpl<Hole> *holes = nullptr;
  SmallVectorImpl<int64_t> *values = nullptr;
};

/// Turns the additions in the body of one loop into iterations.
class Spreading {
public:
  Spreading(LoopBox box, int64_t count) : box(std::move(box)), count(count) {}

  /// Chooses the additions that become iterations; false if the body stays
  /// unchanged.
  FailureOr<bool> plan(FieldTable &fields, size_t minAdditions);
  void rewrite();

private:
  FailureOr<bool> collect(FieldTable &fields);
  void uniteConflicts(llvm::EquivalenceClasses<unsigned> &united);
  void addTerms(Operation *effect);
  void findSeries();
  void shareIterations();
  void findSteps(ArrayRef<unsigned> alike, Shapes &shapes);
  void emitSeries(OpBuilder &builder, ArrayRef<Series *> group, Value m,
                  ValueRange indices);
  void emitRest(OpBuilder &builder, ValueRange indices);

  LoopBox box;
  int64_t count;
  std::vector<Effect> effects;
  /// The storage to which each update adds.
  llvm::DenseMap<Operation *, Attribute> places;
  std::vector<Addition> additions;
  std::vector<Series> series;
  /// Additions that belong to no series.
  SmallVector<unsigned> rest;
};
} // namespace

/// Appends the operations of `body` whose results `op` uses to `worklist`.
static void addOperands(Operation *op, Block &body,
                        SmallVectorImpl<Operation *> &worklist) {
  op->walk([&](Operation *nested) {
    for (Value operand : nested->getOperands()) {
      Operation *definition = operand.getDefiningOp();
      Operation *top =
          definition ? body.findAncestorOpInBlock(*definition) : nullptr;
      if (top && top != op)
        worklist.push_back(top);
    }
  });
}

using OpSet = llvm::SmallPtrSet<Operation *, 32>;

/// Adds to `needed` the operations on `worklist`, and all operations they
/// depend on.
static void addNeeded(SmallVector<Operation *> worklist, Block &body,
                      OpSet &needed) {
  while (!worklist.empty()) {
    Operation *op = worklist.pop_back_val();
    if (needed.insert(op).second)
      addOperands(op, body, worklist);
  }
}

//===----------------------------------------------------------------------===//
// Additions of one shape
//===----------------------------------------------------------------------===//

static bool isComponent(OpOperand &operand) {
  Operation *op = operand.getOwner();
  OperandRange components = {op->operand_end(), op->operand_end()};
  if (auto load = dyn_cast<LoadOp>(op))
    components = load.getComponents();
  else if (auto update = dyn_cast<AtomicOp>(op))
    components = update.getComponents();
  return !components.empty() &&
         operand.getOperandNumber() >= components.getBeginOperandIndex();
}

/// Returns a constant index that may differ between the members of a series.
/// Component indices may not: they stay constants, as addresses require.
static std::optional<int64_t> getOpenIndex(OpOperand &operand) {
  if (!operand.get().getType().isIndex() || isComponent(operand))
    return std::nullopt;
  return getConstantIntValue(operand.get());
}

llvm::hash_code Shapes::hashOperand(OpOperand &operand) {
  if (getOpenIndex(operand))
    return llvm::hash_value(1);
  Operation *definition = operand.get().getDefiningOp();
  if (!definition || definition->getBlock() != &body)
    return llvm::hash_value(operand.get().getAsOpaquePointer());
  return llvm::hash_combine(cast<OpResult>(operand.get()).getResultNumber(),
                            hashOp(definition));
}

llvm::hash_code Shapes::hashOp(Operation *op) {
  if (auto found = hashes.find(op); found != hashes.end())
    return found->second;
  llvm::hash_code hash = llvm::hash_combine(
      op->getName().getAsOpaquePointer(),
      op->getAttrDictionary().getAsOpaquePointer(), op->getNumRegions());
  for (OpOperand &operand : op->getOpOperands())
    hash = llvm::hash_combine(hash, hashOperand(operand));
  return hashes[op] = hash;
}

llvm::hash_code Shapes::hash(const Addition &addition) {
  if (!addition.term)
    return hashOp(addition.effect);
  Operation *definition = addition.term.getDefiningOp();
  return llvm::hash_combine(addition.effect, addition.isNegative,
                            definition && definition->getBlock() == &body
                                ? hashOp(definition)
                                : llvm::hash_value(0));
}

bool Shapes::matchOperands(OpOperand &model, OpOperand &other) {
  std::optional<int64_t> open = getOpenIndex(model),
                         index = getOpenIndex(other);
  if (open || index) {
    if (!open || !index)
      return false;
    holes->push_back({model.getOwner(), model.getOperandNumber()});
    values->push_back(*index);
    return true;
  }
  auto a = dyn_cast<OpResult>(model.get()), b = dyn_cast<OpResult>(other.get());
  if (!a || !b || a.getOwner()->getBlock() != &body)
    return model.get() == other.get();
  return b.getOwner()->getBlock() == &body &&
         a.getResultNumber() == b.getResultNumber() &&
         matchOps(a.getOwner(), b.getOwner());
}

/// Operands that `model` and `other` share are compared as well, so that all
/// members of a series have the same holes.
bool Shapes::matchOps(Operation *model, Operation *other) {
  auto [found, isNew] = matched.try_emplace(model, other);
  if (!isNew)
    return found->second == other;
  if (model->getNumRegions() != 0 || model->getName() != other->getName() ||
      model->getAttrDictionary() != other->getAttrDictionary() ||
      model->getResultTypes() != other->getResultTypes() ||
      model->getNumOperands() != other->getNumOperands())
    return false;
  for (auto [a, b] :
       llvm::zip_equal(model->getOpOperands(), other->getOpOperands()))
    if (!matchOperands(a, b))
      return false;
  return true;
}

bool Shapes::match(const Addition &model, const Addition &other,
                   SmallVectorImpl<Hole> &holes,
                   SmallVectorImpl<int64_t> &values) {
  matched.clear();
  this->holes = &holes;
  this->values = &values;
  if (!model.term || !other.term)
    return !model.term && !other.term && matchOps(model.effect, other.effect);
  if (model.effect != other.effect || model.isNegative != other.isNegative)
    return false;
  Operation *a = model.term.getDefiningOp(), *b = other.term.getDefiningOp();
  bool isComputed = a && b && a->getBlock() == &body && b->getBlock() == &body;
  return isComputed && matchOps(a, b);
}

//===----------------------------------------------------------------------===//
// Additions that can become iterations
//===----------------------------------------------------------------------===//

FailureOr<bool> Spreading::collect(FieldTable &fields) {
  llvm::SmallDenseSet<Attribute> read, added;
  bool isSupported = true;
  for (Operation &op : box.body().without_terminator()) {
    Effect effect{&op, {}};
    WalkResult result = op.walk([&](Operation *nested) {
      if (isa<LoadOp, AtomicOp>(nested)) {
        FailureOr<const FieldInfo *> field =
            fields.lookup(nested, getNamedField(nested));
        if (failed(field))
          return WalkResult::interrupt();
        Attribute place = (*field)->scope;
        // A body that updates a field below a sparse level is not supported,
        // because the update may have to make its cell active first.
        isSupported &= (*field)->sparse.empty();
        if (auto update = dyn_cast<AtomicOp>(nested)) {
          isSupported &= update.getOld().use_empty() &&
                         llvm::is_contained({AtomicKind::Add, AtomicKind::Sub},
                                            update.getKind());
          effect.updates.push_back(update);
          places[update] = place;
          added.insert(place);
        } else {
          read.insert(place);
        }
      } else if (nested->getNumRegions() != 0) {
        isSupported &= isa<scf::IfOp, scf::ForOp>(nested);
      } else {
        // Array arguments are not fields; a body that writes to one is not
        // supported.
        isSupported &= isPure(nested) || isa<memref::LoadOp>(nested);
      }
      return WalkResult::advance();
    });
    if (result.wasInterrupted())
      return failure();
    if (effect.updates.empty())
      continue;
    // An op with a result is not supported: a user of the result would repeat
    // the op, and with it the updates.
    isSupported &= isa<AtomicOp>(op) || op.getNumResults() == 0;
    effects.push_back(std::move(effect));
  }
  return isSupported && llvm::none_of(added, [&](Attribute place) {
           return read.contains(place);
         });
}

/// Unites sets of effects whose updates may reach the same element, unless all
/// are atomic. The effects of a set are executed by one thread.
void Spreading::uniteConflicts(llvm::EquivalenceClasses<unsigned> &united) {
  llvm::MapVector<Attribute, SmallVector<std::pair<unsigned, AtomicOp>>>
      byPlace;
  for (auto [number, effect] : llvm::enumerate(effects)) {
    united.insert(number);
    for (AtomicOp update : effect.updates)
      byPlace[places[update]].push_back({number, update});
  }
  auto mayAlias = [](AtomicOp a, AtomicOp b) {
    if (a.getField() != b.getField())
      return true;
    if (areProvablyDistinct(a.getIndices(), b.getIndices()))
      return false;
    return a.getComponents().size() != b.getComponents().size() ||
           !areProvablyDistinct(a.getComponents(), b.getComponents());
  };
  for (auto &[place, updates] : byPlace)
    for (size_t i = 0; i < updates.size(); ++i)
      for (size_t j = i + 1; j < updates.size(); ++j) {
        auto [first, a] = updates[i];
        auto [second, b] = updates[j];
        if ((a.getExclusive() || b.getExclusive()) && first != second &&
            mayAlias(a, b))
          united.unionSets(first, second);
      }
}

/// Splits an update by a sum, if the sum has no other use, into its terms.
void Spreading::addTerms(Operation *effect) {
  auto update = dyn_cast<AtomicOp>(effect);
  SmallVector<Addition> terms;
  if (update && !update.getExclusive() &&
      isa<FloatType>(update.getValue().getType())) {
    SmallVector<std::pair<Value, bool>> worklist = {{update.getValue(), false}};
    while (!worklist.empty()) {
      auto [value, isNegative] = worklist.pop_back_val();
      Operation *op = value.getDefiningOp();
      bool isInner = op && op->getBlock() == &box.body() && value.hasOneUse();
      if (isInner && isa<arith::AddFOp, arith::SubFOp>(op)) {
        worklist.push_back({op->getOperand(0), isNegative});
        worklist.push_back(
            {op->getOperand(1), isNegative != isa<arith::SubFOp>(op)});
      } else if (isInner && isa<arith::NegFOp>(op)) {
        worklist.push_back({op->getOperand(0), !isNegative});
      } else {
        terms.push_back({effect, value, isNegative});
      }
    }
  }
  if (terms.size() < kMinMembers)
    terms.assign(1, {effect, Value(), false});
  std::reverse(terms.begin(), terms.end());
  llvm::append_range(additions, terms);
}

/// Finds series among additions of one shape in program order: for each
/// addition that is left, the longest series that starts with it.
void Spreading::findSteps(ArrayRef<unsigned> alike, Shapes &shapes) {
  SmallVector<Hole> holes;
  std::vector<std::pair<unsigned, SmallVector<int64_t>>> points;
  std::map<SmallVector<int64_t>, size_t> byValues;
  const Addition &model = additions[alike.front()];
  for (unsigned number : alike) {
    SmallVector<Hole> where;
    SmallVector<int64_t> values;
    if (!shapes.match(model, additions[number], where, values) ||
        !byValues.try_emplace(values, points.size()).second) {
      rest.push_back(number);
      continue;
    }
    holes = where;
    points.push_back({number, values});
  }
  SmallVector<bool> isTaken(points.size());
  // The second member is one of the next few additions: a layer has few kinds
  // of inputs side by side.
  constexpr size_t farthest = 8;
  for (size_t i = 0; i < points.size(); ++i) {
    if (isTaken[i])
      continue;
    SmallVector<size_t> longest;
    SmallVector<int64_t> longestStep;
    for (size_t j = i + 1; j < points.size() && j <= i + farthest; ++j) {
      if (isTaken[j])
        continue;
      SmallVector<int64_t> step, next = points[j].second;
      for (auto [from, to] : llvm::zip_equal(points[i].second, next))
        step.push_back(to - from);
      SmallVector<size_t> run = {i};
      for (auto found = byValues.find(next);
           found != byValues.end() && !isTaken[found->second];
           found = byValues.find(next)) {
        run.push_back(found->second);
        for (auto [value, by] : llvm::zip_equal(next, step))
          value += by;
      }
      if (run.size() > longest.size()) {
        longest = std::move(run);
        longestStep = std::move(step);
      }
    }
    if (longest.size() < kMinMembers) {
      rest.push_back(points[i].first);
      continue;
    }
    Series found;
    for (size_t k : longest) {
      isTaken[k] = true;
      found.members.push_back(points[k].first);
    }
    found.model = found.members.front();
    found.first = points[i].second;
    found.step = longestStep;
    // `found.holes` are operands of the first addition of the shape; replace
    // them by operands of the model of this series.
    SmallVector<int64_t> own;
    const Addition &start = additions[found.model];
    shapes.match(start, start, found.holes, own);
    series.push_back(std::move(found));
  }
}

void Spreading::findSeries() {
  Shapes shapes(box.body());
  llvm::MapVector<size_t, SmallVector<unsigned>> byShape;
  for (auto [number, addition] : llvm::enumerate(additions)) {
    if (addition.isAlone)
      byShape[shapes.hash(addition)].push_back(number);
    else
      rest.push_back(number);
  }
  for (auto &[shape, alike] : byShape)
    findSteps(alike, shapes);
  llvm::sort(rest);
}

/// Gives each iteration several members, where there would be more iterations
/// than threads: the reads of these members overlap, and so do their additions.
void Spreading::shareIterations() {
  size_t longest = 0;
  for (const Series &one : series)
    longest = std::max(longest, one.members.size());
  int64_t warps = llvm::divideCeil(count, kWarpSize);
  auto share = static_cast<size_t>(llvm::divideCeil(
      static_cast<int64_t>(longest) * warps * kWarpSize, kThreads));
  if (share < 2)
    return;
  std::vector<Series> shared;
  for (const Series &one : series)
    for (size_t k = 0; k < std::min(share, one.members.size()); ++k) {
      Series part;
      part.model = one.model;
      for (size_t i = k; i < one.members.size(); i += share)
        part.members.push_back(one.members[i]);
      part.holes = one.holes;
      for (auto [first, step] : llvm::zip_equal(one.first, one.step)) {
        part.first.push_back(first + static_cast<int64_t>(k) * step);
        part.step.push_back(static_cast<int64_t>(share) * step);
      }
      shared.push_back(std::move(part));
    }
  series = std::move(shared);
}

FailureOr<bool> Spreading::plan(FieldTable &fields, size_t minAdditions) {
  FailureOr<bool> isSupported = collect(fields);
  if (failed(isSupported) || !*isSupported)
    return isSupported;
  llvm::EquivalenceClasses<unsigned> united;
  uniteConflicts(united);
  llvm::DenseMap<unsigned, unsigned> members;
  for (unsigned number = 0; number < effects.size(); ++number)
    ++members[united.getLeaderValue(number)];
  for (auto [number, effect] : llvm::enumerate(effects)) {
    if (members[united.getLeaderValue(number)] == 1)
      addTerms(effect.op);
    else
      additions.push_back({effect.op, Value(), false, /*isAlone=*/false});
  }
  if (additions.size() < minAdditions)
    return false;
  findSeries();
  shareIterations();
  return 2 * rest.size() <= additions.size();
}

//===----------------------------------------------------------------------===//
// The new loop
//===----------------------------------------------------------------------===//

static void emitAddition(OpBuilder &builder, const Addition &addition,
                         IRMapping &mapping) {
  if (addition.term) {
    auto update = cast<AtomicOp>(addition.effect);
    Value value = mapping.lookupOrDefault(addition.term);
    if (addition.isNegative)
      value = arith::NegFOp::create(builder, update.getLoc(), value);
    mapping.map(update.getValue(), value);
  }
  builder.clone(*addition.effect, mapping);
}

/// Emits the addition of member number `m` of each series in the group.
void Spreading::emitSeries(OpBuilder &builder, ArrayRef<Series *> group,
                           Value m, ValueRange indices) {
  std::map<std::pair<int64_t, int64_t>, Value> made;
  IndexMath math(builder, box.loop.getLoc());
  auto getIndex = [&](int64_t first, int64_t step) {
    Value &index = made[{first, step}];
    if (!index)
      index = step == 0 ? math.constant(first)
                        : math.add(math.mul(m, step), math.constant(first));
    return index;
  };
  for (Series *one : group)
    for (auto [first, step] : llvm::zip_equal(one->first, one->step))
      getIndex(first, step);
  auto setIndices = [&](const Series &one, Operation *op, Operation *clone) {
    for (size_t k = 0; k < one.holes.size(); ++k)
      if (one.holes[k].first == op)
        clone->setOperand(one.holes[k].second,
                          getIndex(one.first[k], one.step[k]));
  };
  // All reads are emitted before the additions, so that equal reads can be
  // merged.
  std::vector<IRMapping> mappings(group.size());
  for (auto [one, mapping] : llvm::zip_equal(group, mappings)) {
    const Addition &model = additions[one->model];
    mapping.map(box.body().getArguments(), indices);
    SmallVector<Operation *> worklist;
    addOperands(model.effect, box.body(), worklist);
    if (model.term) {
      Value sum = cast<AtomicOp>(model.effect).getValue();
      llvm::erase(worklist, sum.getDefiningOp());
      worklist.push_back(model.term.getDefiningOp());
    }
    OpSet needed;
    addNeeded(worklist, box.body(), needed);
    for (Operation &op : box.body().without_terminator())
      if (needed.contains(&op))
        setIndices(*one, &op, builder.clone(op, mapping));
  }
  for (auto [one, mapping] : llvm::zip_equal(group, mappings)) {
    const Addition &model = additions[one->model];
    emitAddition(builder, model, mapping);
    setIndices(*one, model.effect, &*std::prev(builder.getInsertionPoint()));
  }
}

void Spreading::emitRest(OpBuilder &builder, ValueRange indices) {
  SmallVector<Operation *> worklist;
  llvm::MapVector<Operation *, SmallVector<unsigned>> byEffect;
  for (unsigned number : rest) {
    const Addition &addition = additions[number];
    byEffect[addition.effect].push_back(number);
    if (addition.term && addition.term.getDefiningOp() &&
        addition.term.getDefiningOp()->getBlock() == &box.body())
      worklist.push_back(addition.term.getDefiningOp());
    SmallVector<Operation *> operands;
    addOperands(addition.effect, box.body(), operands);
    if (addition.term)
      llvm::erase(operands,
                  cast<AtomicOp>(addition.effect).getValue().getDefiningOp());
    llvm::append_range(worklist, operands);
  }
  OpSet needed;
  addNeeded(worklist, box.body(), needed);
  IRMapping mapping;
  mapping.map(box.body().getArguments(), indices);
  for (Operation &op : box.body().without_terminator()) {
    if (needed.contains(&op))
      builder.clone(op, mapping);
    if (auto *found = byEffect.find(&op); found != byEffect.end())
      for (unsigned number : found->second)
        emitAddition(builder, additions[number], mapping);
  }
}

void Spreading::rewrite() {
  ParallelForOp loop = box.loop;
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  // Group series by length, since series of one length share a branch.
  std::map<int64_t, SmallVector<Series *>, std::greater<>> byLength;
  for (Series &one : series)
    byLength[static_cast<int64_t>(one.members.size())].push_back(&one);
  int64_t longest = byLength.begin()->first;
  IndexMath outside(builder, loc);
  SmallVector<Value> from = {outside.constant(0)},
                     to = {outside.constant(longest + !rest.empty())};
  for (auto [lower, upper] : llvm::zip_equal(box.lower, box.upper)) {
    from.push_back(outside.constant(lower));
    to.push_back(outside.constant(upper));
  }
  int64_t padded = llvm::alignTo(count, kWarpSize);
  Value end = to.back();
  if (padded != count)
    to.back() = outside.constant(box.lower.back() + padded);
  auto spread = ParallelForOp::create(builder, loc, from, to);
  spread.copyNotesFrom(loop);

  SmallVector<Value> indices(spread.getInductionVars());
  Value m = indices.front();
  indices.erase(indices.begin());
  builder.setInsertionPointToStart(&spread.getBody().front());
  auto isBelow = [&](Value value, Value bound) -> Value {
    return arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::slt, value,
                                 bound);
  };
  if (padded != count) {
    auto guard = scf::IfOp::create(builder, loc, isBelow(indices.back(), end),
                                   /*withElseRegion=*/false);
    builder.setInsertionPointToStart(guard.thenBlock());
  }
  if (!rest.empty()) {
    IndexMath math(builder, loc);
    auto choice =
        scf::IfOp::create(builder, loc, isBelow(m, math.constant(longest)),
                          /*withElseRegion=*/true);
    builder.setInsertionPointToStart(choice.elseBlock());
    emitRest(builder, indices);
    builder.setInsertionPointToStart(choice.thenBlock());
  }
  for (auto &[length, group] : byLength) {
    if (length == longest) {
      emitSeries(builder, group, m, indices);
      continue;
    }
    IndexMath math(builder, loc);
    auto branch =
        scf::IfOp::create(builder, loc, isBelow(m, math.constant(length)),
                          /*withElseRegion=*/false);
    OpBuilder inside = OpBuilder::atBlockBegin(branch.thenBlock());
    emitSeries(inside, group, m, indices);
  }
  loop.erase();
}

namespace {
struct RerollAccumulations
    : tai::impl::RerollAccumulationsBase<RerollAccumulations> {
  using Base::Base;

  void runOnOperation() override {
    Operation *table = SymbolTable::getNearestSymbolTable(getOperation());
    if (!table)
      return;
    std::optional<FieldTable> fields;
    for (LoopBox &box : findConstantBoxes(getOperation())) {
      std::optional<int64_t> count = getNumIterations(box.loop);
      if (!count || *count == 0 || *count > maxIterations ||
          hasFixedBits(box.loop))
        continue;
      // Iterations fill whole warps: a loop of one dimension is padded, and
      // loops of more dimensions must have a multiple of the warp size.
      if (box.lower.size() > 1 && *count % kWarpSize != 0)
        continue;
      moveLoopInvariantCode(cast<LoopLikeOpInterface>(box.loop.getOperation()));
      if (!fields)
        fields.emplace(table);
      Spreading spreading(std::move(box), *count);
      FailureOr<bool> pays =
          spreading.plan(*fields, static_cast<size_t>(minAdditions));
      if (failed(pays))
        return signalPassFailure();
      if (*pays)
        spreading.rewrite();
    }
  }
};
} // namespace
