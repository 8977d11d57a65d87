//===- ShardPlan.cpp - How ranks share a loop -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ShardPlan.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Utils/StaticValueUtils.h"
#include "tai/Analysis/Index/IndexQueries.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Analysis/Reductions/ReductionPlan.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

bool tai::touchesShards(ParallelForOp loop) {
  return loop
      ->walk([](Operation *op) {
        return findSharding(op, getNamedField(op)) ? WalkResult::interrupt()
                                                   : WalkResult::advance();
      })
      .wasInterrupted();
}

namespace {
/// The difference between a row that an access reaches and an index of the
/// loop, a closed range.
struct Offset {
  int64_t low = 0, high = 0;

  bool isExact() const { return low == high; }
};

/// An access to a sharded field. If `isFree`, data choose the row, and the
/// offset is relative to the rows of the rank.
struct RowAccess {
  FieldAccessOpInterface op;
  Offset offset;
  FixedIndices at;
  bool isFree = false;
};

/// The halo of loops in which data may choose all rows.
constexpr int64_t kAllRows = -1;

/// Offsets beyond this number are no halos of any field.
constexpr int64_t kFarthest = int64_t(1) << 30;

/// The reason why a loop cannot be planned. An error, if there is one, takes
/// it.
class Refusal {
public:
  explicit Refusal(std::optional<InFlightDiagnostic> error)
      : error(std::move(error)) {}

  template <typename Part> Refusal &operator<<(Part &&part) {
    if (error)
      *error << std::forward<Part>(part);
    return *this;
  }
  operator LogicalResult() const { return failure(); }

private:
  std::optional<InFlightDiagnostic> error;
};

class Planner {
public:
  explicit Planner(ParallelForOp loop, bool reports)
      : loop(loop), reports(reports) {}

  FailureOr<ShardPlan> run();

private:
  LogicalResult checkForm();
  LogicalResult checkOps();
  LogicalResult findAccesses();
  LogicalResult addFree(FieldAccessOpInterface access,
                        const Sharding &sharding);
  LogicalResult findDimension(FieldAccessOpInterface access,
                              const Sharding &sharding);
  std::optional<Offset> getOffset(Value index, unsigned dimension);
  std::optional<Offset> getOffsetOfPieces(Value index, Value iv,
                                          unsigned dimension);
  FixedIndices getFixed(FieldAccessOpInterface access,
                        std::optional<unsigned> sharded);
  LogicalResult chooseOwner();
  LogicalResult planReads();
  LogicalResult planAdditions();
  LogicalResult checkReadsOfAdditions();
  LogicalResult planCopies();
  LogicalResult planAllRows();
  void planWhole();
  void planStale();
  void add(std::vector<PlannedExchange> &list, RowAccess access,
           ExchangeKind kind);
  LogicalResult checkSummable(AtomicOp op, StringRef memory) const;
  LogicalResult checkRowAddition(AtomicOp op) const;
  void add(std::vector<PlannedExchange> &list, PlannedExchange exchange);
  bool areApart(const FixedIndices &a, const FixedIndices &b) const;
  Refusal refuse(Operation *op) const { return refuse(op->getLoc()); }
  Refusal refuse(Location loc) const {
    if (!reports)
      return Refusal(std::nullopt);
    return Refusal(emitError(loc) << "cannot run on several ranks: ");
  }
  bool isOutside(Value value) const {
    return !loop->isAncestor(value.getParentRegion()->getParentOp());
  }

  ParallelForOp loop;
  /// True if refusals are errors.
  bool reports;
  IndexBuilder builder;
  ShardPlan plan;
  /// The rows beyond those of a rank that data may choose, or `kAllRows`.
  std::optional<int64_t> halo;
  bool hasDimension = false;
  std::vector<RowAccess> rows;
  SmallVector<FieldAccessOpInterface> copies;
};
} // namespace

