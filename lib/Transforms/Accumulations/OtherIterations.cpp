//===- OtherIterations.cpp - Reads of other iterations' writes ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `x[i] = 2 * x[i - 1]`: an iteration reads an element that another one writes.
// Two accesses certainly do not conflict (mayMeet), or certainly do (findRace,
// findExample), or are checked at run time:
//
//   x[i] = x[i - k], i < n      the launch is refused if k and n say so
//   x[i] = x[p[i]]              the loop checks its accesses with `debug`
//
// Two arguments may be the same array, which is checked at the launch as well.
//
//===----------------------------------------------------------------------===//

#include "OtherIterations.h"
#include "IterationShadow.h"
#include "mlir/Analysis/SliceAnalysis.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/IR/Matchers.h"
#include "tai/ABI/Abi.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Index/IndexForms.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "llvm/ADT/MapVector.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Pairs
//===----------------------------------------------------------------------===//

static bool haveSameStorage(DifferentiableAccessInterface lhs,
                            DifferentiableAccessInterface rhs) {
  return getStorageKey(lhs) == getStorageKey(rhs);
}

/// True if both accesses are to array arguments of the kernel, which may be the
/// same array.
static bool mayBeOneArray(DifferentiableAccessInterface lhs,
                          DifferentiableAccessInterface rhs) {
  Value a = lhs.getAccessedStorage().memref;
  Value b = rhs.getAccessedStorage().memref;
  return a && b && a.getType() == b.getType() && isa<BlockArgument>(a) &&
         isa<BlockArgument>(b);
}

/// Emits a test that the array arguments of both accesses are the same array.
static Value createIsOneArray(ImplicitLocOpBuilder &b,
                              DifferentiableAccessInterface lhs,
                              DifferentiableAccessInterface rhs) {
  auto address = [&](DifferentiableAccessInterface access) -> Value {
    Value pointer = memref::ExtractAlignedPointerAsIndexOp::create(
        b, access.getAccessedStorage().memref);
    return arith::IndexCastOp::create(b, b.getI64Type(), pointer);
  };
  return arith::CmpIOp::create(b, arith::CmpIPredicate::eq, address(lhs),
                               address(rhs));
}

namespace {
/// Caches the answers of mayMeet by the indices of both accesses.
class Places {
public:
  explicit Places(ParallelForOp loop) : loop(loop) {}

  bool mayMeet(DifferentiableAccessInterface lhs,
               DifferentiableAccessInterface rhs) {
    std::pair<unsigned, unsigned> key(getNumber(lhs), getNumber(rhs));
    auto [known, isNew] = answers.insert({key, false});
    if (isNew)
      known->second = tai::mayMeet(
          loop, {lhs.getAccessIndices(), lhs.getAccessComponents()},
          {rhs.getAccessIndices(), rhs.getAccessComponents()});
    return known->second;
  }

private:
  using Place = SmallVector<IndexExpr>;

  unsigned getNumber(DifferentiableAccessInterface access) {
    auto [known, isNew] = numbers.insert({access, 0});
    if (!isNew)
      return known->second;
    Place place = builder.get(access.getAccessIndices());
    llvm::append_range(place, builder.get(access.getAccessComponents()));
    auto *same = llvm::find(places, place);
    unsigned number = same - places.begin();
    if (same == places.end())
      places.push_back(std::move(place));
    return known->second = number;
  }

  ParallelForOp loop;
  IndexBuilder builder;
  SmallVector<Place> places;
  llvm::DenseMap<Operation *, unsigned> numbers;
  llvm::DenseMap<std::pair<unsigned, unsigned>, bool> answers;
};
} // namespace

bool tai::isTotal(DifferentiableAccessInterface access) {
  if (auto update = dyn_cast<memref::AtomicRMWOp>(access.getOperation())) {
    using Kind = arith::AtomicRMWKind;
    return llvm::is_contained(
        {Kind::addf, Kind::addi, Kind::mulf, Kind::muli, Kind::xori},
        update.getKind());
  }
  auto atomic = dyn_cast<AtomicOp>(access.getOperation());
  if (!atomic)
    return false;
  AtomicKind kind = getCombiningKind(atomic.getKind());
  return kind == AtomicKind::Add || kind == AtomicKind::Mul ||
         kind == AtomicKind::Xor;
}

