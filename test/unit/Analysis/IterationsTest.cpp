//===- IterationsTest.cpp - Loops and accesses against enumeration --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Random kernels of parallel and serial loops, branches, and accesses. A small
// interpreter runs each kernel for several arguments and records the element of
// each access. Each answer of the analyses that distinguish iterations,
// accesses and ranges must hold for the recorded accesses; the tests count the
// answers, too.
//
//===----------------------------------------------------------------------===//

#include "../Utils/ContextTest.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Parser/Parser.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/IndexBounds.h"
#include "tai/Analysis/IterationOrder.h"
#include "tai/Analysis/Races.h"
#include "tai/Analysis/SharedElements.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "gtest/gtest.h"
#include <random>

using namespace mlir;
using namespace mlir::tai;

namespace {
/// An access that has run: its element, and the iteration of each loop around
/// it, from the outermost loop on.
struct Event {
  Operation *op;
  SmallVector<int64_t> indices, components;
  SmallVector<std::pair<Operation *, int64_t>> path;

  bool meets(const Event &other) const {
    return indices == other.indices &&
           (components.empty() || other.components.empty() ||
            components == other.components);
  }
  /// The iteration of `loop` in which the access ran; -1 outside the loop.
  int64_t iterationOf(Operation *loop) const {
    for (auto [around, iteration] : path)
      if (around == loop)
        return iteration;
    return -1;
  }
};

std::string show(Operation *op) {
  std::string text;
  llvm::raw_string_ostream(text) << *op << "\n";
  return text;
}

/// Runs a kernel on integers; dataAt() gives the contents of field `@k`.
class Interpreter {
public:
  static int64_t dataAt(ArrayRef<int64_t> indices) {
    int64_t value = 3;
    for (int64_t index : indices)
      value = value * 5 + index;
    return ((value % 7) + 7) % 7 - 1;
  }

  /// False if the run takes too long, or a value is undefined.
  bool run(KernelOp kernel, int64_t n) {
    events.clear();
    values.clear();
    steps = 0;
    set(kernel.getBody().getArgument(0), n);
    isDone = run(kernel.getBody().front());
    return isDone;
  }

  std::vector<Event> events;
  bool isDone = false;

  std::optional<int64_t> get(Value value) const {
    auto found = values.find(value);
    return found == values.end() ? std::nullopt : std::optional(found->second);
  }

private:
  void set(Value value, int64_t number) { values[value] = number; }
  SmallVector<int64_t> getAll(ValueRange range) {
    return llvm::map_to_vector(range,
                               [&](Value value) { return values.at(value); });
  }

  bool run(Block &block) {
    for (Operation &op : block.without_terminator())
      if (++steps > 1500 || !run(&op))
        return false;
    return true;
  }

  bool note(DifferentiableAccessInterface access) {
    events.push_back({access, getAll(access.getAccessIndices()),
                      getAll(access.getAccessComponents()), path});
    if (auto load = dyn_cast<LoadOp>(access.getOperation());
        load && load.getType().isInteger(32))
      set(load, dataAt(events.back().indices));
    return true;
  }

  bool run(Operation *op) {
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
      return note(access);
    if (auto branch = dyn_cast<scf::IfOp>(op)) {
      Region &region = values.at(branch.getCondition())
                           ? branch.getThenRegion()
                           : branch.getElseRegion();
      if (!region.empty() && !run(region.front()))
        return false;
      if (op->getNumResults() != 0)
        for (auto [result, value] :
             llvm::zip(op->getResults(),
                       region.front().getTerminator()->getOperands()))
          set(result, values.at(value));
      return true;
    }
    if (auto loop = dyn_cast<scf::ForOp>(op))
      return runFor(loop);
    if (auto loop = dyn_cast<scf::WhileOp>(op))
      return runWhile(loop);
    if (auto loop = dyn_cast<ParallelForOp>(op))
      return runParallel(loop);
    return compute(op);
  }

