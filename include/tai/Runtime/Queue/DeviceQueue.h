//===- DeviceQueue.h - Work for a device, run again and again ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Stands between the runtime and a device. While it collects, work is written
// down instead of queued; a sequence that comes again becomes one graph, or one
// kernel that does all of it (docs/decisions/0011-device-programs.md). Which of
// them is found out by running them in turn.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_QUEUE_DEVICEQUEUE_H
#define TAI_RUNTIME_QUEUE_DEVICEQUEUE_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Queue/ProgramTiles.h"
#include <atomic>
#include <functional>
#include <unordered_map>

namespace mlir::tai::runtime {

class SequencePrefixes;
class RecordedLaunches;

/// A function of a kernel that goes into a program.
struct ProgramPart {
  /// What DeviceImage::bitcode holds; null for a part that is not there.
  const std::string *bitcode;
  std::string function;
  /// Whether rows of the table name it, or loops alone.
  bool isInTable = true;
  /// Whether it does one iteration, for chains.
  bool isTile = false;
  /// The most that a block of its launches has, where that says something.
  unsigned threads = 0;
};

/// A parameter of a step in a loop.
struct ProgramSlot {
  enum Kind {
    /// This word of the program's parameters.
    Fixed,
    /// The same, and the next word for each time that the loop has gone around.
    Growing,
    /// This word of the row that the loop's list has for each time around.
    Listed
  };
  Kind kind = Fixed;
  unsigned word = 0;
};

struct ProgramLoopStep {
  uint64_t part = 0;
  /// Whether all threads meet after it.
  bool waits = true;
  std::vector<ProgramSlot> slots;
};

/// Some steps of a program, one after another: a loop, or rows of the table.
struct ProgramSegment {
  /// Of a loop.
  std::vector<ProgramLoopStep> steps;
  /// How often, or how many rows.
  size_t count = 0;
  /// The number of the first step in the sequence.
  size_t first = 0;
  /// Of a loop: where its list starts in the table, and the words of a row.
  size_t listStart = 0, listWidth = 0;

  bool isLoop() const { return !steps.empty(); }
};

/// What a program consists of.
struct ProgramPlan {
  std::vector<ProgramPart> parts;
  std::vector<ProgramSegment> segments;
  /// Of the steps of loops with part firstChainPart and on.
  std::vector<TileChain> chains;
  /// The words of parameters of its loops.
  size_t words = 0;
  /// One of TAI_SCOPE_*.
  int scope = 0;
  /// The most that a block has.
  unsigned threads = 1;
  /// Whether the clock is read after each step.
  bool isTimed = false;
};

/// Makes one kernel, `tai_program`, that runs the plan; see
/// tai/Runtime/DeviceAbi.h. For TAI_SCOPE_LAUNCHES, makes a kernel of each
/// part, with the parameters of its function. For TAI_SCOPE_NONE, makes a
/// kernel of each part, which has no bitcode: it is a function of the device
/// library.
using ProgramMaker =
    std::function<Status(const ProgramPlan &plan, DeviceImage &image)>;

/// How sequences are run; for tests and measurements.
enum class ProgramMode {
  Automatic,
  Launches,
  Graph,
  Block,
  Cluster,
  Grid,
  /// As Grid, with chains in tiles.
  Tiles,
  /// As Graph, of kernels that wait by themselves.
  Overlapped,
  /// As Overlapped, with fills that are not needed at first beside them.
  Aside
};

class DeviceQueue final : public Device {
public:
  /// `unwatched`: what the device hands launches on to, where they may be given
  /// to it at once unless they come one by one; null for nothing.
  explicit DeviceQueue(std::unique_ptr<Device> device,
                       Device *unwatched = nullptr);
  ~DeviceQueue() override;

  /// Without one, sequences become graphs at best.
  void setProgramMaker(ProgramMaker maker) { makeProgram = std::move(maker); }
  void setMode(ProgramMode wanted) {
    (void)settle();
    records = false;
    mode = wanted;
  }
  /// Whether all work is queued step by step, so that each can be timed.
  void setOneByOne(bool on) {
    (void)settle();
    records &= !on;
    oneByOne = on;
    launcher = on || !unwatched ? device.get() : unwatched;
  }
  /// As often as others have been given memory, and have given it back: they
  /// do not ask for what is kept.
  Status share() {
    ++numShared;
    return settle();
  }
  void unshare() { --numShared; }

  /// Makes kernels of functions of the device library, which must be possible.
  bool canMakePrograms() const { return bool(makeProgram); }
  Status makeLibrary(const std::vector<std::string> &names,
                     DeviceImage &image) const;

  /// Between the two, work is collected. Pairs nest; the end runs what has been
  /// collected. Launches between two replays that come each time become part of
  /// the second one (docs/decisions/0014-launches-between-replays.md).
  void beginCollecting(bool isReplay = false);
  /// What is recorded may be collected, and is the same whether it is or not.
  bool isCollecting() const { return collecting > 0 || records; }
  Status endCollecting();
  /// Between the two, a tape records. Launches that are likely to be those of a
  /// recording before are collected until it ends or something else comes
  /// (docs/decisions/0015-recordings-that-come-again.md). `isSwept`: its
  /// reverse sweep comes next, and becomes part of the sequence.
  Status beginRecording();
  Status endRecording(bool isSwept);
  /// Whether launches of a recording are being collected.
  bool isGathering() const;
  /// A copy of what a tape keeps: nobody looks at it but work in order.
  Status copyKept(const DeviceRows &to, DevicePtr from, int64_t fromStep);
  /// Fills that come while nothing is collected are kept until something else
  /// comes: those beside one another become one, and those before a sequence
  /// become part of it. Queues them, and launches that were kept.
  Status settle() {
    if (__builtin_expect((!isKeeping && !watches && !records) || collecting > 0,
                         true))
      return Status::success();
    return flush();
  }
  /// Whether launches are kept, or are likely to be.
  bool keepsLaunches() const;
  bool mayKeep() const { return watches || records; }
  bool expectsLaunches() const;