void OtherIterations::find(ArrayRef<DifferentiableAccessInterface> writes,
                           ArrayRef<DifferentiableAccessInterface> reads,
                           PairFilter isKnown, PairFilter isCertain) {
  Places places(loop);
  llvm::SmallPtrSet<Operation *, 8> reported;
  for (DifferentiableAccessInterface write : writes)
    for (DifferentiableAccessInterface read : reads) {
      bool isSame = haveSameStorage(write, read);
      if ((!isSame && !mayBeOneArray(write, read)) ||
          write.getAccessIndices().size() != read.getAccessIndices().size() ||
          isKnown(write, read) || !places.mayMeet(write, read))
        continue;
      if (!isSame || reported.contains(write) ||
          !(findRace(write, read) || findExample(write, read) ||
            isCertain(write, read))) {
        possible.push_back({write, read});
        continue;
      }
      certain.push_back({write, read});
      reported.insert(write);
    }
}

void OtherIterations::report() {
  for (auto [write, read] : certain) {
    bool isUpdate = isTotal(write) && getSharing(write, loop) != Sharing::Own;
    InFlightDiagnostic diag =
        read->emitError()
        << describeElement(read)
        << " is read here by one iteration of a parallel loop, while another "
        << (isUpdate ? "one updates it" : "one writes it")
        << ", and the result would depend on which of them comes first";
    Diagnostic &note = diag.attachNote(write->getLoc())
                       << (isUpdate ? "updated here" : "written here");
    auto show = [](ArrayRef<int64_t> iteration) {
      std::string text;
      llvm::raw_string_ostream stream(text);
      llvm::interleaveComma(iteration, stream);
      return iteration.size() == 1 ? text : "(" + text + ")";
    };
    if (auto example = findExample(write, read))
      note << ": iteration " << show(example->rhs) << " reads what iteration "
           << show(example->lhs) << " writes";
    diag.attachNote(loop->getLoc())
        << "run this loop on one thread ('serialize'), or "
        << (isUpdate
                ? "use the value that the update returns, or read the element "
                  "in a later loop"
                : "write to another field and copy it in a later loop");
  }
}

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

namespace {
/// Factors of indices up to this one cannot make products in i64 wrap.
constexpr int64_t kLargestFactor = int64_t(1) << 20;

/// Emits, before a loop, a test whether two accesses reach the same element in
/// different iterations.
class MeetingBuilder {
public:
  MeetingBuilder(ParallelForOp loop, Location loc)
      : loop(loop), b(loc, loop), rank(loop.getInductionVars().size()) {}

  /// Emits the test whether the accesses meet in different iterations; null if
  /// it cannot be computed before the loop.
  Value create(DifferentiableAccessInterface write,
               DifferentiableAccessInterface read);

private:
  struct Bounds {
    Value lower, upper;
  };

  /// The index of one of the iterations as a multiple, by another number than
  /// 1, of the index of the other iteration, and an offset.
  struct Multiple {
    bool isOfRead; // the index that is the multiple
    int64_t factor;
    IndexExpr offset;
  };

  bool addEquation(const IndexExpr &lhs, const IndexExpr &rhs);
  bool addCrossed(int ofWrite, int ofRead, IndexExpr difference,
                  int64_t factor);
  bool requireCrossed(ArrayRef<Bounds> writes, ArrayRef<Bounds> reads);
  bool addMultiple(unsigned dim, IndexExpr difference, int64_t ofWrite,
                   int64_t ofRead);
  bool requireMultiple(const Multiple &multiple, Bounds source, Bounds target);
  std::optional<std::pair<int, int64_t>> getLoopTerm(const IndexExpr &form);
  bool getBounds(const IndexLimits &limits, SmallVector<Bounds> &bounds);
  Value emit(const IndexExpr &expr);
  Value emit(const IndexAtom &atom);

  Value number(int64_t value) {
    return arith::ConstantIntOp::create(b, value, 64);
  }
  Value widen(Value value);
  Value compare(arith::CmpIPredicate predicate, Value lhs, Value rhs) {
    return b.createOrFold<arith::CmpIOp>(predicate, lhs, rhs);
  }
  void require(Value condition) {
    meets = meets ? b.createOrFold<arith::AndIOp>(meets, condition) : condition;
  }
  void addDifference(Value condition) {
    differ =
        differ ? b.createOrFold<arith::OrIOp>(differ, condition) : condition;
  }