  bool runFor(scf::ForOp loop) {
    unsigned width = loop.getInductionVar().getType().isIndex() ? 64 : 32;
    auto numberOf = [&](Value value) {
      APInt bits(width, static_cast<uint64_t>(values.at(value)),
                 /*isSigned=*/true);
      return loop.getUnsignedCmp() ? bits.zext(65) : bits.sext(65);
    };
    APInt upper = numberOf(loop.getUpperBound());
    APInt step = numberOf(loop.getStep());
    int64_t number = 0;
    for (APInt at = numberOf(loop.getLowerBound()); at.slt(upper); at += step) {
      set(loop.getInductionVar(), at.trunc(width).getSExtValue());
      path.emplace_back(loop, number++);
      bool isDone = run(*loop.getBody());
      path.pop_back();
      if (!isDone)
        return false;
    }
    return true;
  }

  bool runWhile(scf::WhileOp loop) {
    SmallVector<int64_t> carried = getAll(loop.getInits());
    for (int64_t number = 0;; ++number) {
      for (auto [argument, value] :
           llvm::zip(loop.getBeforeArguments(), carried))
        set(argument, value);
      path.emplace_back(loop, number);
      bool isDone = run(*loop.getBeforeBody());
      if (isDone && values.at(loop.getConditionOp().getCondition())) {
        for (auto [argument, value] :
             llvm::zip(loop.getAfterArguments(),
                       getAll(loop.getConditionOp().getArgs())))
          set(argument, value);
        isDone = run(*loop.getAfterBody());
        if (isDone)
          carried = getAll(loop.getYieldOp().getOperands());
      } else if (isDone) {
        path.pop_back();
        return true;
      }
      path.pop_back();
      if (!isDone)
        return false;
    }
  }

  bool runParallel(ParallelForOp loop) {
    SmallVector<int64_t> lower = getAll(loop.getLowerBounds());
    SmallVector<int64_t> upper = getAll(loop.getUpperBounds());
    int64_t number = 0;
    for (int64_t i = lower[0]; i < upper[0]; ++i)
      for (int64_t j = lower[1]; j < upper[1]; ++j) {
        set(loop.getInductionVars()[0], i);
        set(loop.getInductionVars()[1], j);
        path.emplace_back(loop, number++);
        bool isDone = run(loop.getBody().front());
        path.pop_back();
        if (!isDone)
          return false;
      }
    return true;
  }

  bool compute(Operation *op) {
    if (op->getNumResults() != 1 || !op->getResult(0).getType().isIntOrIndex())
      return true;
    SmallVector<Attribute> operands;
    for (Value operand : op->getOperands()) {
      auto type = operand.getType();
      unsigned width = type.isIndex() ? 64 : type.getIntOrFloatBitWidth();
      operands.push_back(IntegerAttr::get(
          type, APInt(width, static_cast<uint64_t>(values.at(operand)),
                      /*isSigned=*/true, /*implicitTrunc=*/true)));
    }
    SmallVector<OpFoldResult> folded;
    if (failed(op->fold(operands, folded)) || folded.size() != 1)
      return false;
    if (auto value = dyn_cast<Value>(folded.front()))
      set(op->getResult(0), values.at(value));
    else
      set(op->getResult(0), cast<IntegerAttr>(cast<Attribute>(folded.front()))
                                .getValue()
                                .getSExtValue());
    return true;
  }

  llvm::DenseMap<Value, int64_t> values;
  SmallVector<std::pair<Operation *, int64_t>> path;
  int steps = 0;
};

class IterationsTest : public ContextTest {
protected:
  int64_t pick(int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  }
  bool chance(int percent) { return pick(1, 100) <= percent; }
  template <typename T> T any(std::initializer_list<T> list) {
    return list.begin()[pick(0, static_cast<int64_t>(list.size()) - 1)];
  }

  //===--------------------------------------------------------------------===//
  // Programs
  //===--------------------------------------------------------------------===//

