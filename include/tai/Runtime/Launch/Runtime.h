//===- Runtime.h - Trees, fields, launches ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One Runtime holds the storage, the workers and the state of launches of one
// context. There is no global state: several live in one process.
//
// Threads: launches may come from several threads at once (a parallel loop
// that finds the workers taken runs on its own thread). Everything else,
// recording a tape included, belongs to one thread at a time.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_RUNTIME_H
#define TAI_RUNTIME_LAUNCH_RUNTIME_H

#include "tai/Runtime/Device/KeptBlockSizes.h"
#include "tai/Runtime/Launch/Kernel.h"
#include "tai/Runtime/Launch/RunningLaunches.h"
#include "tai/Runtime/Launch/Safepoint.h"
#include "tai/Runtime/Profile/Profiler.h"
#include "tai/Runtime/Tape/Tape.h"
#include "tai/Support/Skips.h"
#include <string_view>
#include <unordered_map>

/// What the opaque pointer of Abi.h points to.
struct TaiRuntime {};

namespace mlir::tai::runtime {

class Device;
class DeviceContext;
class DeviceQueue;
class ForkGuard;
struct HostWrite;
class GradientCheck;
class TangentFlows;
class WorkerPool;
struct Launch;

struct Options {
  /// 0 = as many as the process may use.
  int threads = 0;
  /// Partitions of reductions do not depend on the number of threads.
  bool deterministic = false;
  /// Recorded for those who ask; the runtime itself checks always.
  bool debug = false;
  bool profiler = false;
  uint64_t seed = 0;
  /// Most bytes of trees and scratch; 0 = the memory of the machine (or of its
  /// control group).
  int64_t memoryLimit = 0;
  /// What is left out where it is not needed.
  SkipSet skips;
  /// Threads of a block on a device; 0 = what suits the kernel.
  int blockThreads = 0;
  /// The most of them, whatever is asked for; 0 for no limit but the device's.
  int mostBlockThreads = 0;
};

struct FieldInfo {
  std::string name;
  TreePtr tree;
  FieldLayout layout;
  /// Names of other fields, which need not exist yet; empty for none.
  std::string adjoint, dual;
};

/// What a host program (a `func.func` run on the host) may name.
struct HostModule {
  std::function<Kernel *(std::string_view name)> findKernel;
  /// Whether it loads or stores elements of fields itself, so that they must be
  /// on the host whenever it runs.
  bool usesTrees = true;
};

struct Counters {
  int64_t launches = 0;
  int64_t forks = 0;       // parallel loops that used workers
  int64_t inlineLoops = 0; // those too small to pay for a fork
  int64_t recorded = 0;
  int64_t replayed = 0;
  int64_t skipped = 0;
  int64_t clearedFields = 0;
};

/// Memory of a field in the hands of others, which stays as long as this, also
/// when the field is gone.
class Loan {
public:
  explicit Loan(const TreePtr &tree);
  ~Loan();
  Loan(const Loan &) = delete;
  Loan &operator=(const Loan &) = delete;
  /// Whether there are any, of whatever runtime.
  static bool areAny() { return count.load(std::memory_order_relaxed) > 0; }

private:
  static std::atomic<int> count;
  TreePtr tree;
  std::shared_ptr<void> memory;
  std::shared_ptr<Mirror> mirror;
};

struct LentField {
  void *address = nullptr;
  bool onDevice = false;
  /// Bytes from one index to the next, along each dimension of the field and of
  /// its element.
  std::vector<int64_t> strides;
  std::unique_ptr<Loan> loan;
};

class Runtime final : public ::TaiRuntime {
public:
  explicit Runtime(Options options = {});
  ~Runtime();
  Runtime(const Runtime &) = delete;
  Runtime &operator=(const Runtime &) = delete;