LogicalResult Planner::checkForm() {
  if (auto given = loop->getAttrOfType<IntegerAttr>(kHaloAttrName))
    halo = given.getInt();
  if (loop.getSerialize())
    return refuse(loop) << "the loop accesses a sharded field, and its "
                           "iterations run one after another";
  if (!loop.isStructFor())
    return success();
  FailureOr<FieldLayout> layout =
      getFieldLayout(lookupField(loop, loop.getFieldAttr()));
  if (failed(layout))
    return failure();
  if (layout->path.getFirstSparse())
    return refuse(loop) << "the loop visits the active cells of '"
                        << loop.getFieldAttr()
                        << "', and accesses a sharded field";
  if (loop.getLevel())
    return refuse(loop) << "the loop visits the cells of a level, and "
                           "accesses a sharded field";
  std::optional<Sharding> sharding = getSharding(*layout);
  if (!sharding)
    return success();
  plan.sharding = *sharding;
  plan.dimension = sharding->dimension;
  plan.offset = -sharding->first;
  hasDimension = true;
  return success();
}

/// True if the kernel allocates the array.
static bool isOfKernel(Value array) {
  return isa_and_nonnull<memref::AllocOp, memref::AllocaOp>(
      array.getDefiningOp());
}

LogicalResult Planner::checkOps() {
  WalkResult result = loop->walk([&](Operation *op) {
    if (isa<RandomOp>(op)) {
      refuse(op) << "random numbers depend on the number of the iteration, "
                    "which a rank does not know";
      return WalkResult::interrupt();
    }
    Value array;
    if (auto store = dyn_cast<memref::StoreOp>(op))
      array = store.getMemref();
    else if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op))
      array = atomic.getMemref();
    if (array && isOutside(array) && isOfKernel(array)) {
      plan.isWhole = true;
      plan.why = "the loop fills memory of the kernel for other loops";
    } else if (array && isOutside(array)) {
      refuse(op)
          << "the loop accesses a sharded field, and writes to an array, "
             "of which each rank has a copy";
      return WalkResult::interrupt();
    }
    return WalkResult::advance();
  });
  return failure(result.wasInterrupted());
}

/// Sets the dimension of the loop whose index selects rows.
LogicalResult Planner::findDimension(FieldAccessOpInterface access,
                                     const Sharding &sharding) {
  if (!hasDimension) {
    Value index = access.getIndices()[sharding.dimension];
    IndexExpr expr = builder.get(index);
    unsigned number = 0;
    while (number < loop.getInductionVars().size() &&
           !expr.mentions(loop.getInductionVars()[number]))
      ++number;
    if (number == loop.getInductionVars().size())
      return refuse(access) << "the index of '" << access.getFieldAttr()
                            << "' along its sharded axis is not an index of "
                               "the loop plus a constant";
    plan.dimension = number;
    plan.sharding = sharding;
    hasDimension = true;
  }
  if (plan.sharding.ranks == sharding.ranks &&
      plan.sharding.block == sharding.block)
    return success();
  return refuse(access) << "the loop accesses fields of " << plan.sharding.block
                        << " and of " << sharding.block
                        << " rows for each rank";
}

/// The offset of `index` from the index of the loop along `dimension`.
std::optional<Offset> Planner::getOffset(Value index, unsigned dimension) {
  Value iv = loop.getInductionVars()[dimension];
  IndexExpr difference = builder.get(index);
  if (difference.getCoefficient(iv) == 1)
    difference.add(IndexExpr(iv), -1);
  bool isPlain = difference.width >= 32 &&
                 llvm::none_of(loop.getInductionVars(), [&](Value other) {
                   return difference.mentions(other);
                 });
  if (!isPlain)
    return getOffsetOfPieces(index, iv, dimension);
  if (builder.get(index).getCoefficient(iv) != 1)
    return std::nullopt;
  if (difference.isConstant()) {
    // Narrower arithmetic wraps, but an index that wrapped is not in the field.
    int64_t offset =
        difference.width == 64
            ? difference.constant
            : llvm::SignExtend64(difference.constant, difference.width);
    return Offset{offset, offset};
  }
  IndexRange range = builder.getRange(difference);
  if (range.low < -kFarthest || range.high > kFarthest)
    return std::nullopt;
  return Offset{int64_t(range.low), int64_t(range.high)};
}