  std::string name() { return "%" + std::to_string(++names); }
  std::string emit(const Twine &op) {
    std::string result = name();
    text += result + " = " + op.str() + "\n";
    return result;
  }
  std::string constant(int64_t value, StringRef type = "index") {
    return emit("arith.constant " + Twine(value) + " : " + type);
  }
  std::string anyIndex() {
    return indices[static_cast<size_t>(
        pick(0, static_cast<int64_t>(indices.size()) - 1))];
  }

  std::string makeIndex() {
    if (chance(12))
      return constant(pick(0, 5));
    std::string base = anyIndex();
    switch (pick(0, 11)) {
    case 0:
    case 1:
      return emit("arith.addi " + base + ", " + constant(pick(-3, 4)) +
                  " : index");
    case 2:
      return emit("arith.muli " + base + ", " + constant(pick(-2, 6)) +
                  " : index");
    case 3:
      return emit("arith.addi " + base + ", " + anyIndex() + " : index");
    case 4:
      return emit("arith.subi " + base + ", " + anyIndex() + " : index");
    case 5:
      return emit(any({"arith.floordivsi ", "arith.remsi ", "arith.divsi "}) +
                  base + ", " + constant(pick(1, 4)) + " : index");
    case 6:
      return emit(any({"arith.minsi ", "arith.maxsi "}) + base + ", " +
                  anyIndex() + " : index");
    case 7: {
      std::string data =
          emit("tai.load @k[" + base + ", " + anyIndex() + "] : i32");
      return emit("arith.index_cast " + data + " : i32 to index");
    }
    case 8:
      return emit("arith.muli " + base + ", " + anyIndex() + " : index");
    default:
      return base;
    }
  }

  void makeAccess() {
    std::string at = "[" + makeIndex() + ", " + makeIndex() + "]";
    switch (pick(0, 7)) {
    case 0:
    case 1:
      emit("tai.load @x" + at + " : f32");
      return;
    case 2:
      text += "tai.store " + any<std::string>({"%one", "%two", "%s"}) + ", @x" +
              at + " : f32\n";
      return;
    case 3:
      text += "tai.store %s, @x" + at + " : f32\n";
      return;
    case 4: {
      std::string old =
          emit("tai.atomic " + any<std::string>({"add", "sub", "max", "mul"}) +
               " %s, @x" + at + " : f32");
      if (chance(25))
        text += "tai.print \"{}\"(" + old + ") : f32\n";
      return;
    }
    case 5:
      text += "tai.store %pair, @v" + at + " : vector<2xf32>\n";
      return;
    default: {
      std::string part = chance(70) ? constant(pick(0, 1)) : anyIndex();
      if (chance(50))
        emit("tai.load @v" + at + " component [" + part + "] : f32");
      else
        text += "tai.store %s, @v" + at + " component [" + part + "] : f32\n";
    }
    }
  }

  std::string makeCondition() {
    if (chance(15)) {
      std::string op = any<std::string>({"arith.andi ", "arith.ori "});
      std::string first = makeCondition(), second = makeCondition();
      return emit(op + first + ", " + second + " : i1");
    }
    if (chance(8))
      return emit("arith.xori " + makeCondition() + ", %true : i1");
    if (chance(8)) {
      std::string first = makeCondition(), second = makeCondition();
      return emit(
          "arith.select " + first +
          (chance(50) ? ", " + second + ", %false" : ", %true, " + second) +
          " : i1");
    }
    std::string predicate = any<std::string>(
        {"eq", "ne", "slt", "sle", "sgt", "sge", "ult", "ule", "ugt", "uge"});
    std::string lhs = chance(60) ? anyIndex() : makeIndex();
    std::string rhs = chance(60) ? constant(pick(-1, 4)) : makeIndex();
    return emit("arith.cmpi " + predicate + ", " + lhs + ", " + rhs +
                " : index");
  }

