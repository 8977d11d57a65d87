//===- DeviceProgram.h - A sequence of work that comes again ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H
#define TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H

#include "ProgramLoops.h"
#include "ProgramSchedule.h"
#include "TileChains.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include <algorithm>
#include <cstring>

namespace mlir::tai::runtime {

struct DeviceQueue::Function : DeviceFunction {
  DeviceFunction *function = nullptr;
  std::string name;
  /// Shared by all functions of a module, which may go before its programs.
  std::shared_ptr<const std::string> bitcode;
  /// Null where it is not known what it touches.
  std::shared_ptr<const Footprint> footprint;
  /// Null where it cannot run in tiles.
  std::shared_ptr<const FunctionAccesses> accesses;
};

struct DeviceQueue::Module : DeviceModule {
  /// What has been kept may launch its functions.
  ~Module() override {
    if (queue)
      queue->forget(*this);
  }
  bool has(const DeviceFunction *function) const {
    return std::any_of(
        functions.begin(), functions.end(),
        [&](const auto &known) { return known.get() == function; });
  }
  DeviceQueue *queue = nullptr;
  std::unique_ptr<DeviceModule> module;
  std::shared_ptr<const std::string> bitcode;
  std::vector<std::unique_ptr<Function>> functions;
  std::unordered_map<std::string, std::shared_ptr<const Footprint>> footprints;
  std::unordered_map<std::string, std::shared_ptr<const FunctionAccesses>>
      tileable;
};

struct DeviceQueue::Step {
  enum class Kind : uint32_t {
    Launch,
    Fill,
    Copy,
    FillRows,
    CopyRows,
    SwapRows
  };
  Kind kind;
  /// Of launches.
  unsigned numSlots = 0;
  Function *function = nullptr;
  LaunchShape shape;
  /// In the slots of the sequence: the parameters; of a fill the address, the
  /// pattern, its size and the count; of a copy both addresses and the size. Of
  /// rows these four numbers, and the other address and step, or the pattern
  /// and its size.
  size_t firstSlot = 0;
  /// Of the sequence in front of it.
  uint64_t hashBefore = 0;

  bool isFill() const { return kind == Kind::Fill || kind == Kind::FillRows; }
};

/// Work, in order.
struct DeviceQueue::Sequence {
  std::vector<Step> steps;
  std::vector<uint64_t> slots;
  /// Of what the steps are, without the slots.
  uint64_t hash = 14695981039346656037ull;

  bool empty() const { return steps.empty(); }
  void addLaunch(Function &function, const LaunchShape &shape,
                 const uint64_t *values, int count) {
    Step step{Step::Kind::Launch, static_cast<unsigned>(count), &function,
              shape, slots.size()};
    slots.insert(slots.end(), values, values + count);
    add(step);
  }
  /// Fills with nothing but fills between them that lie side by side are one
  /// step: those of fields that share their cells, say. What is filled again
  /// before anything else happens is left out.
  void addFill(const DeviceRows &rows, const void *pattern, int patternBytes);
  DeviceFill fillOf(const Step &step) const;
  void addCopy(DevicePtr to, DevicePtr from, int64_t bytes) {
    addWork(Step::Kind::Copy, {to, from, static_cast<uint64_t>(bytes)});
  }

  void addRows(Step::Kind kind, const DeviceRows &rows, uint64_t other,
               int64_t step) {
    addWork(kind,
            {rows.address, static_cast<uint64_t>(rows.step),
             static_cast<uint64_t>(rows.rowBytes),
             static_cast<uint64_t>(rows.rows), other,
             static_cast<uint64_t>(step), static_cast<uint64_t>(rows.outerStep),
             static_cast<uint64_t>(rows.outer)});
  }

  /// Adds all of the other one.
  void append(const Sequence &other);
  bool hasStructureOf(const Sequence &other) const;
  /// Queues it step by step.
  Status run(Device &device) const;
  Status run(Device &device, const Step &step) const;

private:
  DeviceRows rowsOf(const Step &step) const;
  void append(const DeviceFill &fill);
  void add(const Step &step) {
    steps.push_back(step);
    steps.back().hashBefore = hash;
    auto mix = [&](uint64_t value) {
      hash = (hash ^ value) * 1099511628211ull;
    };
    mix(static_cast<uint64_t>(step.kind));
    mix(reinterpret_cast<uintptr_t>(step.function));
    mix(uint64_t(step.shape.blocks) << 32 | step.shape.threads);
  }
  void addWork(Step::Kind kind, std::initializer_list<uint64_t> values) {
    Step step{kind, static_cast<unsigned>(values.size()), nullptr,
              LaunchShape(), slots.size()};
    slots.insert(slots.end(), values.begin(), values.end());
    add(step);
  }
};

/// A sequence that has come before, and the ways to run it.
class DeviceQueue::Program {
public:
  Program(Device &device, Sequence sequence)
      : sequence(std::move(sequence)), device(device) {}
  ~Program();