  const Options &options() const { return opts; }
  /// Changes what may be changed at any time between launches.
  void setThreads(int threads);
  void setDeterministic(bool on) { opts.deterministic = on; }
  void setDebug(bool on) { opts.debug = on; }
  void setProfiler(bool on);
  /// Whether device code should say where it stands in the source.
  bool wantsPlaces() const;
  void setSkips(SkipSet skips);
  /// Kernels that are loaded from then on have blocks of so many threads.
  void setBlockThreads(int threads) { opts.blockThreads = threads; }
  void setMostBlockThreads(int threads) { opts.mostBlockThreads = threads; }
  /// Holds for kernels that are loaded afterwards.
  void keepBlockSizes(KeptBlockSizes kept) { blockSizes = std::move(kept); }
  bool skips(Skip skip) const { return opts.skips.has(skip); }
  /// In forward mode every kernel is launched with the tangents that it carries
  /// along: also those that a tape replays, and adjoints.
  /// Of the calling thread.
  void setForward(bool on);
  bool isForward() const {
    return __builtin_expect(numForward.load(std::memory_order_relaxed) != 0,
                            false) &&
           isForwardHere();
  }
  /// Follows the tangents of these fields until forward mode is switched; and:
  /// what has ended them on the way to the others, one line each, said once. Of
  /// the thread in forward mode.
  void followTangents(const std::vector<FieldPtr> &inputs);
  std::vector<std::string> lostTangents(const std::vector<FieldPtr> &outputs);
  /// Whether launches that come one after another may become one piece of work.
  void setFuseLaunches(bool on) { fusesLaunches = on; }
  /// Also restarts the numbering of launches, so that what follows draws the
  /// same random numbers again.
  void setSeed(uint64_t seed);
  int threads() const { return numThreads; }

  //===--------------------------------------------------------------------===//
  // Device
  //===--------------------------------------------------------------------===//

  /// Runs kernels on the device from now on, with at most so many bytes there
  /// (0 for what it has). Fails once there are trees.
  Status useDevice(std::unique_ptr<Device> device, int64_t memoryLimit = 0);
  /// Null where kernels run on the CPU.
  Device *getDevice() const;
  /// The queue in front of it, or null.
  DeviceQueue *getDeviceQueue() const;
  DeviceContext *getDeviceContext() const { return device.get(); }
  /// Waits for what is queued; reports what failed, and prints what kernels
  /// have printed.
  Status synchronize();
  /// Where device code finds a place in a tree; fails without a device.
  Status deviceAddress(const Tree &tree, int64_t offset, void *&address);

  //===--------------------------------------------------------------------===//
  // Storage
  //===--------------------------------------------------------------------===//

  /// `sparse` describes the sparse levels, those above before those below.
  Status addTree(std::string name, int64_t bytes, TreePtr &tree,
                 std::vector<SparseInfo> sparse = {});
  /// Frees the storage and forgets the fields. Handles stay safe to use and
  /// report that the tree is gone.
  Status destroyTree(const std::string &name);
  TreePtr findTree(const std::string &name) const;
  int64_t numTrees() const { return static_cast<int64_t>(trees.size()); }
  /// Kernels that may be launched.
  int64_t numKernels();
  int64_t reservedBytes() const { return reserved; }
  /// Memory of the active cells of all sparse trees.
  int64_t activeCellBytes() const {
    return sparseBytes.load(std::memory_order_relaxed);
  }

  /// Makes a cell of a sparse level active or inactive, or, for -1, all of them
  /// inactive. A tape that records does so again where it replays.
  Status setActive(const TreePtr &tree, int64_t level, int64_t cell,
                   bool isActive);

  Status addField(FieldInfo info, FieldPtr &field);
  /// Gives a field another adjoint than the one that it was declared with.
  Status setAdjoint(Field &field, const FieldPtr &adjoint);
  FieldPtr findField(const std::string &name) const;
  std::vector<FieldPtr> fields() const;

