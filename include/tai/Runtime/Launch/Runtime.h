//===- Runtime.h - The runtime of one context -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A Runtime owns the storage, the workers and the launch state of one context,
// each as a separate part, which does its own work: callers ask the part. The
// methods of Runtime need several parts, or change options. There is no global
// state: a process may have several runtimes.
//
// Threads: launches may come from several threads at once, and each thread may
// record a tape. All other calls belong to one thread at a time.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_RUNTIME_H
#define TAI_RUNTIME_LAUNCH_RUNTIME_H

#include "tai/Runtime/Host/ExportedBuffer.h"
#include "tai/Runtime/Launch/Launcher.h"
#include "tai/Runtime/Launch/ShadowLog.h"
#include "tai/Runtime/Threads/Safepoint.h"

namespace mlir::tai::runtime {

class Tape;

struct Counters {
  int64_t launches = 0;
  int64_t forks = 0;       // parallel loops that used workers
  int64_t inlineLoops = 0; // loops too small to be worth a fork
  int64_t recorded = 0;
  int64_t replayed = 0;
  int64_t skipped = 0;
  int64_t clearedFields = 0;
};

class Runtime final : public ::TaiRuntime {
public:
  explicit Runtime(Options options = {})
      : opts(options), workerThreads(opts.threads), account(opts.memoryLimit),
        trees(account, state, {workerThreads, opts.skips, skipCounts}),
        deviceHost({printer, account, opts.skips, skipCounts}),
        tapes(state, trees), fieldCopies(workerThreads, deviceHost),
        fieldGradients(trees, tapes, fieldCopies, opts.skips, skipCounts),
        hostWrites(trees, account, tapes, fieldCopies, deviceHost, fieldHalos),
        launches(*this, {opts, trees, state, tapes, fieldGradients, fieldCopies,
                         deviceHost, skipCounts}) {
    trees.setMirrors(&deviceHost);
    tapes.setLaunches(&launches.running());
    if (opts.instruments.profiler)
      state.beginSpecial();
  }
  Runtime(const Runtime &) = delete;
  Runtime &operator=(const Runtime &) = delete;

  //===--------------------------------------------------------------------===//
  // Parts
  //===--------------------------------------------------------------------===//

  Workers &workers() { return workerThreads; }
  TreeStore &store() { return trees; }
  const TreeStore &store() const { return trees; }
  MemoryAccount &memory() { return account; }
  DeviceHost &devices() { return deviceHost; }
  Recordings &recordings() { return tapes; }
  Gradients &gradients() { return fieldGradients; }
  FieldCopies &copies() { return fieldCopies; }
  HostWrites &writes() { return hostWrites; }
  Launcher &launcher() { return launches; }
  Halos &halos() { return fieldHalos; }
  ShadowLog &shadowLog() { return shadowSites; }
  /// The counters of skipped and unskipped work; see
  /// docs/decisions/0008-skips.md.
  SkipCounters &skipCounters() { return skipCounts; }

  //===--------------------------------------------------------------------===//
  // Options of the runtime; all may change at any time between launches
  //===--------------------------------------------------------------------===//

  const Options &options() const { return opts; }
  bool skips(Skip skip) const { return opts.skips.has(skip); }
  int threads() const { return workerThreads.threads(); }
  void setThreads(int threads) {
    opts.threads = threads;
    workerThreads.setThreads(threads);
  }
  void setTriesBlocks(bool on) { opts.triesBlocks = on; }
  void setDebug(bool on) { opts.instruments.debug = on; }
  /// Turns shadow execution on or off. Fails if the address space for shadow
  /// values cannot be reserved.
  Status setShadow(bool on) {
    opts.instruments.shadow = on;
    return on ? shadow::reserve() : Status::success();
  }
  void setProfiler(bool on) {
    if (on != opts.instruments.profiler)
      on ? state.beginSpecial() : state.endSpecial();
    opts.instruments.profiler = on;
    deviceHost.setProfiler(on);
  }
  /// True if device code should be compiled with source locations, for
  /// profilers.
  bool wantsPlaces() const {
    return opts.instruments.profiler || deviceHost.wantsPlaces();
  }
  void setSkips(SkipSet skips) {
    opts.skips = skips;
    // Invalidates prepared launches.
    state.storageChanged();
  }
  /// Set the block size of GPU launches, or its upper limit, for kernels that
  /// are loaded afterwards.
  void setBlockThreads(int threads) { opts.blockThreads = threads; }
  void setMostBlockThreads(int threads) { opts.mostBlockThreads = threads; }
  void setSeed(uint64_t seed) {
    opts.seed = seed;
    launches.setSeed(seed);
  }

  /// In forward mode, every launch of the calling thread runs the kernel's
  /// variant with tangents; so do launches that a tape replays, and adjoints.
  void setForward(bool on) {
    tapes.setForward(on);
    hostWrites.setWatcher(nullptr);
    launches.forgetTangents();
  }
  void followTangents(const std::vector<FieldPtr> &inputs) {
    hostWrites.setWatcher(nullptr);
    hostWrites.setWatcher(launches.followTangents(inputs));
  }

  //===--------------------------------------------------------------------===//
  // Device
  //===--------------------------------------------------------------------===//

