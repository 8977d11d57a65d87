//===- TapePlanTest.cpp - Recordings and plans of tapes -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tests the parts of a tape that launch nothing. The kernels are never called.
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/Runtime/Tape/Plan/SlabSet.h"
#include "../../../../lib/Runtime/Tape/Sweep/AdjointForms.h"
#include "../../../../lib/Runtime/Tape/TapeReport.h"
#include "../../Utils/RuntimeTestUtils.h"
#include <array>
#include <random>
#include <set>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;
using Decision = TapePlan::Decision;

namespace {
constexpr int64_t n = 4;

int32_t neverCalled(TaiFrame *) {
  ADD_FAILURE() << "a plan launches nothing";
  return 0;
}

struct Scene {
  explicit Scene(Options options = {}) : runtime(options) {}

  Runtime runtime;
  TapeServices services{runtime};
  TapeRecording recording;
  TapePlan plan;
  std::vector<KernelPtr> kernels;

  FieldPtr field(const char *name) {
    return makeDifferentiable(runtime, name, ScalarKind::F64, {n});
  }
  /// to[...] = f(from[...])
  Kernel &stores(const FieldPtr &from, const FieldPtr &to,
                 AccessKind kind = AccessKind::Write) {
    return make({{from, AccessKind::Read}, {to, kind}});
  }
  Kernel &make(std::vector<Access> summary, int64_t slots = 0) {
    std::string name = "k" + std::to_string(kernels.size());
    kernels.push_back(
        makeKernel(runtime, name, neverCalled, std::move(summary), slots));
    return *kernels.back();
  }
  void record(Kernel &kernel, std::vector<uint64_t> args = {}) {
    recording.keep(kernel);
    recording.addLaunch(kernel, args.data(), next++);
  }
  std::vector<Decision> decide(std::vector<Field *> live,
                               const std::vector<FieldPtr> &wanted = {}) {
    plan.make(services, recording, std::move(live), wanted);
    std::vector<Decision> decisions;
    decisions.reserve(recording.size());
    for (size_t i = 0; i < recording.size(); ++i)
      decisions.push_back(plan[i]);
    return decisions;
  }
  uint64_t next = 0;
};

/// x[slot 0, ...]
std::vector<FixedIndex> atArgument() {
  return {FixedIndex{0, 0, {{0, 64, 1}}}};
}
} // namespace

//===----------------------------------------------------------------------===//
// Records
//===----------------------------------------------------------------------===//

TEST(TapeRecording, KeepsArgumentsAndDistances) {
  Scene scene;
  FieldPtr x = scene.field("x");
  Kernel &kernel = scene.make({{x, AccessKind::Read}}, 2);
  uint64_t first[] = {3, 4}, second[] = {5, 6};
  TapeRecording &recording = scene.recording;
  EXPECT_EQ(recording.numLaunches(), 0u);
  recording.addLaunch(kernel, first, 7);
  recording.addLaunch(kernel, second, 9);
  first[0] = second[0] = 0;
  EXPECT_EQ(recording.size(), 2u);
  EXPECT_EQ(recording.next(), 2u);
  EXPECT_EQ(recording.args(recording[0])[0], 3u);
  EXPECT_EQ(recording.args(recording[1])[0], 5u);
  EXPECT_EQ(recording.number(recording[1]), 9u);
  EXPECT_EQ(recording.numLaunches(), 3u);
  // The host function contains the launches with the numbers 10 to 12.
  recording.addCallback({nullptr, nullptr}, 10, 13);
  EXPECT_EQ(recording.numLaunches(), 6u);
  recording.renumber(100);
  EXPECT_EQ(recording.number(recording[0]), 100u);
  EXPECT_EQ(recording.number(recording[1]), 102u);
  EXPECT_EQ(recording.number(recording[2]), 103u);
}