  /// The whole field from or to a row-major array of its own scalar type, of
  /// shape (shape..., element shape...).
  Status copyToHost(const Field &field, void *array);
  Status copyFromHost(Field &field, const void *array);
  Status fillF64(Field &field, double value);
  Status fillI64(Field &field, int64_t value);
  /// One component of one element, as Field::writeF64.
  Status writeF64(Field &field, const int64_t *index, int64_t component,
                  double value);
  Status writeI64(Field &field, const int64_t *index, int64_t component,
                  int64_t value);
  /// The elements at `count` index tuples, from an array of the type of the
  /// field; their cells become active.
  Status writeElements(Field &field, const int64_t *indices, int64_t count,
                       const void *values);
  /// Sets the adjoint fields that are dirty to zero; in forward mode the
  /// tangents of adjoints too. On behalf of a tape, all but those to which
  /// another thread has written and which the tape does not use.
  void clearGradients(const Tape *tape = nullptr);
  /// The same for the tangents that the calling thread has left.
  void clearTangents();
  /// Stores the zeros that sweeps have left to whoever looks at gradients. To
  /// be called before that is done past the fields.
  void settleZeros();

  //===--------------------------------------------------------------------===//
  // Launches
  //===--------------------------------------------------------------------===//

  KernelPtr createKernel(KernelInfo info);
  /// Which of them run.
  const RunningLaunches &running() const { return runningLaunches; }
  /// Launches and, where a tape records, records. `results` may be null for a
  /// kernel without results.
  Status launch(Kernel &kernel, const uint64_t *args, int64_t slots,
                uint64_t *results);
  /// Launches the adjoint with the arguments of the primal; never recorded. The
  /// adjoints of the elements that the primal stores are zero afterwards.
  Status launchAdjoint(Kernel &kernel, const uint64_t *args, int64_t slots);
  /// Runs a host program, which may launch kernels and open tapes.
  Status runHost(TaiKernelFn function, const std::vector<TreePtr> &trees,
                 HostModule &module, const uint64_t *args, uint64_t *results);
  /// Asks running launches to stop at their next safepoint; they fail with
  /// Interrupted. Safe in a signal handler. The request stands
  /// until clearInterrupt().
  void interrupt() {
    hot.interrupted.store(true, std::memory_order_relaxed);
    safepoint::request();
  }
  void clearInterrupt() {
    hot.interrupted.store(false, std::memory_order_relaxed);
  }

  //===--------------------------------------------------------------------===//
  // Tape
  //===--------------------------------------------------------------------===//

  /// Starts recording. `loss` may be null; losses can also be added later.
  Status beginTape(FieldPtr loss, bool clearGradients,
                   std::unique_ptr<Tape> &tape);
  /// The tape that records what the calling thread does, or null. Each thread
  /// may have one.
  Tape *recordingTape() const {
    return __builtin_expect(numRecording.load(std::memory_order_relaxed) != 0,
                            false)
               ? findRecording()
               : nullptr;
  }

  //===--------------------------------------------------------------------===//
  // What one sees
  //===--------------------------------------------------------------------===//

  /// Where printed lines go (one whole line a call, with its newline); the
  /// standard output by default.
  using Sink = std::function<void(std::string_view line)>;
  void setPrintSink(Sink sink);
  void print(std::string_view line);

  /// What ran while the profiler was on, longest total first. Waits for the
  /// device.
  std::vector<ProfileRow> profile();
  /// When it did, in no order. Events refer to rows of the runtime. `lost`:
  /// those for which there was no room.
  std::vector<TraceEvent> trace(int64_t &lost);
  void clearProfile();
  Counters counters() const;
  /// What was left out, and what was not; see docs/decisions/0008-skips.md.
  SkipCounters &skipCounters() { return skipCounts; }
  SkipAmounts skipAmounts() const;
  /// The same as a table to read, one line for each skip.
  std::string skipTable() const;

  //===--------------------------------------------------------------------===//
  // Other libraries
  //===--------------------------------------------------------------------===//