  /// Runs kernels on the device from now on, with at most `memoryLimit` bytes
  /// there (0 for all of its memory). Fails once there are trees.
  Status useDevice(std::unique_ptr<Device> device, int64_t memoryLimit = 0) {
    if (!trees.trees().empty())
      return Status::failure(StatusCode::Usage,
                             "the device must be chosen before the first field "
                             "is made");
    launches.dropLaunches();
    state.storageChanged();
    deviceHost.use(std::move(device), memoryLimit);
    return Status::success();
  }
  Status synchronize() { return deviceHost.synchronize(); }
  /// hasNotedFailure: true if a device call that could not return its failure
  /// has failed since the last takeFailure(), which returns the failure.
  bool hasNotedFailure() const {
    return __builtin_expect(deviceHost.isThere(), false) &&
           deviceHost.hasNoted();
  }
  Status takeFailure() { return deviceHost.takeFailure(); }
  Status deviceAddress(const Tree &tree, int64_t offset, void *&address) {
    settleZeros(&tree);
    return deviceHost.addressOf(tree, offset, address);
  }

  //===--------------------------------------------------------------------===//
  // Trees and fields
  //===--------------------------------------------------------------------===//

  Status destroyTree(const std::string &name) {
    if (TreePtr tree = trees.findTree(name)) {
      trees.setClosing(*tree, true);
      if (Status status = launches.running().checkUnused(*tree, trees);
          !status) {
        trees.setClosing(*tree, false);
        return status;
      }
      fieldGradients.forget(*tree);
      // Another tree may get the same addresses.
      fieldHalos.removeAll();
    }
    return trees.destroyTree(name);
  }

  //===--------------------------------------------------------------------===//
  // Host accesses to fields; see HostWrites, FieldCopies and Gradients
  //===--------------------------------------------------------------------===//

  /// Stores the zeros that reverse sweeps have deferred; see Gradients::settle.
  /// Must be called before memory is accessed other than through fields.
  void settleZeros(const Gradients::Uses &uses = nullptr) {
    fieldGradients.settle(uses);
  }
  void settleZeros(const Tree *tree) {
    settleZeros([=](const FieldPtr &field) { return &field->tree() == tree; });
  }
  Status exportField(Field &field, ExportedField &exported) {
    // Another library may read the memory of the whole tree from now on, so
    // deferred zeros of all fields in the tree are stored first.
    settleZeros(&field.tree());
    return ExportedBuffer::make(field, deviceHost, exported);
  }

  //===--------------------------------------------------------------------===//
  // Launches and tapes
  //===--------------------------------------------------------------------===//

  Status launch(Kernel &kernel, const uint64_t *args, int64_t slots,
                uint64_t *results) {
    return launches.launch(kernel, args, slots, results);
  }
  Status launchAdjoint(Kernel &kernel, const uint64_t *args, int64_t slots) {
    return launches.launchAdjoint(kernel, args, slots);
  }
  void interrupt() {
    launches.interrupt();
    safepoint::request();
  }

  /// Starts recording on the calling thread. `loss` may be null; losses can
  /// also be added later. See Tape.h.
  Status beginTape(FieldPtr loss, bool clearGradients,
                   std::unique_ptr<Tape> &tape);
  /// True while a reverse sweep of this thread calls a function of the host.
  bool inReverseFunction() const { return tapes.sweeping() != nullptr; }
  uint64_t storageEpoch() const { return state.epoch(); }

  //===--------------------------------------------------------------------===//
  // Output and statistics
  //===--------------------------------------------------------------------===//

  void setPrintSink(Printer::Sink sink) { printer.setSink(std::move(sink)); }
  void print(std::string_view line) { printer.print(line); }

  /// The profile of all work so far, longest total time first. Waits for the
  /// device.
  std::vector<ProfileRow> profile() {
    return deviceHost.collectedProfiler().rows();
  }
  /// Time stamps of profiled work, unordered. Events refer to rows of
  /// profile(). `lost` receives the number of events that were dropped.
  std::vector<TraceEvent> trace(int64_t &lost) {
    return deviceHost.collectedProfiler().events(lost);
  }
  void clearProfile() { deviceHost.collectedProfiler().clear(); }
  Counters counters() const {
    return {static_cast<int64_t>(
                launches.numbers().load(std::memory_order_relaxed)),
            workerThreads.numForks(),
            workerThreads.numInline(),
            skipCounts.get(SkipCount::TapeRecorded),
            skipCounts.get(SkipCount::TapeReplayed),
            skipCounts.get(SkipCount::TapeSkipped),
            skipCounts.get(SkipCount::FieldsCleared)};
  }
  SkipAmounts skipAmounts() const {
    SkipAmounts amounts;
    for (unsigned i = 0; i < kNumSkipCounts; ++i)
      amounts[i] = skipCounts.get(static_cast<SkipCount>(i));
    trees.countMemory(amounts);
    return amounts;
  }
  /// The skip amounts as a text table, with a line for each skip.
  std::string skipTable() const {
    return runtime::skipTable(opts.skips, skipAmounts());
  }

private:
  Options opts;
  Printer printer;
  SkipCounters skipCounts;
  ShadowLog shadowSites;
  Workers workerThreads;
  MemoryAccount account;
  LaunchState state;
  TreeStore trees;
  DeviceHost deviceHost;
  Recordings tapes;
  FieldCopies fieldCopies;
  Gradients fieldGradients;
  Halos fieldHalos;
  HostWrites hostWrites;
  Launcher launches;
};

/// A function that compiled code may call, for the symbol table of a JIT.
struct RuntimeSymbol {
  const char *name;
  void *address;
};
/// The list of all functions of Abi.h.
std::vector<RuntimeSymbol> runtimeSymbols();

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_RUNTIME_H