  void makeBlock(int depth, int64_t most) {
    size_t outer = indices.size();
    for (int64_t count = pick(1, most); count > 0; --count) {
      int64_t kind = depth == 0 ? 9 : pick(0, 9);
      if (kind == 0) {
        bool isUnsigned = chance(25);
        std::string lower = chance(80) ? constant(pick(-1, 2)) : anyIndex();
        std::string upper = chance(70) ? constant(pick(0, 4)) : anyIndex();
        std::string step = constant(pick(1, 3));
        std::string iv = name();
        text += "scf.for " + std::string(isUnsigned ? "unsigned " : "") + iv +
                " = " + lower + " to " + upper + " step " + step + " {\n";
        indices.push_back(iv);
        makeBlock(depth - 1, 2);
        text += "}\n";
      } else if (kind == 1) {
        // Counts up in the first region or in the second.
        std::string first = name(), passed = name();
        std::string init = chance(60) ? constant(pick(0, 2)) : anyIndex();
        text +=
            "scf.while (" + first + " = " + init + ") : (index) -> index {\n";
        indices.push_back(first);
        if (chance(40))
          makeAccess();
        std::string next =
            chance(30) ? emit("arith.addi " + first + ", %c1 : index") : first;
        std::string more = emit("arith.cmpi slt, " + next + ", " +
                                constant(pick(1, 5)) + " : index");
        text += "scf.condition(" + more + ") " + next +
                " : index\n} do {\n^bb0(" + passed + ": index):\n";
        indices.resize(outer);
        indices.push_back(passed);
        makeBlock(depth - 1, 2);
        indices.resize(outer);
        indices.push_back(passed);
        std::string last = emit("arith.addi " + passed + ", " +
                                constant(pick(1, 2)) + " : index");
        text += "scf.yield " + last + " : index\n}\n";
      } else if (kind <= 4) {
        text += "scf.if " + makeCondition() + " {\n";
        makeBlock(depth - 1, 2);
        indices.resize(outer);
        if (chance(40)) {
          text += "} else {\n";
          makeBlock(depth - 1, 1);
        }
        text += "}\n";
      } else {
        makeAccess();
      }
      indices.resize(outer);
    }
  }

  void makeKernel() {
    names = 0;
    indices = {"%n_index"};
    text = R"(
      tai.tree @t : !tai.root<dense<[i: 6, j: 4], {x: f32, k: i32, v: vector<2xf32>}>>
      tai.field @x = @t["x"] : f32, rank 2
      tai.field @k = @t["k"] : i32, rank 2
      tai.field @v = @t["v"] : vector<2xf32>, rank 2
      tai.kernel @kernel(%n: i32) {
        %c1 = arith.constant 1 : index
        %true = arith.constant true
        %false = arith.constant false
        %one = arith.constant 1.0 : f32
        %two = arith.constant 2.0 : f32
        %pair = arith.constant dense<1.0> : vector<2xf32>
        %s = tai.random stream 0 : f32
        %n_index = arith.index_cast %n : i32 to index
    )";
    bool isAround = chance(20);
    if (isAround) {
      std::string lower = constant(0), upper = constant(pick(1, 3));
      std::string iv = name();
      text +=
          "scf.for " + iv + " = " + lower + " to " + upper + " step %c1 {\n";
      indices.push_back(iv);
    }
    for (int64_t loops = chance(70) ? 1 : 2; loops > 0; --loops) {
      std::string bounds[4];
      for (int d = 0; d != 2; ++d) {
        bounds[d] = chance(90) ? constant(pick(-1, 2)) : "%n_index";
        bounds[2 + d] = chance(85) ? constant(pick(1, 5)) : "%n_index";
      }
      std::string i = name(), j = name();
      text += "tai.parallel_for (" + i + ", " + j + ") = (" + bounds[0] + ", " +
              bounds[1] + ") to (" + bounds[2] + ", " + bounds[3] + ")" +
              (chance(25) ? " serialize" : "") + " {\n";
      size_t outer = indices.size();
      indices.insert(indices.end(), {i, j, i, j});
      makeBlock(2, 3);
      indices.resize(outer);
      text += "}\n";
    }
    if (isAround)
      text += "}\n";
    text += "tai.return\n}";
    module = parseSourceString<ModuleOp>(text, &context);
    ASSERT_TRUE(module) << text;
    kernel = module->lookupSymbol<KernelOp>("kernel");
    accesses.clear();
    kernel.walk([&](DifferentiableAccessInterface access) {
      accesses.push_back(access);
    });
  }

