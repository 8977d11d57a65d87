//===- DeviceQueue.h - Work for a device, collected -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A layer between the runtime and a device. While it collects, work is stored
// instead of queued; a repeated sequence becomes one graph, or one kernel that
// does all of it (docs/decisions/0011-device-programs.md). The queue finds the
// fastest of these forms by timing each form in turn.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_QUEUE_DEVICEQUEUE_H
#define TAI_RUNTIME_QUEUE_DEVICEQUEUE_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Device/KeptChoices.h"
#include "tai/Runtime/Programs/ProgramPlan.h"
#include <atomic>
#include <functional>
#include <map>
#include <optional>
#include <unordered_map>

namespace mlir::tai::runtime {

class SequencePrefixes;
class RecordedLaunches;
namespace programs {
struct Function;
struct Module;
struct Sequence;
class DeviceProgram;
} // namespace programs

/// The collection of launches that is open; while none is open, the last
/// collection.
struct LaunchCollection {
  bool isReplay = false;
  /// True if the collected sequence ran as a program, one kernel for all
  /// launches.
  bool hasProgram = false;
};

class DeviceQueue final : public Device {
public:
  /// Creates a queue in front of `device`. `unwatched`: the device that
  /// `device` wraps; launches may be passed to it directly unless setOneByOne()
  /// is on. Null if there is none.
  explicit DeviceQueue(std::unique_ptr<Device> device,
                       Device *unwatched = nullptr);
  ~DeviceQueue() override;

  /// Sets the compiler of programs. Without one, a sequence can become a graph,
  /// but not a program.
  void setProgramMaker(ProgramMaker maker) { makeProgram = std::move(maker); }
  /// Sets the function that compiles programs in the background. `Automatic`
  /// then tries the programs within a share of the time that their sequence has
  /// run.
  void setProgramStarter(ProgramStarter starter) {
    startProgram = std::move(starter);
  }
  /// Sets the storage in which the chosen forms of sequences are kept across
  /// processes.
  void keepChoices(KeptChoices kept) { choices = std::move(kept); }
  void setMode(ProgramMode wanted) {
    (void)settle();
    recording = Recording::None;
    mode = wanted;
  }
  /// With `on`, queues all work step by step, so that each step can be timed.
  void setOneByOne(bool on) {
    (void)settle();
    if (on)
      recording = Recording::None;
    oneByOne = on;
    launcher = on || !unwatched ? device.get() : unwatched;
  }
  /// Count the buffers exported to other libraries, which access memory without
  /// notice: while there are any, work is not deferred.
  Status share() {
    ++numShared;
    return settle();
  }
  void unshare() { --numShared; }

  /// Make device kernels of functions of the device library, which requires
  /// canMakePrograms().
  bool canMakePrograms() const { return bool(makeProgram); }
  Status makeLibrary(const std::vector<std::string> &names,
                     DeviceImage &image) const;

  /// Bracket work to collect. Calls nest; the outermost end runs the work.
  /// Launches that are repeated between two replays become part of the second
  /// replay (docs/decisions/0014-launches-between-replays.md).
  void beginCollecting(bool isReplay = false);
  /// True if work is being collected, or may be collected because a tape
  /// records. Recorded work gives the same result in both cases.
  bool isCollecting() const { return collecting > 0 || isRecording(); }
  Status endCollecting();
  /// Bracket the recording of a tape. Launches that probably repeat launches of
  /// an earlier recording are collected until the recording ends or other work
  /// interrupts it (docs/decisions/0015-recordings-that-come-again.md).
  /// `isSwept`: the reverse sweep of the tape follows, and becomes part of the
  /// sequence.
  Status beginRecording();
  Status endRecording(bool isSwept);
  /// True if launches that a tape records are being collected.
  bool isGathering() const;
  /// Copies values that a tape saves. The copy can be deferred with other work,
  /// because only queued work reads the destination.
  Status copyKept(const DeviceRows &to, DevicePtr from, int64_t fromStep);
  /// Queues deferred fills and launches. Outside of a collection, fills are
  /// deferred until other work comes: adjacent fills are merged, and fills
  /// before a sequence become part of it.
  Status settle() {
    if (runDepth)
      if (Status status = checkHandler(); !status)
        return status;
    if (__builtin_expect(
            (!isKeeping && !watches && !isRecording()) || collecting > 0, true))
      return Status::success();
    return flush();
  }
  /// Fails in a signal handler that has interrupted work which runs the
  /// collected launches: only a part of the launches has been queued, and on a
  /// device that does not run by itself only a part is done.
  Status checkHandler() const;
  /// keepsLaunches: true if launches are being deferred. mayKeep: true if they
  /// may be deferred. expectsLaunches: true if the next launches will probably
  /// be deferred.
  bool keepsLaunches() const;
  bool mayKeep() const { return watches || isRecording(); }
  bool expectsLaunches() const;