  /// Gives out the address of a field, on the device if there is one. Until the
  /// loan is over, what is read on the host may have been changed by others.
  /// Fails where an element has no even distance from the next along each
  /// dimension, and for sparse fields.
  Status lend(Field &field, LentField &lent);
  /// Others have written, or are about to write, to a field that is lent.
  /// Fails while a tape records, which would not know.
  Status noteOutsideWrite(Field &field);
  /// What is queued from now on waits for what another library has queued, and
  /// the other way round. The stream is one of CUDA, 0 for the default one;
  /// nothing happens without a device.
  Status waitForStream(uint64_t stream);
  Status letStreamWait(uint64_t stream);
  /// Memory of the device for what a caller keeps of arrays there.
  Status allocateOnDevice(int64_t bytes, void *&address);
  void freeOnDevice(void *address);
  /// Copies there, in the order of the launches; part of what is collected.
  Status copyOnDevice(void *to, const void *from, int64_t bytes);
  /// Whether kernels can use the address where they run on a device.
  bool isOnDevice(const void *address) const;

  //===--------------------------------------------------------------------===//
  // For the ABI functions and for bulk work on the host
  //===--------------------------------------------------------------------===//

  /// Into how many parts a loop is cut: of `n` iterations that take `cost`
  /// nanoseconds each, by the estimate of the compiler or as measured.
  int64_t partition(int64_t n, double cost, bool reduces);
  /// The same for a loop of a launch. Loops about which the estimate does not
  /// decide are measured.
  int64_t partition(Launch &launch, int64_t n, int64_t cost, bool reduces);
  /// Calls task(context, p) for p in [0, parts), on the workers; and `look`,
  /// unless that is null, now and then while it waits for them.
  void parallel(int64_t parts, void (*task)(void *context, int64_t part),
                void *context, void (*look)(void *context) = nullptr);
  /// Fails if there is no memory for that many cells more.
  Status checkActiveBytes(const SparseNode &node, int64_t cells) const;
  bool interruptRequested() const {
    return hot.interrupted.load(std::memory_order_relaxed);
  }
  int64_t memoryLimit() const { return limit; }
  /// True while a reverse sweep has called a function of the host.
  bool inReverseFunction() const { return getSweeping() != nullptr; }
  /// 0 for what the machine has. Trees that take more already stay.
  void setMemoryLimit(int64_t bytes);

private:
  friend class Tape;
  friend class GradientCheck;
  friend class AccessChecks;
  friend class TapeMemory;

  void freeTree(Tree &tree);
  /// Fails where an array shares memory with a field that the kernel uses:
  /// its code takes them for apart.
  Status checkLentFields(const Kernel &kernel, const uint64_t *args) const;
  void addMemory(SkipAmounts &amounts) const;
  Status checkPartners(const Field &added) const;
  void linkPartners(const FieldPtr &added);
  void storageChanged() {
    storageEpoch.fetch_add(1, std::memory_order_relaxed);
    updateLaunchState();
  }
  /// To be called whenever the state changes.
  void updateLaunchState();