  //===--------------------------------------------------------------------===//
  // Notes
  //===--------------------------------------------------------------------===//

  /// Runs the kernel for several arguments. A run that takes too long is
  /// recorded up to the point where it was stopped.
  void runAll() {
    runs.clear();
    for (int64_t n : {0, 1, 2, 3, 5, -2, 40, -40}) {
      runs.emplace_back();
      runs.back().run(kernel, n);
    }
  }

  /// Calls body(first, second, isLater) for all pairs of events of two
  /// accesses; `isLater` tells whether the second event comes after the first.
  template <typename Body>
  void forEachPair(Operation *first, Operation *second, const Body &body) {
    for (const Interpreter &run : runs)
      for (size_t a = 0; a != run.events.size(); ++a)
        if (run.events[a].op == first)
          for (size_t b = 0; b != run.events.size(); ++b)
            if (run.events[b].op == second)
              body(run.events[a], run.events[b], b > a);
  }

  /// The outermost loop whose iterations differ between the events; null if
  /// there is none, or if the loops around the events differ before.
  static Operation *findDifference(const Event &a, const Event &b) {
    for (auto [x, y] : llvm::zip(a.path, b.path)) {
      if (x.first != y.first)
        return nullptr;
      if (x.second != y.second)
        return x.first;
    }
    return nullptr;
  }

  /// True if accesses in two different iterations of the loop reach the same
  /// element.
  bool meetIn(Operation *loop, Operation *first, Operation *second) {
    bool meet = false;
    forEachPair(first, second, [&](const Event &a, const Event &b, bool) {
      meet |= findDifference(a, b) == loop && a.meets(b);
    });
    return meet;
  }

  static bool isUnder(Operation *op, Operation *outer) {
    for (Operation *up = op->getParentOp(); up != outer; up = up->getParentOp())
      if (isa<scf::IfOp, scf::WhileOp>(up))
        return true;
    return false;
  }

  std::mt19937_64 random{20251128};
  std::string text;
  int names = 0;
  std::vector<std::string> indices;
  OwningOpRef<ModuleOp> module;
  KernelOp kernel;
  std::vector<DifferentiableAccessInterface> accesses;
  std::vector<Interpreter> runs;
};
} // namespace