  ParallelForOp loop;
  ImplicitLocOpBuilder b;
  IndexBuilder builder;
  size_t rank;
  /// For each dimension of the loop: the index of the reading iteration minus
  /// the index of the writing iteration.
  SmallVector<std::optional<IndexExpr>> differences;
  SmallVector<std::optional<Multiple>> multiples;
  /// For each dimension: the index of the reading iteration along the other
  /// dimension minus the index of the writing iteration along this one.
  std::array<std::optional<IndexExpr>, 2> crossed;
  /// Whether the accesses meet, and whether two iterations that do so differ.
  Value meets, differ;
};
} // namespace

Value MeetingBuilder::widen(Value value) {
  Type i64 = b.getI64Type();
  if (value.getType() == i64)
    return value;
  if (value.getType().isIndex())
    return b.createOrFold<arith::IndexCastOp>(i64, value);
  if (value.getType().isInteger(1))
    return b.createOrFold<arith::ExtUIOp>(i64, value);
  return b.createOrFold<arith::ExtSIOp>(i64, value);
}

/// Emits the value of an atom of an index expression as i64; null for
/// operations that may fault.
Value MeetingBuilder::emit(const IndexAtom &atom) {
  const IndexNode *node = atom.getNode();
  if (!node) {
    Type type = atom.getValue().getType();
    bool isNarrow = type.isIndex() || type.getIntOrFloatBitWidth() <= 64;
    return isNarrow ? widen(atom.getValue()) : Value();
  }
  using Kind = IndexNode::Kind;
  bool divides = node->kind != Kind::Product && node->kind != Kind::Min &&
                 node->kind != Kind::Max;
  if (divides && !(node->rhs.isConstant() && node->rhs.constant > 0))
    return {};
  Value lhs = emit(node->lhs), rhs = emit(node->rhs);
  if (!lhs || !rhs)
    return {};
  switch (node->kind) {
  case Kind::Quotient:
    return b.createOrFold<arith::FloorDivSIOp>(lhs, rhs);
  case Kind::Remainder: {
    Value quotient = b.createOrFold<arith::FloorDivSIOp>(lhs, rhs);
    return b.createOrFold<arith::SubIOp>(
        lhs, b.createOrFold<arith::MulIOp>(quotient, rhs));
  }
  case Kind::TruncatedQuotient:
    return b.createOrFold<arith::DivSIOp>(lhs, rhs);
  case Kind::TruncatedRemainder:
    return b.createOrFold<arith::RemSIOp>(lhs, rhs);
  case Kind::Product:
    return b.createOrFold<arith::MulIOp>(lhs, rhs);
  case Kind::Min:
    return b.createOrFold<arith::MinSIOp>(lhs, rhs);
  case Kind::Max:
    return b.createOrFold<arith::MaxSIOp>(lhs, rhs);
  }
  return {};
}

/// Emits the value of an index expression in i64, in which the sum does not
/// wrap.
Value MeetingBuilder::emit(const IndexExpr &expr) {
  Value sum = number(expr.constant);
  for (const auto &[atom, factor] : expr.terms) {
    Value value = emit(atom);
    if (!value)
      return {};
    value = b.createOrFold<arith::MulIOp>(value, number(factor));
    sum = b.createOrFold<arith::AddIOp>(sum, value);
  }
  return sum;
}

/// Returns the only dimension whose loop index occurs in the index expression,
/// and the factor of the index; dimension -1 if no loop index occurs. Nullopt
/// for other expressions.
std::optional<std::pair<int, int64_t>>
MeetingBuilder::getLoopTerm(const IndexExpr &form) {
  std::pair<int, int64_t> found(-1, 0);
  IndexExpr rest = form;
  for (auto [dim, iv] : llvm::enumerate(loop.getInductionVars())) {
    int64_t factor = form.getCoefficient(iv);
    if (factor == 0)
      continue;
    if (found.first >= 0)
      return std::nullopt;
    found = {static_cast<int>(dim), factor};
    rest.add(IndexExpr(iv), -factor);
  }
  bool isOfOutside = rest.allOf([&](Value value) {
    return !loop->isAncestor(value.getParentBlock()->getParentOp());
  });
  return isOfOutside ? std::optional(found) : std::nullopt;
}