  // FieldHolds.cpp
  Tape *findRecording() const;
  bool isForwardHere() const;
  void beginRecording(Tape &tape);
  void endRecording(Tape &tape);
  /// Notes that the tape uses a field. Fails where tapes of other threads use
  /// it so that one of the two would go wrong.
  Status hold(const Tape &tape, Field &field, HoldKind kind);
  Status noteHold(const Tape &tape, Field &field, HoldKind kind);
  void release(const Tape &tape, Field &field);
  /// Fails where the calling thread changes what a tape of another thread uses.
  Status checkHolds(const Kernel &kernel);
  Status checkAdjointHolds(const Kernel &kernel);
  Status checkHold(const Field &field, HoldKind kind) const;
  /// Fails where a launch of another thread, which began before the field was
  /// held, changes it so that a tape of this thread would go wrong.
  Status checkRunning(const Field &field, HoldKind kind);
  std::string describe(const Field &field) const;
  Status describeHold(const Field &field, HoldKind kind,
                      const Hold &other) const;
  /// The adjoint is what another thread has left, and no concern of a tape that
  /// does not use it.
  static bool isOfAnotherThread(const Field &adjoint);
  void takeOverTangents(const Kernel &kernel);
  /// Stands for the whole tree, where the activity of cells matters.
  FieldPtr firstOf(const Tree &tree) const;
  /// Adjoint fields that owe zeros: leaves them to who looks, or stores those
  /// that a launch may look at.
  void oweZeros(const FieldPtr &adjoint,
                std::shared_ptr<const OwedZeros> zeros);
  void settleZeros(const Kernel &kernel, const uint64_t *args);
  void forgetSettled();
  /// Finds out what the launches of a kernel that has been launched have in
  /// common.
  void prepare(Kernel &kernel);
  Status launchPrepared(Kernel &kernel, const uint64_t *args,
                        uint64_t *results);
  Status ready(Kernel &kernel);
  bool isReady(const Kernel &kernel) const;
  /// Whether there is nothing to do around the code of kernels.
  bool runsPlainly() const;
  static Status failureOf(Launch &launch, const Kernel &kernel);
  Status run(Launch &launch, Kernel &kernel, const uint64_t *args,
             uint64_t *results, uint64_t number) {
    if (isForward())
      return runTangent(launch, kernel, args, results, number);
    return runCode(launch, kernel, args, results, number);
  }
  Status runCode(Launch &launch, Kernel &kernel, const uint64_t *args,
                 uint64_t *results, uint64_t number);
  Status runBegun(Launch &launch, Kernel &kernel, const uint64_t *args,
                  uint64_t *results, uint64_t number);
  Status runTangent(Launch &launch, Kernel &kernel, const uint64_t *args,
                    uint64_t *results, uint64_t number);
  int32_t runTimed(Launch &launch, Kernel &kernel, TaiKernelFn function);
  /// `given`: what the loops of the primal over sparse levels went over; null
  /// for what is active now.
  Status runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                    const uint64_t *args, uint64_t number,
                    const LoopLists *given);
  /// `isPlain`: for a launch that no tape makes.
  Launch *acquireLaunch(bool isPlain = false);
  Launch *takeLaunch();
  void releaseLaunch(Launch *launch);

  /// Fails where a running kernel uses the tree.
  Status checkUnused(const Tree &tree);
  WorkerPool &workers();
  void fillWith(Field &field, const void *scalarBytes);
  void copyIn(Field &field, const void *array);
  /// Changes a field on behalf of the host: a tape that records hears of it.
  Status change(const HostWrite &write);
  void perform(const HostWrite &write);
  Status activateFor(const HostWrite &write);
  bool isPartner(const Field &field) const;
  /// Makes those cells of a sparse field active in which an array of all its
  /// elements holds something else than zero.
  Status activateNonzero(Field &field, const void *array);
  /// The same for the active cells of a sparse field.
  void fillActive(Field &field, const void *scalarBytes);
  void copyInActive(Field &field, const void *array);
  template <typename Data, typename Move>
  void forEachRow(const Field &field, Data *data, const Move &move);

  /// Of fields that have memory on a device: do it there, if that is the better
  /// place for it.
  bool copyFromDevice(const Field &field, void *array);
  bool copyToDevice(Field &field, const void *array);
  bool fillOnDevice(Field &field, const void *scalarBytes);
  /// Around the code of a kernel.
  Status enterDevice(Launch &launch, Kernel &kernel);
  Status loadOnDevice(Kernel &kernel, uint64_t epoch);
  void leaveDevice(Launch &launch);
  /// What calls could not say themselves.
  void noteFailure(Status status);
  Status takeDeviceFailure() {
    return __builtin_expect(device != nullptr, false) ? takeNoted()
                                                      : Status::success();
  }
  Status takeNoted();

  /// What each launch looks at, side by side: after a call of a driver little
  /// else is in the caches.
  static constexpr uint64_t neverPrepared = UINT64_MAX;
  struct alignas(64) Hot {
    /// The epoch of the storage where launches that have been prepared go their
    /// short way, and never while a tape records, for example.
    std::atomic<uint64_t> state{1};
    std::atomic<uint64_t> launches{0};
    /// As in the options.
    uint64_t seed = 0;
    /// The thread that has launched first has a launch of its own, for which it
    /// needs no atomic operation.
    std::atomic<const void *> thread{nullptr};
    std::atomic<Launch *> launch{nullptr};
    bool isTaken = false;
    std::atomic<bool> interrupted{false};
  } hot;