TEST_F(IterationsTest, PairsOfAccesses) {
  int races = 0, apart = 0, later = 0, never = 0, own = 0, certain = 0;
  int same = 0, after = 0, commuting = 0, equal = 0, distinct = 0;
  for (int round = 0; round != 1000; ++round) {
    makeKernel();
    runAll();
    SCOPED_TRACE(text);
    for (DifferentiableAccessInterface a : accesses)
      for (DifferentiableAccessInterface b : accesses) {
        if (getStorageKey(a) != getStorageKey(b))
          continue;
        auto loop =
            dyn_cast_if_present<ParallelForOp>(getEnclosingParallelLoop(a));
        bool isOfOne = loop && getEnclosingParallelLoop(b) == loop;
        if (Operation *race = findRace(a, b)) {
          ++races;
          ASSERT_TRUE(meetIn(race, a, b)) << show(a) << show(b);
        }
        if (isOfOne &&
            !mayMeet(loop, {a.getAccessIndices(), a.getAccessComponents()},
                     {b.getAccessIndices(), b.getAccessComponents()})) {
          ++apart;
          ASSERT_FALSE(meetIn(loop, a, b)) << show(a) << show(b);
        }
        bool mayReach = mayReachLater(a, b);
        ++(mayReach ? later : never);
        bool isAfter = a != b && runsAfter(a, b);
        bool isSame = isAfter && reachSameElement(a, b);
        after += isAfter, same += isSame;
        Operation *aUp = a, *bUp = b;
        Block *common = findCommonBlock(aUp, bUp);
        ASSERT_TRUE(common);
        bool isCertain = !isUnder(a, common->getParentOp()) &&
                         !isUnder(b, common->getParentOp());
        llvm::DenseMap<const Event *, bool> met;
        forEachPair(a, b, [&](const Event &x, const Event &y, bool isLater) {
          Operation *differ = findDifference(x, y);
          bool counts = !differ || isSerialLoop(differ);
          if (!mayReach)
            ASSERT_FALSE(counts && isLater && x.meets(y)) << show(a) << show(b);
          bool isTogether = true;
          for (Operation *up = common->getParentOp(); !isa<KernelOp>(up);
               up = up->getParentOp())
            isTogether &= x.iterationOf(up) == y.iterationOf(up);
          if (!isTogether)
            return;
          if (isAfter)
            ASSERT_TRUE(isLater) << show(a) << show(b);
          met[&y] |= x.meets(y);
        });
        if (isSame && isCertain)
          for (auto [event, meets] : met)
            ASSERT_TRUE(meets) << show(a) << show(b);
      }
    for (DifferentiableAccessInterface access : accesses) {
      auto loop =
          dyn_cast_if_present<ParallelForOp>(getEnclosingParallelLoop(access));
      if (!loop || loop.getSerialize())
        continue;
      switch (getSharing(access, loop)) {
      case Sharing::Own: {
        ++own;
        forEachPair(access, access, [&](const Event &x, const Event &y, bool) {
          if (findDifference(x, y) == loop)
            ASSERT_NE(x.indices, y.indices) << show(access);
        });
        break;
      }
      case Sharing::Certain: {
        ++certain;
        break;
      }
      case Sharing::Possible:
        break;
      }
    }
    kernel.walk([&](ParallelForOp loop) {
      if (dependsOnOrder(loop))
        return;
      ++commuting;
      for (DifferentiableAccessInterface a : accesses)
        for (DifferentiableAccessInterface b : accesses) {
          if (getStorageKey(a) != getStorageKey(b) ||
              getEnclosingParallelLoop(a) != loop ||
              getEnclosingParallelLoop(b) != loop || !meetIn(loop, a, b))
            continue;
          bool areReads = a.getAccessKind() == AccessKind::Read &&
                          b.getAccessKind() == AccessKind::Read;
          bool areEqualStores = a.getAccessKind() == AccessKind::Write &&
                                b.getAccessKind() == AccessKind::Write &&
                                a.getAccessedValue() == b.getAccessedValue();
          auto x = dyn_cast<AtomicOp>(a.getOperation());
          auto y = dyn_cast<AtomicOp>(b.getOperation());
          auto isSum = [](AtomicOp op) {
            return op.getKind() == AtomicKind::Add ||
                   op.getKind() == AtomicKind::Sub;
          };
          bool areUpdates =
              x && y && x.getOld().use_empty() && y.getOld().use_empty() &&
              (x.getKind() == y.getKind() || (isSum(x) && isSum(y)));
          EXPECT_TRUE(areReads || areEqualStores || areUpdates)
              << show(a) << show(b);
        }
    });
    // Numbers of one iteration.
    for (DifferentiableAccessInterface a : accesses)
      for (DifferentiableAccessInterface b : accesses) {
        if (a->getBlock() != b->getBlock())
          continue;
        bool areEqual =
            areProvablyEqual(a.getAccessIndices(), b.getAccessIndices());
        bool areDistinct =
            areProvablyDistinct(a.getAccessIndices(), b.getAccessIndices());
        equal += areEqual, distinct += areDistinct;
        forEachPair(a, b, [&](const Event &x, const Event &y, bool) {
          if (x.path != y.path)
            return;
          if (areEqual)
            ASSERT_EQ(x.indices, y.indices);
          if (areDistinct)
            ASSERT_NE(x.indices, y.indices);
        });
      }
    markExclusiveAtomics(kernel);
    for (DifferentiableAccessInterface access : accesses)
      if (auto atomic = dyn_cast<AtomicOp>(access.getOperation());
          atomic && atomic.getExclusive())
        if (auto loop = dyn_cast_if_present<ParallelForOp>(
                getEnclosingParallelLoop(access));
            loop && !loop.getSerialize())
          for (DifferentiableAccessInterface other : accesses)
            if (other.getAccessKind() != AccessKind::Read &&
                getStorageKey(other) == getStorageKey(access))
              EXPECT_FALSE(meetIn(loop, access, other)) << show(access);
    if (HasFailure())
      return;
  }
  EXPECT_GT(races, 30);
  EXPECT_GT(apart, 300);
  EXPECT_GT(later, 300);
  EXPECT_GT(never, 300);
  EXPECT_GT(own, 150);
  EXPECT_GT(certain, 15);
  EXPECT_GT(same, 15);
  EXPECT_GT(after, 150);
  EXPECT_GT(commuting, 30);
  EXPECT_GT(equal, 150);
  EXPECT_GT(distinct, 15);
}