/// The offset of an index that is linear on parts of the range of the loop, as
/// `max(i - 1, 0)` is.
std::optional<Offset> Planner::getOffsetOfPieces(Value index, Value iv,
                                                 unsigned dimension) {
  std::optional<int64_t> lower, upper;
  if (loop.isStructFor()) {
    FailureOr<FieldLayout> layout =
        getFieldLayout(lookupField(loop, loop.getFieldAttr()));
    lower = layout->offset[dimension];
    upper = *lower + layout->shape[dimension];
  } else {
    lower = getConstantIntValue(loop.getLowerBounds()[dimension]);
    upper = getConstantIntValue(loop.getUpperBounds()[dimension]);
  }
  if (!lower || !upper || *lower >= *upper)
    return std::nullopt;
  std::optional<SmallVector<IndexPiece>> pieces =
      getIndexPieces(index, iv, *lower, *upper);
  if (!pieces || pieces->empty())
    return std::nullopt;
  Offset offset{kFarthest, -kFarthest};
  for (const IndexPiece &piece : *pieces)
    for (int64_t i : {piece.lower, piece.upper - 1}) {
      offset.low = std::min(offset.low, piece.at(i) - i);
      offset.high = std::max(offset.high, piece.at(i) - i);
    }
  if (offset.low < -kFarthest || offset.high > kFarthest)
    return std::nullopt;
  return offset;
}

/// True if `value` can be computed in front of the loop.
static bool isHoistable(Value value, ParallelForOp loop) {
  if (!loop->isAncestor(value.getParentRegion()->getParentOp()))
    return true;
  Operation *op = value.getDefiningOp();
  return op && op->getNumRegions() == 0 && isPure(op) &&
         llvm::all_of(op->getOperands(), [&](Value operand) {
           return isHoistable(operand, loop);
         });
}

FixedIndices Planner::getFixed(FieldAccessOpInterface access,
                               std::optional<unsigned> sharded) {
  FixedIndices fixed;
  for (auto [dim, index] : llvm::enumerate(access.getIndices())) {
    if (sharded == dim || !isHoistable(index, loop))
      continue;
    fixed.dims.push_back(dim);
    fixed.values.push_back(index);
    fixed.exprs.push_back(builder.get(index));
  }
  return fixed;
}

/// Adds an access to a row that data choose, in a loop whose program promises
/// that the row is one of the rank's own or of its halos.
LogicalResult Planner::addFree(FieldAccessOpInterface access,
                               const Sharding &sharding) {
  bool isStore = isa<StoreOp>(access);
  if (isStore && *halo != 0)
    return refuse(access) << "it stores to a row of '" << access.getFieldAttr()
                          << "' that data choose, which is possible with "
                             "halo=0, for rows of the rank itself";
  if (*halo > sharding.block)
    return refuse(access) << "the loop has halo=" << *halo
                          << ", and a rank has " << sharding.block
                          << " rows of '" << access.getFieldAttr() << "'";
  int64_t rows = std::max<int64_t>(*halo, 0);
  this->rows.push_back({access,
                        {-rows, rows},
                        getFixed(access, sharding.dimension),
                        /*isFree=*/true});
  if (*halo >= 0)
    plan.checks.push_back({access, sharding, *halo});
  return success();
}