TEST(TapeRecording, KnowsWhatElseThereIs) {
  Scene scene;
  FieldPtr x = scene.field("x");
  TapeRecording &recording = scene.recording;
  EXPECT_TRUE(recording.onlyLaunches());
  recording.addCallback({nullptr, nullptr}, 0, 0);
  EXPECT_TRUE(recording.hasCallbacks());
  EXPECT_FALSE(recording.onlyLaunches());
  EXPECT_FALSE(recording.callsInReverse());
  recording.addCallback({nullptr, [] { return Status::success(); }}, 0, 0);
  EXPECT_TRUE(recording.callsInReverse());

  double value = 2;
  int64_t index = 1;
  Status status;
  recording.addWrite(TapeRecording::Write::make(
      x, {HostWrite::What::Element, x.get(), &value, &index}, status));
  EXPECT_TRUE(status.ok());
  value = 3;
  index = 2;
  HostWrite kept = recording.write(recording[2]);
  EXPECT_EQ(*static_cast<const double *>(kept.bytes), 2);
  EXPECT_EQ(kept.index[0], 1);
  EXPECT_EQ(recording.describe(recording[2]), "(write of @x)");
  EXPECT_EQ(recording.describe(recording[0]), "(host function)");
}

TEST(TapeRecording, KeepsKernelsAlive) {
  Scene scene;
  FieldPtr x = scene.field("x");
  KernelPtr kernel =
      makeKernel(scene.runtime, "k", neverCalled, {{x, AccessKind::Read}});
  std::weak_ptr<Kernel> alive = kernel;
  scene.recording.keep(*kernel);
  scene.recording.keep(*kernel);
  EXPECT_EQ(scene.recording.kernels().size(), 1u);
  kernel.reset();
  EXPECT_FALSE(alive.expired());
}

//===----------------------------------------------------------------------===//
// Stored outputs and overwrites
//===----------------------------------------------------------------------===//

TEST(StoredSlabs, LosesWhatIsStoredAgain) {
  StoredSlabs outputs;
  std::vector<bool> lost;
  auto isLost = [&](uint32_t stamp) {
    return stamp < lost.size() && lost[stamp];
  };
  outputs.lose({}, lost);
  EXPECT_TRUE(lost.empty());
  outputs.mark(SlabRange::one(1), n, 5, lost);
  outputs.mark(SlabRange::one(2), n, 6, lost);
  EXPECT_FALSE(isLost(5));
  outputs.mark(SlabRange::one(1), n, 7, lost);
  EXPECT_TRUE(isLost(5));
  EXPECT_FALSE(isLost(6));
  // At an unknown place, a store may overwrite any slab, except its record's
  // own.
  outputs.mark({}, n, 7, lost);
  EXPECT_TRUE(isLost(6));
  EXPECT_FALSE(isLost(7));
  EXPECT_TRUE(outputs.any());
  outputs.lose(SlabRange::one(3), lost);
  EXPECT_TRUE(isLost(7));
  outputs.lose({}, lost);
  EXPECT_FALSE(outputs.any());
}

// Compares the records whose stored outputs are overwritten with an enumeration
// of all stores.
TEST(StoredSlabs, AgreesWithEnumeration) {
  std::mt19937_64 random(20251128);
  auto pick = [&](int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  };
  for (int round = 0; round < 2000; ++round) {
    StoredSlabs outputs;
    std::vector<bool> lost;
    // All stores as (record, slabs), and the records whose stores are lost.
    std::vector<std::pair<uint32_t, SlabRange>> stores;
    std::set<uint32_t> expected;
    uint32_t stamp = 0;
    auto change = [&](SlabRange slabs, uint32_t keeps) {
      for (auto [record, at] : stores)
        if (record != keeps &&
            (at.isAll() || slabs.isAll() ||
             (at.first < slabs.end() && slabs.first < at.end())))
          expected.insert(record);
    };
    for (int64_t step = pick(1, 12); step > 0; --step) {
      SlabRange slabs;
      if (int64_t first = pick(-1, n - 1); first >= 0)
        slabs = {first, pick(1, n - first)};
      if (pick(0, 2) == 0) {
        outputs.lose(slabs, lost);
        change(slabs, 0);
      } else {
        stamp += stamp == 0 ? 1 : static_cast<uint32_t>(pick(0, 1));
        outputs.mark(slabs, n, stamp, lost);
        change(slabs, stamp);
        stores.emplace_back(stamp, slabs);
      }
    }
    for (uint32_t record = 1; record <= stamp; ++record)
      ASSERT_EQ(record < lost.size() && lost[record],
                expected.count(record) > 0)
          << round << ": " << record;
  }
}