TEST_F(IterationsTest, Bounds) {
  int inRange = 0, decided = 0, refused = 0;
  for (int round = 0; round != 1000; ++round) {
    makeKernel();
    runAll();
    SCOPED_TRACE(text);
    IndexBounds bounds(kernel);
    const IndexForms &forms = bounds.getForms();
    for (DifferentiableAccessInterface op : accesses) {
      std::optional<IndexedAccess> access = IndexedAccess::get(op);
      ASSERT_TRUE(access);
      for (size_t d = 0; d != access->indices.size(); ++d) {
        bool proves = chance(50);
        BoundsAnswer answer = bounds.check(*access, d, proves);
        inRange += answer.isInRange, decided += answer.isDecided;
        for (const Interpreter &interpreter : runs) {
          int64_t n = *interpreter.get(kernel.getBody().getArgument(0));
          auto isOut = [&](const Event &event) {
            if (event.op != op)
              return false;
            int64_t index = d < access->rank
                                ? event.indices[d]
                                : event.components[d - access->rank];
            return index < access->first[d] ||
                   index >= access->first[d] + access->extents[d].number;
          };
          bool goesOut = llvm::any_of(interpreter.events, isOut);
          if (answer.isInRange)
            ASSERT_FALSE(goesOut) << n << " " << show(op) << " " << d;
          if (!interpreter.isDone)
            continue;
          // The numbers of the launch for which it is rejected.
          std::function<std::optional<__int128>(const LinearSum &)> sumOf =
              [&](const LinearSum &sum) -> std::optional<__int128> {
            __int128 value = sum.constant;
            for (auto [variable, factor] : sum.terms) {
              const LaunchValue *launch = forms.getLaunchValue(variable);
              std::optional<__int128> number;
              if (launch && launch->value) {
                number = interpreter.get(launch->value);
                // An i1 counts as 0 or 1.
                if (number && launch->value.getType().isInteger(1))
                  number = *number != 0;
              } else if (launch && !launch->factors.empty()) {
                number = 1;
                for (const LinearSum &part : launch->factors)
                  if (std::optional<__int128> one = sumOf(part); one && number)
                    *number *= *one;
                  else
                    number = std::nullopt;
              }
              if (!number)
                return std::nullopt;
              value += *number * factor;
            }
            return value;
          };
          bool isKnown = true, isRefused = false;
          for (const Violation &violation : answer.violations)
            isRefused |= llvm::all_of(
                violation.launch.getRows(), [&](const LinearSum &row) {
                  std::optional<__int128> value = sumOf(row);
                  isKnown &= value.has_value();
                  return value && *value >= 0;
                });
          if (!isKnown)
            continue;
          refused += isRefused;
          if (isRefused)
            ASSERT_TRUE(goesOut) << n << " " << show(op) << " " << d;
          if (answer.isDecided)
            ASSERT_EQ(isRefused, goesOut) << n << " " << show(op) << " " << d;
        }
      }
    }
    if (HasFatalFailure())
      return;
  }
  EXPECT_GT(inRange, 300);
  EXPECT_GT(decided, 600);
  EXPECT_GT(refused, 300);
}