/// Adds the equation lhs(i) == rhs(j) in i64, without wrapping: if the numbers
/// are equal, so are narrower indices, which wrap. False if the equation is not
/// supported.
bool MeetingBuilder::addEquation(const IndexExpr &lhs, const IndexExpr &rhs) {
  auto a = getLoopTerm(lhs), c = getLoopTerm(rhs);
  if (!a || !c)
    return false;
  IndexExpr difference = lhs;
  difference.add(rhs, -1);
  if (a->first != c->first)
    return a->second == c->second &&
           addCrossed(a->first, c->first, std::move(difference), a->second);
  if (a->second != c->second)
    return addMultiple(a->first, std::move(difference), a->second, c->second);
  if (a->first < 0) {
    Value distance = emit(difference);
    if (distance)
      require(compare(arith::CmpIPredicate::eq, distance, number(0)));
    return distance != nullptr;
  }
  if (rank == 2 && (crossed[0] || crossed[1]))
    return false;
  // The equation has become factor * j = factor * i + difference.
  int64_t factor = a->second;
  if (difference.isConstant() && difference.constant % factor == 0)
    difference = IndexExpr(difference.constant / factor);
  else if (std::abs(factor) != 1)
    return false;
  else if (factor == -1)
    difference = IndexExpr(0).add(difference, -1);
  std::optional<IndexExpr> &known = differences[a->first];
  if ((known && known->compare(difference) != 0) || multiples[a->first])
    return false;
  known = difference;
  return true;
}

/// Adds the equation factor * i + lhs == factor * j + rhs, where i and j are
/// indices along different dimensions, as in a transposition, and `difference`
/// is the left side minus the right side with the same indices in both. False
/// if the equation is not supported.
bool MeetingBuilder::addCrossed(int ofWrite, int ofRead, IndexExpr difference,
                                int64_t factor) {
  if (rank != 2 || ofWrite < 0 || ofRead < 0 || std::abs(factor) != 1 ||
      crossed[ofWrite])
    return false;
  difference.add(IndexExpr(loop.getInductionVars()[ofWrite]), -factor);
  difference.add(IndexExpr(loop.getInductionVars()[ofRead]), factor);
  IndexExpr distance(0);
  distance.add(difference, factor);
  crossed[ofWrite] = std::move(distance);
  return true;
}

/// Requires that iterations with crossed indices are in both ranges, and adds
/// the conditions that two of them differ.
bool MeetingBuilder::requireCrossed(ArrayRef<Bounds> writes,
                                    ArrayRef<Bounds> reads) {
  using Predicate = arith::CmpIPredicate;
  std::array<Value, 2> first, image;
  for (unsigned dim : {0, 1}) {
    Value distance = crossed[dim] ? emit(*crossed[dim]) : Value();
    if (!distance || differences[dim] || multiples[dim])
      return false;
    const Bounds &other = reads[1 - dim];
    Value from = b.createOrFold<arith::MaxSIOp>(
        writes[dim].lower,
        b.createOrFold<arith::SubIOp>(other.lower, distance));
    Value to = b.createOrFold<arith::MinSIOp>(
        writes[dim].upper,
        b.createOrFold<arith::SubIOp>(other.upper, distance));
    require(compare(Predicate::slt, from, to));
    Value count = b.createOrFold<arith::SubIOp>(to, from);
    addDifference(compare(Predicate::sgt, count, number(1)));
    first[dim] = from;
    image[1 - dim] = b.createOrFold<arith::AddIOp>(from, distance);
  }
  // An iteration alone meets itself if both indices are their images.
  for (unsigned dim : {0, 1})
    addDifference(compare(Predicate::ne, first[dim], image[dim]));
  return true;
}

/// Adds the equation ofWrite * i + lhs == ofRead * j + rhs along `dim`, where
/// `difference` is the left side minus the right side with the same index in
/// both. False if the equation is not supported.
bool MeetingBuilder::addMultiple(unsigned dim, IndexExpr difference,
                                 int64_t ofWrite, int64_t ofRead) {
  difference.add(IndexExpr(loop.getInductionVars()[dim]), ofRead - ofWrite);
  bool isOfRead = std::abs(ofWrite) != 1;
  int64_t unit = isOfRead ? ofRead : ofWrite;
  int64_t factor = isOfRead ? ofWrite : ofRead;
  // A dimension has one equation.
  if (std::abs(unit) != 1 || factor == 0 || std::abs(factor) > kLargestFactor ||
      differences[dim] || multiples[dim])
    return false;
  IndexExpr offset(0);
  offset.add(difference, isOfRead ? unit : -unit);
  multiples[dim] = Multiple{isOfRead, factor * unit, std::move(offset)};
  return true;
}