// Compares slabs with up to three fixed dimensions with the elements
// themselves.
TEST(SlabSet, AgreesWithEnumeration) {
  std::mt19937_64 random(20251128);
  auto pick = [&](int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  };
  Scene scene;
  const int64_t extents[] = {3, 2, 4};
  FieldPtr x = makeDifferentiable(scene.runtime, "x", ScalarKind::F64,
                                  {extents[0], extents[1], extents[2]});
  using Element = std::array<int64_t, 3>;
  for (int round = 0; round < 500; ++round) {
    SlabSet set(*x);
    std::vector<std::vector<FixedIndex>> accesses;
    std::vector<unsigned> shapes;
    for (int64_t k = pick(1, 5); k > 0; --k) {
      std::vector<FixedIndex> fixed;
      for (int64_t d = 0; d < 3; ++d)
        if (pick(0, 1))
          fixed.push_back({d, 0, {{d, 64, 1}}});
      shapes.push_back(set.addShape(fixed));
      accesses.push_back(std::move(fixed));
    }
    std::set<Element> expected;
    bool isExact = true;
    for (int64_t step = pick(1, 10); step > 0; --step) {
      auto at = static_cast<size_t>(
          pick(0, static_cast<int64_t>(accesses.size()) - 1));
      uint64_t args[3];
      for (int64_t d = 0; d < 3; ++d)
        args[d] = static_cast<uint64_t>(pick(0, extents[d] - 1));
      std::set<Element> slab;
      for (Element e{}; e[0] < extents[0]; ++e[0])
        for (e[1] = 0; e[1] < extents[1]; ++e[1])
          for (e[2] = 0; e[2] < extents[2]; ++e[2])
            if (std::all_of(accesses[at].begin(), accesses[at].end(),
                            [&](const FixedIndex &index) {
                              return e[index.dimension] == index.evaluate(args);
                            }))
              slab.insert(e);
      SlabSet::Slab located = set.locate(shapes[at], accesses[at], args);
      bool meets = std::any_of(slab.begin(), slab.end(), [&](const Element &e) {
        return expected.count(e);
      });
      // Elements may remain when a slab is removed, but no element is lost.
      EXPECT_TRUE(set.meets(located) || !meets) << round;
      if (isExact)
        EXPECT_EQ(set.meets(located), meets) << round;
      if (pick(0, 2)) {
        set.add(located);
        expected.insert(slab.begin(), slab.end());
        continue;
      }
      set.remove(located);
      for (const Element &e : slab)
        expected.erase(e);
      isExact = located.isWhole();
      if (isExact)
        EXPECT_FALSE(set.meets(set.whole()));
    }
  }
}

TEST(SlabSet, TakesAPlaceBeyondTheFieldForAny) {
  Scene scene;
  FieldPtr x = scene.field("x");
  SlabSet set(*x);
  std::vector<FixedIndex> fixed = atArgument();
  unsigned shape = set.addShape(fixed);
  uint64_t inside[] = {1}, other[] = {2}, behind[] = {n}, before[] = {~0ULL};
  set.add(set.locate(shape, fixed, inside));
  EXPECT_TRUE(set.meets(set.locate(shape, fixed, inside)));
  EXPECT_FALSE(set.meets(set.locate(shape, fixed, other)));
  EXPECT_TRUE(set.locate(shape, fixed, behind).isWhole());
  EXPECT_TRUE(set.meets(set.locate(shape, fixed, before)));
}

// x -> y -> z, and p -> z: only the last launch leads to p.
TEST(TapePlan, SkipsWhatLeadsToNoWantedField) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y"), z = scene.field("z"),
           p = scene.field("p");
  scene.record(scene.stores(x, y));
  scene.record(scene.stores(y, z, AccessKind::Accumulate));
  scene.record(scene.stores(p, z, AccessKind::Accumulate));
  EXPECT_EQ(scene.decide({z.get()}, {p}),
            (std::vector{Decision::SkipUnreached, Decision::SkipUnwanted,
                         Decision::Replay}));
  EXPECT_EQ(scene.plan.numUnwanted(), 1);
  EXPECT_EQ(scene.decide({z.get()}, {y}),
            (std::vector{Decision::SkipUnwanted, Decision::Replay,
                         Decision::SkipUnwanted}));
  EXPECT_EQ(scene.decide({z.get()}, {x, p}),
            (std::vector(3, Decision::Replay)));
}