  /// For what cannot wait until the sequence is whole, since it is timed:
  /// queues what has been collected, and a launch besides.
  Status interrupt() {
    (void)noteOther();
    return flush(/*isWhole=*/false);
  }
  Status launchNow(DeviceFunction &function, const LaunchShape &shape,
                   const uint64_t *slots, int count);

  /// What has become of the sequences so far, one line each.
  std::string explain() const;

  DeviceKind kind() const override { return device->kind(); }
  std::string name() const override { return device->name(); }
  DeviceLimits limits() const override { return device->limits(); }
  std::string target() const override { return device->target(); }
  Status allocate(int64_t bytes, DevicePtr &memory) override;
  Status reserve(int64_t bytes, DevicePtr &memory) override {
    return device->reserve(bytes, memory);
  }
  void free(DevicePtr memory) override;
  int64_t allocatedBytes() const override { return device->allocatedBytes(); }
  int64_t freeBytes() const override { return device->freeBytes(); }
  Status copyIn(DevicePtr to, const void *from, int64_t bytes) override;
  Status copyOut(void *to, DevicePtr from, int64_t bytes) override;
  Status copy(DevicePtr to, DevicePtr from, int64_t bytes) override;
  Status fill(DevicePtr to, const void *pattern, int patternBytes,
              int64_t count) override;
  Status copyRows(const DeviceRows &to, DevicePtr from,
                  int64_t fromStep) override;
  Status swapRows(const DeviceRows &one, DevicePtr other,
                  int64_t otherStep) override;
  Status fillRows(const DeviceRows &to, const void *pattern,
                  int patternBytes) override;
  bool isDeviceMemory(const void *address) const override {
    return device->isDeviceMemory(address);
  }
  Status load(const DeviceImage &image,
              std::unique_ptr<DeviceModule> &module) override;
  Status find(DeviceModule &module, const std::string &name,
              DeviceFunction *&function) override;
  unsigned mostThreads(const DeviceFunction &function) const override;
  unsigned residentBlocks(const DeviceFunction &function,
                          unsigned threads) const override;
  DeviceFunctionFacts facts(const DeviceFunction &function) const override;
  Status launch(DeviceFunction &function, const LaunchShape &shape,
                const uint64_t *slots, int count) override;
  Status record(std::unique_ptr<DeviceEvent> &event) override;
  Status wait(DeviceEvent &event) override { return device->wait(event); }
  Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                 int64_t &ns) override {
    return device->elapsed(from, to, ns);
  }
  Status waitForStream(uint64_t stream) override;
  Status letStreamWait(uint64_t stream) override;
  Status synchronize() override;
  void setStopWord(DevicePtr word) override { device->setStopWord(word); }

private:
  struct Function;
  struct Module;
  struct Step;
  struct Sequence;
  // The parts of programs, each with a header beside its source.
  class StepRunner;
  class StepSchedules;
  class GraphOrder;
  class OverlappingKernels;
  class Way;
  class GraphWay;
  class KernelWay;
  class PrefixedGraphs;
  class Program;

  /// Queues what has been collected; what is whole may become a program.
  Status flush(bool isWhole);
  Status flush() {
    bool isWhole = noteOther();
    return flush(isWhole || collecting > 0);
  }
  /// Something has come that is neither a launch nor a fill. Whether what a
  /// tape has recorded is as whole as it was before.
  bool noteOther();
  Status launchRecorded(Function &function, const LaunchShape &shape,
                        const uint64_t *slots, int count);
  void forget(const Module &module);
  bool keep(Function &function, const LaunchShape &shape, const uint64_t *slots,
            int count);
  Status runLead();
  Program *findProgram(Sequence &&sequence, bool &same);

  std::unique_ptr<Device> device;
  Device *unwatched;
  // What each launch looks at.
  /// What takes launches that are not collected.
  Device *launcher = nullptr;
  int collecting = 0;
  /// Whether work has been kept while nothing was collected.
  bool isKeeping = false;
  /// Whether launches may be kept.
  bool watches = false;
  /// Whether a tape records, and whether what it has recorded waits for its
  /// sweep.
  bool records = false, hasRecorded = false;
  bool oneByOne = false;
  ProgramMode mode = ProgramMode::Automatic;
  ProgramMaker makeProgram;
  std::atomic<int> numShared{0};
  std::unique_ptr<Sequence> collected;
  /// What comes before it: launches that were kept, and fills among them.
  std::unique_ptr<Sequence> lead;
  std::unique_ptr<SequencePrefixes> leads;
  std::unique_ptr<RecordedLaunches> recorded;
  /// Whether what is collected is a replay, and whether the last of it has come
  /// before.
  bool isReplay = false, hasProgram = false;
  /// What has gone wrong where nobody could be told.
  Status failure;
  std::vector<DevicePtr> released;
  std::unordered_multimap<uint64_t, std::unique_ptr<Program>> programs;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_QUEUE_DEVICEQUEUE_H