/// Requires that a multiple of an index in the range `source` is in the range
/// `target`, and adds the condition that one of them differs from its index.
bool MeetingBuilder::requireMultiple(const Multiple &multiple, Bounds source,
                                     Bounds target) {
  Value offset = emit(multiple.offset);
  if (!offset)
    return false;
  using Predicate = arith::CmpIPredicate;
  Value one = number(1), size = number(std::abs(multiple.factor));
  Value last = b.createOrFold<arith::SubIOp>(target.upper, one);
  auto divide = [&](Value x, Value y) {
    return b.createOrFold<arith::FloorDivSIOp>(
        b.createOrFold<arith::SubIOp>(x, y), size);
  };
  // The index is from (lower - offset) / factor to (last - offset) / factor,
  // rounded to the inside; with a negative factor, the other way round.
  bool isPositive = multiple.factor > 0;
  Value from =
      isPositive
          ? divide(b.createOrFold<arith::SubIOp>(target.lower, one), offset)
          : divide(offset, target.upper);
  Value to = isPositive ? divide(last, offset) : divide(offset, target.lower);
  from = b.createOrFold<arith::MaxSIOp>(
      source.lower, b.createOrFold<arith::AddIOp>(from, one));
  to = b.createOrFold<arith::MinSIOp>(source.upper,
                                      b.createOrFold<arith::AddIOp>(to, one));
  require(compare(Predicate::slt, from, to));
  // One index at most is its own multiple.
  Value count = b.createOrFold<arith::SubIOp>(to, from);
  addDifference(compare(Predicate::sgt, count, one));
  Value moved = b.createOrFold<arith::AddIOp>(
      b.createOrFold<arith::MulIOp>(from, number(multiple.factor - 1)), offset);
  addDifference(compare(Predicate::ne, moved, number(0)));
  return true;
}

bool MeetingBuilder::getBounds(const IndexLimits &limits,
                               SmallVector<Bounds> &bounds) {
  std::optional<LoopBox> box = getConstantBox(loop);
  if (!box && loop.isStructFor())
    return false;
  for (size_t dim = 0; dim != rank; ++dim) {
    Value lower =
        box ? number(box->lower[dim]) : widen(loop.getLowerBounds()[dim]);
    Value upper =
        box ? number(box->upper[dim]) : widen(loop.getUpperBounds()[dim]);
    for (const IndexExpr &limit : limits.lower[dim]) {
      Value value = emit(limit);
      if (!value)
        return false;
      lower = b.createOrFold<arith::MaxSIOp>(lower, value);
    }
    for (const IndexExpr &limit : limits.upper[dim]) {
      Value value = emit(limit);
      if (!value)
        return false;
      upper = b.createOrFold<arith::MinSIOp>(upper, value);
    }
    bounds.push_back({lower, upper});
  }
  return true;
}

Value MeetingBuilder::create(DifferentiableAccessInterface write,
                             DifferentiableAccessInterface read) {
  std::optional<IndexLimits> ofWrite = getLimits(write, loop);
  std::optional<IndexLimits> ofRead = getLimits(read, loop);
  if (!ofWrite || !ofRead)
    return {};
  differences.resize(rank);
  multiples.resize(rank);
  auto add = [&](ValueRange lhs, ValueRange rhs) {
    return llvm::all_of(llvm::zip_equal(lhs, rhs), [&](auto pair) {
      auto [a, c] = pair;
      return addEquation(builder.get(a), builder.get(c));
    });
  };
  ValueRange parts = write.getAccessComponents();
  ValueRange readParts = read.getAccessComponents();
  if (!add(write.getAccessIndices(), read.getAccessIndices()) ||
      (parts.size() == readParts.size() && !add(parts, readParts)))
    return {};
  SmallVector<Bounds> writes, reads;
  if (!getBounds(*ofWrite, writes) || !getBounds(*ofRead, reads))
    return {};
  using Predicate = arith::CmpIPredicate;
  bool isCrossed = crossed[0] || crossed[1];
  if (isCrossed && !requireCrossed(writes, reads))
    return {};
  for (size_t dim = 0; dim != (isCrossed ? 0 : rank); ++dim) {
    if (const std::optional<Multiple> &multiple = multiples[dim]) {
      bool isRead = multiple->isOfRead;
      if (!requireMultiple(*multiple, isRead ? writes[dim] : reads[dim],
                           isRead ? reads[dim] : writes[dim]))
        return {};
      continue;
    }
    auto [from, to] = writes[dim];
    auto [readFrom, readTo] = reads[dim];
    if (differences[dim]) {
      Value distance = emit(*differences[dim]);
      if (!distance)
        return {};
      // The range of writing iterations whose reading iteration is in the loop
      // as well.
      from = b.createOrFold<arith::MaxSIOp>(
          from, b.createOrFold<arith::SubIOp>(readFrom, distance));
      to = b.createOrFold<arith::MinSIOp>(
          to, b.createOrFold<arith::SubIOp>(readTo, distance));
      require(compare(Predicate::slt, from, to));
      addDifference(compare(Predicate::ne, distance, number(0)));
      continue;
    }
    require(compare(Predicate::slt, from, to));
    require(compare(Predicate::slt, readFrom, readTo));
    Value least = b.createOrFold<arith::MinSIOp>(from, readFrom);
    Value most = b.createOrFold<arith::MaxSIOp>(to, readTo);
    Value extent = b.createOrFold<arith::SubIOp>(most, least);
    addDifference(compare(Predicate::sge, extent, number(2)));
  }
  if (!differ)
    return {};
  require(differ);
  if (!haveSameStorage(write, read))
    require(createIsOneArray(b, write, read));
  return meets;
}