LogicalResult Planner::findAccesses() {
  WalkResult result = loop->walk([&](Operation *op) {
    auto access = dyn_cast<FieldAccessOpInterface>(op);
    if (!access)
      return WalkResult::advance();
    std::optional<Sharding> sharding = findSharding(op, access.getFieldAttr());
    if (!sharding) {
      copies.push_back(access);
      return WalkResult::advance();
    }
    if (!isa<LoadOp, StoreOp, AtomicOp>(op)) {
      refuse(op) << "it asks for cells of '" << access.getFieldAttr()
                 << "', which is sharded";
      return WalkResult::interrupt();
    }
    Value index = access.getIndices()[sharding->dimension];
    IndexExpr expr = builder.get(index);
    bool isOfLoop = llvm::any_of(loop.getInductionVars(),
                                 [&](Value iv) { return expr.mentions(iv); });
    if (halo && !isOfLoop)
      return failed(addFree(access, *sharding)) ? WalkResult::interrupt()
                                                : WalkResult::advance();
    if (failed(findDimension(access, *sharding)))
      return WalkResult::interrupt();
    std::optional<Offset> offset = getOffset(index, plan.dimension);
    if (!offset && halo)
      return failed(addFree(access, *sharding)) ? WalkResult::interrupt()
                                                : WalkResult::advance();
    if (!offset) {
      refuse(op) << "the index of '" << access.getFieldAttr()
                 << "' along its sharded axis is not the index of the loop "
                    "plus a constant";
      return WalkResult::interrupt();
    }
    offset->low -= sharding->first;
    offset->high -= sharding->first;
    rows.push_back({access, *offset, getFixed(access, sharding->dimension)});
    return WalkResult::advance();
  });
  return failure(result.wasInterrupted());
}

/// Chooses which row decides the owner of an iteration, and makes offsets
/// relative to that row.
LogicalResult Planner::chooseOwner() {
  const RowAccess *chosen = nullptr;
  auto choose = [&](auto isWanted) {
    for (const RowAccess &access : rows)
      if (!chosen && !access.isFree && access.offset.isExact() &&
          isWanted(access.op))
        chosen = &access;
  };
  choose([](Operation *op) { return isa<StoreOp>(op); });
  choose([](Operation *op) { return isa<AtomicOp>(op); });
  choose([](Operation *) { return true; });
  if (chosen)
    plan.offset = chosen->offset.low;
  else if (!rows.empty() && (!loop.isStructFor() || !hasDimension))
    return refuse(rows.front().op)
           << "no access of the loop is to a sharded field at the index of the "
              "loop plus a constant";
  for (RowAccess &access : rows) {
    if (access.isFree)
      continue;
    Offset &offset = access.offset;
    offset.low -= plan.offset;
    offset.high -= plan.offset;
    StringAttr field = access.op.getFieldAttr().getAttr();
    if (isa<StoreOp>(access.op) && (offset.low != 0 || offset.high != 0))
      return refuse(access.op)
             << "it stores to a row of '" << access.op.getFieldAttr()
             << "' other than the row that decides which rank runs the "
                "iteration";
    if (offset.low < -plan.sharding.block || offset.high > plan.sharding.block)
      return refuse(access.op)
             << "it reaches " << std::max(-offset.low, offset.high)
             << " rows of '" << field.getValue()
             << "' beyond its own, and a rank has " << plan.sharding.block;
  }
  return success();
}

/// Adds an exchange, or widens one of the same elements.
void Planner::add(std::vector<PlannedExchange> &list,
                  PlannedExchange exchange) {
  for (PlannedExchange &other : list)
    if (other.kind == exchange.kind && other.field == exchange.field &&
        other.at == exchange.at) {
      other.before = std::max(other.before, exchange.before);
      other.after = std::max(other.after, exchange.after);
      return;
    }
  list.push_back(std::move(exchange));
}

/// True if two accesses are to one field.
static bool sharesField(RowAccess first, RowAccess second) {
  return first.op.getFieldAttr() == second.op.getFieldAttr();
}

LogicalResult Planner::planReads() {
  for (RowAccess &access : rows) {
    const Offset &offset = access.offset;
    if (!isa<LoadOp>(access.op) || (offset.low >= 0 && offset.high <= 0))
      continue;
    // Iterations of one thread would read what earlier ones have stored.
    for (const RowAccess &store : rows)
      if (isa<StoreOp>(store.op) && sharesField(store, access) &&
          !areApart(store.at, access.at))
        return refuse(access.op)
               << "it reads a row of '" << access.op.getFieldAttr()
               << "' that another iteration of the loop stores";
    add(plan.before,
        {ExchangeKind::Fetch, access.op.getFieldAttr(), access.op.getLoc(),
         access.at, std::max<int64_t>(0, -offset.low),
         std::max<int64_t>(0, offset.high)});
  }
  return success();
}