// x[a] -> x[b], where a and b are arguments of each launch.
TEST(TapePlan, IsUsedAgainForTheSameRecords) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  auto at = [](int64_t slot) {
    return std::vector<FixedIndex>{FixedIndex{0, 0, {{slot, 64, 1}}}};
  };
  KernelPtr kernel = makeKernel(
      scene.runtime, "k", neverCalled,
      {{x, AccessKind::Read, at(0)}, {x, AccessKind::Write, at(1)}}, 2);
  auto add = [&](TapeRecording &recording, uint64_t from, uint64_t to,
                 uint64_t number) {
    uint64_t args[] = {from, to};
    recording.keep(*kernel);
    recording.addLaunch(*kernel, args, number);
  };
  auto decide = [&](const TapeRecording &recording, std::vector<Field *> live,
                    const std::vector<FieldPtr> &wanted = {}) {
    TapePlan plan;
    plan.make(scene.services, recording, std::move(live), wanted);
    std::vector<Decision> decisions;
    for (size_t i = 0; i < recording.size(); ++i)
      decisions.push_back(plan[i]);
    EXPECT_EQ(plan.replayed().size(),
              static_cast<size_t>(std::count(decisions.begin(), decisions.end(),
                                             Decision::Replay)));
    return decisions;
  };
  TapeRecording one, same, other;
  add(one, 0, 1, 0);
  add(one, 1, 1, 1);
  add(same, 0, 1, 7);
  add(same, 1, 1, 9);
  add(other, 0, 1, 10);
  add(other, 1, 2, 11);
  std::vector<Decision> first = decide(one, {x.get()});
  EXPECT_EQ(first, std::vector(2, Decision::Replay));
  std::shared_ptr<const KnownPlan> known = scene.services.knownPlan();
  ASSERT_TRUE(known);
  auto isKnown = [&] {
    bool result = scene.services.knownPlan() == known;
    known = scene.services.knownPlan();
    return result;
  };
  EXPECT_EQ(decide(same, {x.get()}), first);
  EXPECT_TRUE(isKnown());
  // Each of these calls needs a new plan.
  EXPECT_EQ(decide(same, {y.get()}), std::vector(2, Decision::SkipUnreached));
  EXPECT_FALSE(isKnown());
  EXPECT_EQ(decide(same, {x.get()}, {y}),
            std::vector(2, Decision::SkipUnwanted));
  EXPECT_FALSE(isKnown());
  EXPECT_EQ(decide(one, {x.get()}), first);
  EXPECT_FALSE(isKnown());
  (void)decide(other, {x.get()});
  EXPECT_FALSE(isKnown());
  // Adding another field begins a new epoch.
  FieldPtr z = scene.field("z");
  (void)decide(other, {x.get()});
  EXPECT_FALSE(isKnown());
  (void)decide(other, {x.get()});
  EXPECT_TRUE(isKnown());
  // With host functions and writes, each sweep decides again, and keeps no
  // plan.
  other.addCallback({nullptr, [] { return Status::success(); }}, 12, 12);
  (void)decide(other, {x.get()});
  (void)decide(other, {x.get()});
  EXPECT_TRUE(isKnown());
}

TEST(TapePlan, KeepsNoKernelForTheNextOne) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  std::weak_ptr<Kernel> alive;
  {
    KernelPtr kernel =
        makeKernel(scene.runtime, "k", neverCalled,
                   {{x, AccessKind::Read}, {y, AccessKind::Write}});
    alive = kernel;
    TapeRecording recording;
    recording.keep(*kernel);
    recording.addLaunch(*kernel, nullptr, 0);
    TapePlan plan;
    plan.make(scene.services, recording, {y.get()}, {});
    EXPECT_TRUE(scene.services.knownPlan());
  }
  EXPECT_TRUE(alive.expired());
}