  /// Queues the collected work, before a timed launch that cannot wait for the
  /// end of the sequence; launchNow then queues the timed launch.
  Status interrupt() {
    if (runDepth)
      if (Status status = checkHandler(); !status)
        return status;
    (void)noteOther();
    return flush(/*isWhole=*/false);
  }
  Status launchNow(DeviceFunction &function, const LaunchShape &shape,
                   const uint64_t *slots, int count);

  /// Describes how each known sequence of launches is run, with a line for each
  /// sequence.
  std::string explain() const;

  DeviceKind kind() const override { return device->kind(); }
  std::string name() const override { return device->name(); }
  DeviceLimits limits() const override { return device->limits(); }
  std::string target() const override { return device->target(); }
  Status allocate(int64_t bytes, DevicePtr &memory) override;
  Status reserve(int64_t bytes, DevicePtr &memory) override;
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
  DeviceAssembler assembler() const override { return device->assembler(); }
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
  bool isRecording() const { return recording != Recording::None; }

  /// Queues the collected work. With `isWhole`, the collected sequence is
  /// complete, and may become a program.
  Status flush(bool isWhole);
  Status flush() {
    if (runDepth)
      if (Status status = checkHandler(); !status)
        return status;
    bool isWhole = noteOther();
    return flush(isWhole || collecting > 0);
  }
  /// Tells the recording of work other than launches and fills. Returns true if
  /// the recording so far equals a complete known recording.
  bool noteOther();
  Status launchRecorded(programs::Function &function, const LaunchShape &shape,
                        const uint64_t *slots, int count);
  void forget(programs::Module &module);
  Status runCollected(bool isWhole);
  bool keep(programs::Function &function, const LaunchShape &shape,
            const uint64_t *slots, int count);
  Status runPrefix();
  programs::DeviceProgram *findProgram(programs::Sequence &&sequence,
                                       bool &same);

  std::unique_ptr<Device> device;
  Device *unwatched;
  // The device to which launches are passed, beside the other members that each
  // launch reads.
  Device *launcher = nullptr;
  int collecting = 0;
  /// True if there is deferred work outside of a collection.
  bool isKeeping = false;
  /// True if launches outside of a recording may be deferred.
  bool watches = false;
  /// Tells whether a tape is recording.
  enum class Recording {
    None,
    Open,
    /// The recording has ended, and the reverse sweep of its tape will follow.
    AwaitsSweep
  };
  Recording recording = Recording::None;
  bool oneByOne = false;
  ProgramMode mode = ProgramMode::Automatic;
  ProgramMaker makeProgram;
  ProgramStarter startProgram;
  KeptChoices choices;
  std::atomic<int> numShared{0};
  std::unique_ptr<programs::Sequence> collected;
  /// The sequence of fills and launches that were deferred before the
  /// collection in `collected` began.
  std::unique_ptr<programs::Sequence> prefix;
  std::unique_ptr<SequencePrefixes> prefixes;
  std::unique_ptr<RecordedLaunches> recorded;
  LaunchCollection collection;
  /// The first failure of a call that could not return it.
  Status failure;
  /// Memory blocks of the device by address, and blocks that were given back
  /// while collected work may still use them. A block moves from one map to the
  /// other without an allocation on the host.
  using Blocks = std::map<uint64_t, DevicePtr>;
  Blocks blocks, released;
  uint64_t numReleased = 0;
  template <typename Allocate>
  Status allocateBlock(const Allocate &allocate, DevicePtr &memory);
  /// Set while the collected work runs: the number of safepoint handlers around
  /// that run.
  std::optional<unsigned> runDepth;
  /// Modules that were given up while the collected work runs.
  std::vector<std::unique_ptr<programs::Module>> retired;
  std::unordered_multimap<uint64_t, std::unique_ptr<programs::DeviceProgram>>
      known;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_QUEUE_DEVICEQUEUE_H