/// Reports an update whose contributions cannot be summed over ranks.
LogicalResult Planner::checkSummable(AtomicOp op, StringRef memory) const {
  if (!op.getOld().use_empty())
    return refuse(op) << "it reads the old value of an element of '"
                      << op.getField() << "', to which other ranks add, too";
  Type element = getElementTypeOrSelf(op.getValue().getType());
  if (element.isF16() || element.isBF16())
    return refuse(op) << "it combines numbers of " << element << " with "
                      << memory;
  return success();
}

/// Reports an update of rows of other ranks that is no addition, or whose
/// contributions cannot be summed.
LogicalResult Planner::checkRowAddition(AtomicOp op) const {
  if (op.getKind() != AtomicKind::Add && op.getKind() != AtomicKind::Sub)
    return refuse(op) << "it combines a value with a row of another rank, and "
                         "is no addition";
  return checkSummable(op, "rows of other ranks");
}

LogicalResult Planner::planAdditions() {
  for (RowAccess &access : rows) {
    auto atomic = dyn_cast<AtomicOp>(access.op.getOperation());
    const Offset &offset = access.offset;
    if (!atomic || (offset.low >= 0 && offset.high <= 0))
      continue;
    if (failed(checkRowAddition(atomic)))
      return failure();
    PlannedExchange collect{ExchangeKind::Collect,
                            atomic.getFieldAttr(),
                            atomic.getLoc(),
                            access.at,
                            std::max<int64_t>(0, -offset.low),
                            std::max<int64_t>(0, offset.high)};
    add(plan.after, std::move(collect));
  }
  if (failed(checkReadsOfAdditions()))
    return failure();
  for (const PlannedExchange &collect : plan.after) {
    PlannedExchange clear = collect;
    clear.kind = ExchangeKind::Clear;
    plan.before.push_back(std::move(clear));
  }
  return success();
}

/// True if the elements with these indices certainly differ.
bool Planner::areApart(const FixedIndices &a, const FixedIndices &b) const {
  for (auto [dim, expr] : llvm::zip(a.dims, a.exprs))
    for (auto [otherDim, otherExpr] : llvm::zip(b.dims, b.exprs))
      if (dim == otherDim && areDistinct(expr, otherExpr))
        return true;
  return false;
}

/// Reports halos that are both read and added to, or added to in two exchanges:
/// clearing them would lose values.
LogicalResult Planner::checkReadsOfAdditions() {
  for (auto [number, collect] : llvm::enumerate(plan.after)) {
    for (const PlannedExchange &read : plan.before)
      if (read.field == collect.field && !areApart(read.at, collect.at))
        return refuse(collect.loc)
               << "the loop adds to rows of '" << collect.field
               << "' of another rank, and reads such rows";
    for (const PlannedExchange &other :
         ArrayRef(plan.after).drop_front(number + 1))
      if (other.field == collect.field && !areApart(other.at, collect.at))
        return refuse(other.loc)
               << "the loop adds to rows of '" << collect.field
               << "' of another rank at several indices along other axes";
  }
  return success();
}