TEST(Overwrites, TellsFixedIndicesApart) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  Kernel &kernel = scene.make(
      {{y, AccessKind::Read}, {x, AccessKind::Write, atArgument()}}, 1);
  scene.record(kernel, {0});
  scene.record(kernel, {1});
  scene.record(kernel, {1});
  scene.record(kernel, {2});
  Overwrites found = findOverwrites(scene.recording);
  EXPECT_EQ(found.isRepeated, (std::vector<bool>{false, false, true, false}));
  // The elements that these kernels store are unknown.
  EXPECT_TRUE(found.storedOnce.empty());
}

TEST(Overwrites, NamesWhatWasStoredOnce) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  Access store{x, AccessKind::Write};
  store.boxes = std::make_shared<const std::vector<StoredBox>>(
      std::vector<StoredBox>{{{{{0, 1, {}}, {0, 3, {}}}}, {}}});
  scene.record(scene.make({{y, AccessKind::Read}, store}));
  Overwrites found = findOverwrites(scene.recording);
  EXPECT_EQ(found.isRepeated, (std::vector<bool>{false}));
  ASSERT_EQ(found.storedOnce.size(), 1u);
  EXPECT_EQ(found.storedOnce[0].first.get(), x->adjoint());
  const OwedZeros &zeros = *found.storedOnce[0].second;
  ASSERT_EQ(zeros.boxes.size(), 1u);
  EXPECT_EQ(zeros.boxes[0].lower, (std::vector<int64_t>{1}));
  EXPECT_EQ(zeros.boxes[0].upper, (std::vector<int64_t>{3}));
}

//===----------------------------------------------------------------------===//
// Decisions
//===----------------------------------------------------------------------===//

TEST(TapePlan, FollowsAdjointsBackwards) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y"), z = scene.field("z");
  FieldPtr plain = makeField(scene.runtime, "plain", ScalarKind::F64, {n});
  scene.record(scene.stores(x, y));
  scene.record(scene.stores(x, z));
  scene.record(scene.stores(plain, y));
  Kernel &constant = scene.make({{z, AccessKind::Write}});
  scene.record(constant);

  using D = Decision;
  EXPECT_EQ(scene.decide({}),
            (std::vector<D>{D::SkipUnreached, D::SkipUnreached,
                            D::SkipUnreached, D::SkipUnreached}));
  EXPECT_TRUE(scene.plan.replayed().empty());
  EXPECT_FALSE(scene.plan.replaysAny());
  EXPECT_EQ(scene.plan.numSkipped(), 4);

  // The third launch overwrites y: the adjoint of y ends there.
  EXPECT_EQ(scene.decide({y.get()}),
            (std::vector<D>{D::Replay, D::SkipUnreached, D::Replay,
                            D::SkipUnreached}));
  EXPECT_EQ(scene.plan.replayed(), (std::vector<uint32_t>{2, 0}));
  EXPECT_EQ(scene.decide({z.get()}),
            (std::vector<D>{D::SkipUnreached, D::Replay, D::SkipUnreached,
                            D::Replay}));
  EXPECT_EQ(scene.plan.numSkipped(), 2);
}

TEST(TapePlan, HoldsForItsRecordsAndAdjoints) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  scene.record(scene.stores(x, y));
  EXPECT_FALSE(scene.plan.isMade(scene.recording));
  scene.decide({y.get()});
  uint64_t epoch = scene.services.epoch();
  EXPECT_TRUE(scene.plan.holds(scene.recording, epoch, {y.get()}));
  EXPECT_FALSE(scene.plan.holds(scene.recording, epoch, {x.get()}));
  EXPECT_FALSE(scene.plan.holds(scene.recording, epoch + 1, {y.get()}));
  scene.record(scene.stores(x, y));
  EXPECT_FALSE(scene.plan.holds(scene.recording, epoch, {y.get()}));
}

TEST(TapePlan, CountsOnNothingBeforeAHostFunction) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y"), z = scene.field("z");
  scene.record(scene.stores(x, y));
  scene.recording.addCallback({nullptr, [] { return Status::success(); }}, 1,
                              1);
  scene.record(scene.stores(x, y));
  using D = Decision;
  EXPECT_EQ(scene.decide({z.get()}),
            (std::vector<D>{D::Replay, D::Callback, D::SkipUnreached}));
  // The fields that the host function touches are known once it has run.
  scene.plan.decideAgain(scene.recording, 0);
  EXPECT_EQ(scene.plan[0], D::SkipUnreached);
  y->adjoint()->markDirty();
  scene.plan.decideAgain(scene.recording, 0);
  EXPECT_EQ(scene.plan[0], D::Replay);
}