  /// `same`: with the slots of the last time.
  Status run(bool same, ProgramMode mode, const ProgramMaker &maker);
  /// The same behind a sequence that comes before it.
  Status run(const Sequence &lead, bool same, ProgramMode mode,
             const ProgramMaker &maker);
  /// Whether there are ways to run it.
  bool isPrepared() const {
    return !ways.empty() && !(chosen && current == ways.size());
  }
  std::string explain() const;
  bool uses(const Module &module) const;
  /// What it takes, for those who collect recordings.
  void tellTimes(double &chosenMs, double &graphMs) const;

  Sequence sequence;

private:
  /// One way to run it.
  struct Way {
    ProgramMode mode;
    /// By the model, and as measured: milliseconds. Negative for not yet.
    double predicted = 0, measured = -1;
    /// Why it cannot be taken.
    std::string refused;
    bool isReady = false;
    std::unique_ptr<DeviceGraph> graph;
    std::unique_ptr<DeviceModule> module;
    DeviceFunction *function = nullptr;
    DevicePtr table = 0;
    int64_t tableBytes = 0;
    /// One number for each step and one more, or none.
    DevicePtr clocks = 0;
    /// What repeats, and the parameters of that.
    ProgramLoops loops;
    std::vector<uint64_t> words;
    LaunchShape shape;
    bool isCurrent = false;
    /// Whether it runs chains in tiles.
    bool hasTiles = false;
    /// Of a graph whose launches overlap: what stands for each function.
    std::unordered_map<const Function *, DeviceFunction *> overlapping;
    /// Of a graph: the pieces of work that come one after another.
    size_t numNodes = 0;
    bool isGraph() const { return mode == ProgramMode::Graph || overlaps(); }
    bool overlaps() const {
      return mode == ProgramMode::Overlapped || mode == ProgramMode::Aside;
    }
  };

  /// The fills in front of a sequence: those that come first, and those beside
  /// what follows, up to a place in the order.
  struct FrontFills {
    std::vector<DeviceFill> first, aside;
    /// How many steps they were, and the place of the first that waits for all.
    size_t count = 0, join = 0;
  };

  /// The sequence behind another one.
  struct Led {
    Sequence lead;
    std::unique_ptr<DeviceGraph> graph;
    /// Whether the graph has what the ways have now.
    bool isCurrent = false;
    std::string refused;
    int runs = 0, changes = 0;
  };

  /// Steps of the sequence that stand together in a program: one, or a chain.
  struct Unit {
    size_t first, count;
    /// The number of the chain; -1 for none.
    int chain;
  };
  struct Schedule {
    std::vector<Unit> units;
    /// Of the units.
    ProgramSchedule order;
    const Unit &unit(size_t at) const { return units[order.order[at]]; }
  };

  void listWays(ProgramMode wanted);
  Status prepare(Way &way);
  Status makeKernel(Way &way, ProgramLoops loops);
  std::vector<const Function *> listParts() const;
  std::vector<LoopStep> listSteps(const Way &way) const;
  Status prepareOverlapped(Way &way);
  bool mayOverlapPay() const;
  Status capture(Way &way);
  Status runGraphSteps(Way &way, StepRunner &runner);
  std::vector<uint32_t> orderForGraph() const;
  bool splitFront(const std::vector<uint32_t> &order, FrontFills &front) const;
  Status runKernel(Way &way, StepRunner &runner);
  void noteRun(bool same);
  Led &findLed(const Sequence &lead);
  Status runLed(Led &led, const Sequence &lead, Way &way);
  Status captureLed(Led &led, Way &way);
  bool changeLed(Led &led, const Sequence &lead);
  std::string explainLeads() const;
  Status update(Way &way);
  Status updateTable(Way &way, const std::vector<uint64_t> &table);
  Status makeCurrent(Way &way);
  Status launch(Way &way);
  Status runTimed(Way &way);
  std::string explainClocks(const Way &way) const;
  double predict(const Way &way) const;
  unsigned getWidth() const;
  static uint64_t partOf(Step::Kind kind);
  StepMemory memoryOf(const Step &step) const;
  void schedule();
  size_t countStepsBefore() const;
  bool canHaveTiles() const;
  void scheduleTiles(const std::vector<StepMemory> &memory);
  void addTiles(ProgramPlan &plan) const;
  std::string describe(const Unit &unit) const;
  std::string describeChains() const;
  bool areAllPartsKnown() const;
  const Schedule &scheduleOf(const Way &way) const {
    return way.hasTiles ? tiled : plain;
  }

  Device &device;
  /// The schedules of programs, and what they were made from: the slots that
  /// say which memory the steps touch. That with tiles is empty where there are
  /// no chains.
  Schedule plain, tiled;
  /// All that there have been so far, by their numbers.
  std::vector<TileChain> chains;
  /// So many steps come before the program, each by itself.
  size_t numBefore = 0;
  /// Steps of which it is not known what they touch.
  size_t numUnknown = 0;
  std::vector<size_t> decisiveSlots;
  std::vector<uint64_t> decisiveValues;
  ProgramMaker maker;
  int runs = 0, changes = 0;
  std::vector<Way> ways;
  /// The way that is being tried, or that has been chosen.
  size_t current = 0;
  bool chosen = false;
  /// Times that the current way has been run while it is tried.
  int tries = 0;
  /// The latest last.
  std::vector<std::unique_ptr<Led>> leds;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_DEVICEPROGRAM_H