/// Plans updates of fields of which each rank has a copy.
LogicalResult Planner::planCopies() {
  std::vector<PlannedExchange> totals;
  for (FieldAccessOpInterface access : copies) {
    auto atomic = dyn_cast<AtomicOp>(access.getOperation());
    if (!atomic) {
      if (!access.writesField())
        continue;
      return refuse(access) << "the loop accesses a sharded field, and writes "
                               "to '"
                            << access.getFieldAttr()
                            << "', of which each rank has a copy; atomic "
                               "additions, minima and maxima are possible";
    }
    FailureOr<FieldLayout> layout =
        getFieldLayout(lookupField(atomic, atomic.getFieldAttr()));
    if (failed(layout) || layout->path.getFirstSparse())
      return refuse(access)
             << "the loop accesses a sharded field, and "
                "updates '"
             << access.getFieldAttr() << "', which is below a sparse level";
    if (failed(checkSummable(atomic, "those of other ranks")))
      return failure();
    ExchangeKind kind;
    switch (atomic.getKind()) {
    case AtomicKind::Add:
    case AtomicKind::Sub:
      kind = ExchangeKind::Sum;
      break;
    case AtomicKind::Min:
      kind = ExchangeKind::Min;
      break;
    case AtomicKind::Max:
      kind = ExchangeKind::Max;
      break;
    default:
      return refuse(atomic)
             << "ranks combine their copies of '" << atomic.getFieldAttr()
             << "' by sums, minima and maxima alone";
    }
    add(totals, {kind, atomic.getFieldAttr(), atomic.getLoc(),
                 getFixed(access, std::nullopt)});
  }
  for (auto [number, total] : llvm::enumerate(totals)) {
    for (FieldAccessOpInterface access : copies)
      if (!isa<AtomicOp>(access) && access.getFieldAttr() == total.field &&
          !areApart(getFixed(access, std::nullopt), total.at))
        return refuse(access) << "the loop reads '" << total.field
                              << "', and combines it over ranks";
    for (const PlannedExchange &other : ArrayRef(totals).drop_front(number + 1))
      if (other.field == total.field && !areApart(other.at, total.at))
        return refuse(other.loc)
               << "the loop updates '" << total.field << "' in several ways";
    if (total.kind == ExchangeKind::Sum) {
      PlannedExchange open = total;
      open.kind = ExchangeKind::Open;
      plan.before.push_back(std::move(open));
    }
    plan.after.push_back(total);
  }
  return success();
}

void Planner::add(std::vector<PlannedExchange> &list, RowAccess access,
                  ExchangeKind kind) {
  add(list, {kind, access.op.getFieldAttr(), access.op.getLoc(), access.at});
}

/// Plans accesses to rows that data choose among all rows.
LogicalResult Planner::planAllRows() {
  for (RowAccess &access : rows) {
    if (!access.isFree || halo != kAllRows)
      continue;
    auto atomic = dyn_cast<AtomicOp>(access.op.getOperation());
    for (const RowAccess &other : rows)
      if (sharesField(access, other) && bool(atomic) != isa<AtomicOp>(other.op))
        return refuse(access.op)
               << "the loop reads and changes rows of '"
               << access.op.getFieldAttr() << "' that data choose";
    if (!atomic) {
      add(plan.before, access, ExchangeKind::Gather);
      continue;
    }
    if (failed(checkRowAddition(atomic)))
      return failure();
    add(plan.before, access, ExchangeKind::Open);
    add(plan.after, access, ExchangeKind::Sum);
  }
  return success();
}

/// Lets each rank run all iterations if the bits of a sum depend on their
/// order, or if later loops read memory of the kernel that all iterations fill.
void Planner::planWhole() {
  bool hasSum = llvm::any_of(plan.after, [&](const PlannedExchange &exchange) {
    if (exchange.kind != ExchangeKind::Sum &&
        exchange.kind != ExchangeKind::Collect)
      return false;
    FieldOp field = lookupField(loop, exchange.field);
    return isa<FloatType>(getElementTypeOrSelf(field.getType()));
  });
  if (hasSum && hasFixedBits(loop)) {
    plan.isWhole = true;
    plan.why = "the order of a sum is to be that of one process";
  }
  if (!plan.isWhole)
    return;
  plan.checks.clear();
  plan.before.clear();
  plan.after.clear();
  for (const RowAccess &access : rows)
    if (!isa<StoreOp>(access.op))
      add(plan.before, access, ExchangeKind::Gather);
}

/// Notes which rows the loop changes.
void Planner::planStale() {
  for (const RowAccess &access : rows)
    if (!isa<LoadOp>(access.op))
      add(plan.after, access, ExchangeKind::Stale);
}

FailureOr<ShardPlan> Planner::run() {
  if (failed(checkForm()) || failed(checkOps()) || failed(findAccesses()) ||
      failed(chooseOwner()) || failed(planReads()) || failed(planAdditions()) ||
      failed(planCopies()) || failed(planAllRows()))
    return failure();
  planWhole();
  planStale();
  return std::move(plan);
}

FailureOr<ShardPlan> tai::planShards(ParallelForOp loop, bool reports) {
  return Planner(loop, reports).run();
}