TEST(TapePlan, EndsAdjointsOfHostWrites) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  double value = 1;
  Status status;
  scene.recording.addWrite(TapeRecording::Write::make(
      x, {HostWrite::What::Fill, x.get(), &value}, status));
  EXPECT_TRUE(status.ok());
  scene.record(scene.stores(x, y));
  using D = Decision;
  EXPECT_EQ(scene.decide({y.get()}), (std::vector<D>{D::Overwrite, D::Replay}));
  EXPECT_EQ(scene.decide({}),
            (std::vector<D>{D::SkipUnreached, D::SkipUnreached}));
}

TEST(AdjointForms, NamesEachPendingFormOnce) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  Kernel &first = scene.stores(x, y), &second = scene.stores(x, y);
  scene.record(first);
  scene.record(second);
  scene.record(second);
  TapeMemory memory(scene.runtime);
  AdjointForms forms(scene.services, scene.recording, scene.plan, memory);
  scene.decide({y.get()});
  std::vector<PendingAdjoint> pending = forms.pending();
  // The first launch stores y first; the later launches end the adjoint of the
  // overwritten y.
  ASSERT_EQ(pending.size(), 2u);
  EXPECT_EQ(pending[0], (PendingAdjoint{&second, true, false}));
  EXPECT_EQ(pending[1], (PendingAdjoint{&first, false, false}));
  EXPECT_FALSE(forms.loadsStored(0));
}

TEST(TapeReport, SaysWhatBecomesOfRecords) {
  Scene scene;
  FieldPtr x = scene.field("x"), y = scene.field("y");
  scene.record(scene.stores(x, y));
  scene.recording.addCallback({nullptr, nullptr}, 1, 1);
  TapeMemory memory(scene.runtime);
  AdjointForms forms(scene.services, scene.recording, scene.plan, memory);
  TapeReport report;
  scene.decide({y.get()});
  report.addRecord(scene.recording, scene.plan, forms, 0, 2048, 3, nullptr);
  report.addRecord(scene.recording, scene.plan, forms, 1, 0, 0, nullptr);
  EXPECT_EQ(report.get(),
            "0: @k0: replayed, from the adjoints of @y to those of @x; saved "
            "2.0 KiB; recomputed 3 times\n"
            "1: (host function): skipped: it has no reverse function\n");
  report.checkEffect(scene.recording, scene.plan, "'y'", false);
  EXPECT_TRUE(report.notes.empty());
  scene.decide({});
  report.checkEffect(scene.recording, scene.plan, "'y'", false);
  EXPECT_EQ(report.notes.size(), 1u);
}

// If launches are not skipped, a launch without effect is replayed, and the
// report says so.
TEST(TapeReport, SaysWhyNothingIsDone) {
  for (bool skips : {true, false}) {
    Options options;
    options.skips.set(mlir::tai::Skip::DeadLaunches, skips);
    Scene scene(options);
    FieldPtr x = scene.field("x"), y = scene.field("y");
    scene.record(scene.stores(x, y));
    scene.record(scene.make({{y, AccessKind::Accumulate}}));
    TapeMemory memory(scene.runtime);
    AdjointForms forms(scene.services, scene.recording, scene.plan, memory);
    TapeReport report;
    scene.decide({x.get()});
    report.addRecord(scene.recording, scene.plan, forms, 0, 0, 0, nullptr);
    scene.decide({y.get()});
    report.addRecord(scene.recording, scene.plan, forms, 1, 0, 0, nullptr);
    EXPECT_EQ(report.get(),
              skips ? "0: @k0: skipped: no adjoint reaches @y\n"
                      "1: @k1: skipped: it reads no field that has an adjoint\n"
                    : "0: @k0: replayed, without effect: 'dead-launches' is "
                      "off\n"
                      "1: @k1: replayed, without effect: 'dead-launches' is "
                      "off\n");
  }
}