void OtherIterations::refuseLaunches() {
  auto kernel = loop->getParentOfType<KernelOp>();
  if (!kernel)
    return;
  for (auto [write, read] : possible) {
    Value meets = MeetingBuilder(loop, read->getLoc()).create(write, read);
    if (!meets || matchPattern(meets, m_Zero()))
      continue;
    ImplicitLocOpBuilder b(read->getLoc(), loop);
    std::string message = describeElement(read);
    if (!haveSameStorage(write, read))
      message =
          "two arguments of the kernel are one array, of which an element";
    message += " is read here by one iteration of a parallel loop, while "
               "another iteration writes it, and the result would depend on "
               "which of them comes first; write to another field and copy it "
               "in a later loop, or run this loop on one thread ('serialize')";
    Value isApart = b.createOrFold<arith::XOrIOp>(
        meets, arith::ConstantIntOp::create(b, 1, 1));
    if (loop->getParentOp() != kernel ||
        !IndexForms(kernel).isLaunchValue(isApart)) {
      AssertOp::create(b, isApart, b.getStringAttr(message), ValueRange(),
                       b.getI32IntegerAttr(TAI_FAIL_CHECK));
      continue;
    }
    // The precondition is moved to the top of the kernel, before all effects.
    Operation *condition = PreconditionOp::create(
        b, isApart, b.getStringAttr(message), ValueRange());
    SetVector<Operation *> slice;
    (void)getBackwardSlice(condition, &slice);
    slice.insert(condition);
    Operation *last = nullptr;
    for (Operation *op : slice) {
      if (last)
        op->moveAfter(last);
      else
        op->moveBefore(&kernel.getBody().front(),
                       kernel.getBody().front().begin());
      last = op;
    }
  }
}

//===----------------------------------------------------------------------===//
// Runs
//===----------------------------------------------------------------------===//

void OtherIterations::checkStorage(ArrayRef<AccessPair> pairs) {
  auto [first, other] = pairs.front();
  Value isWanted;
  if (!haveSameStorage(first, other)) {
    ImplicitLocOpBuilder b(loop.getLoc(), loop);
    isWanted = createIsOneArray(b, first, other);
  }
  std::optional<IterationShadow> shadow =
      IterationShadow::create(loop, first, isWanted);
  if (!shadow)
    return;
  Value writers = shadow->createArray(), readers = shadow->createArray();
  constexpr llvm::StringLiteral message =
      "is read by one iteration of a parallel loop and written by another one, "
      "and the result would depend on which of them comes first";
  llvm::SmallPtrSet<Operation *, 8> done;
  auto visit = [&](DifferentiableAccessInterface access, Value own,
                   Value others) {
    if (!done.insert(access).second)
      return;
    shadow->moveTo(access);
    shadow->leave(own, access);
    shadow->require(shadow->isFree(others, access), access, message);
  };
  for (auto [write, read] : pairs) {
    visit(write, writers, readers);
    visit(read, readers, writers);
  }
}

void OtherIterations::check() {
  using Key = std::pair<const void *, const void *>;
  llvm::MapVector<Key, SmallVector<AccessPair>> storages;
  for (const AccessPair &pair : possible)
    storages[Key(getStorageKey(pair.write), getStorageKey(pair.read))]
        .push_back(pair);
  for (auto &[key, pairs] : storages)
    checkStorage(pairs);
}