  Options opts;
  KeptBlockSizes blockSizes;
  int numThreads;
  int64_t limit;
  int64_t reserved = 0;
  std::atomic<int64_t> sparseBytes{0};
  uint64_t treesMade = 0;
  std::unordered_map<std::string, TreePtr> trees;
  std::unordered_map<std::string, FieldPtr> fieldsByName;
  std::vector<FieldPtr> fieldList;
  /// Taken to change the list, and to read it where others may: launches do not
  /// wait for other calls.
  mutable std::mutex fieldsMutex;
  /// Adjoint fields that may owe zeros, under `launchMutex`; and whether there
  /// are any.
  std::vector<FieldPtr> owing;
  std::atomic<bool> owesAny{false};
  bool owesZeros() const {
    return __builtin_expect(owesAny.load(std::memory_order_acquire), false);
  }
  /// Kernels that may be launched, to find those that were.
  std::vector<std::weak_ptr<Kernel>> kernelList;
  size_t kernelsToKeep = 64;
  /// Raised when a tree goes or an adjoint comes: kernels then look again.
  std::atomic<uint64_t> storageEpoch{1};

  /// Shared with what lies on it.
  std::shared_ptr<DeviceContext> device;
  /// Tapes that there are.
  std::vector<Tape *> tapes;
  /// Sets of kernels, hashed, in which tapes have looked for gradients that get
  /// lost, and what they have said.
  std::unordered_set<size_t> sequencesSeen;
  std::unordered_set<std::string> cutsSaid;
  /// Of forward mode, if somebody wants to know.
  std::unique_ptr<TangentFlows> tangentFlows;

  std::unique_ptr<ForkGuard> forkGuard;
  std::unique_ptr<WorkerPool> pool;
  std::mutex poolMutex;
  std::atomic<WorkerPool *> currentPool{nullptr};

  std::atomic<Launch *> spareLaunch{nullptr};
  std::vector<std::unique_ptr<Launch>> launches;
  std::vector<Launch *> freeLaunches;
  RunningLaunches runningLaunches;
  std::mutex launchMutex;
  std::atomic<int64_t> inlineCredit{0};

  struct Recording {
    uint64_t thread;
    Tape *tape;
  };
  std::vector<Recording> recordings;
  /// Of them, and of the holds of all fields.
  mutable std::mutex recordingMutex;
  std::atomic<int> numRecording{0};
  /// Changes whenever recordings do; no two runtimes have the same.
  std::atomic<uint64_t> recordingVersion{0};
  /// Since no tape recorded last, several have at a time.
  std::atomic<bool> recordsTogether{false};
  /// Tapes that hold fields.
  std::atomic<int> numHolding{0};
  /// Threads in forward mode.
  std::atomic<int> numForward{0};
  std::mutex stateMutex;
  /// The tape whose sweep has called a function of the host, and the thread.
  Tape *sweeping = nullptr;
  std::atomic<const void *> sweepThread{nullptr};
  Tape *getSweeping() const {
    return sweepThread.load(std::memory_order_relaxed) ==
                   __builtin_thread_pointer()
               ? sweeping
               : nullptr;
  }
  bool fusesLaunches = true;
  /// Stamps of tapes and of their plans.
  uint64_t stamps = 0;

  /// Shared with the device.
  std::shared_ptr<Profiler> profiler = std::make_shared<Profiler>();
  void collectTimes();
  struct AtomicCounters {
    std::atomic<int64_t> forks{0}, inlineLoops{0};
  } counts;
  SkipCounters skipCounts;

  std::mutex printMutex;
  Sink sink;
};

/// Bytes of the elements of a field that are active.
int64_t bytesInUse(const Field &field);
/// Makes the system provide memory that it would provide when it is written.
void commitPages(char *begin, int64_t bytes);

/// A function that compiled code may call, for the symbol table of a JIT.
struct RuntimeSymbol {
  const char *name;
  void *address;
};
/// All functions of Abi.h.
std::vector<RuntimeSymbol> runtimeSymbols();

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_RUNTIME_H
