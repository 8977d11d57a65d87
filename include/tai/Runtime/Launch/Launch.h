//===- Launch.h - The state of one launch -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Every TaiFrame passed to a kernel is the base of a Launch, because only the
// runtime creates frames. Launches are reused with their scratch memory, so
// that a launch allocates nothing.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_LAUNCH_H
#define TAI_RUNTIME_LAUNCH_LAUNCH_H

#include "tai/Runtime/Launch/LoopTimes.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Mirror/DeviceContext.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include "tai/Runtime/Sparse/LoopLists.h"

namespace mlir::tai::runtime {

/// A bump allocator whose memory is freed all at once.
class Arena {
public:
  Arena() = default;
  ~Arena();
  Arena(const Arena &) = delete;
  Arena &operator=(const Arena &) = delete;

  /// Allocates `bytes` bytes (a multiple of 64) aligned to 64, or returns null.
  /// The first `dirtyBytes` of them may be non-zero. Thread-safe.
  char *allocate(int64_t bytes, int64_t &dirtyBytes);
  /// Notes that allocated bytes are zero, and stay zero until they are
  /// allocated again; allocate() does not count them as dirty then.
  /// Thread-safe.
  void markZero(const char *address, int64_t bytes);
  /// Frees all allocated memory. One block of the total size is kept for the
  /// next launch.
  void reset();
  bool used() const { return anyUsed; }

private:
  struct Block {
    char *address;
    int64_t size;
    int64_t used;
    int64_t touched;            // bytes that have ever been allocated
    int64_t zeroBegin, zeroEnd; // the part of it that is known to be zero again
  };
  static bool map(int64_t bytes, Block &block);
  static void unmap(const Block &block);

  bool anyUsed = false;
  std::mutex mutex;
  std::vector<Block> blocks;
  int64_t wanted = 0;
};

/// The state of a host program during its launch: trees, tape and kernels.
struct HostState;

struct Launch : TaiFrame {
  explicit Launch(TaiRuntime &runtime) {
    trees = nullptr;
    args = nullptr;
    results = nullptr;
    this->runtime = &runtime;
    seed = 0;
    launch = 0;
    tick = 0;
    zeroAdjoints = 0;
  }

  Runtime &owner() const { return *static_cast<Runtime *>(runtime); }
  /// Sets the failure of the launch, unless it has one.
  void fail(Status status);
  /// Fails the launch with "out of memory", without allocating a status.
  void failWithoutMemory() noexcept;
  /// Resets the launch object after an exception has ended its launch.
  void recover() noexcept;
  bool hasFailed() const { return failed.load(std::memory_order_relaxed); }
  /// Passes a safepoint of the launching thread, or of a worker. False if the
  /// launch must stop.
  bool passSafepoint() {
    return __builtin_expect(__atomic_load_n(&tick, __ATOMIC_RELAXED) ==
                                safepoint::now(),
                            true) ||
           look();
  }
  /// The slow path of a safepoint, taken after a tick of the clock.
  bool look();
  Status takeFailure();
  /// Returns the number of partitions of a loop. A loop is timed if its
  /// estimated cost is too close to a threshold to decide this number.
  int64_t partition(int64_t n, int64_t cost, bool reduces);
  /// Returns scratch memory to which a failed launch may write, if its own
  /// memory could not be allocated.
  void *sink(int64_t bytes);

  /// The cells that a loop over a sparse level visits; valid until the kernel
  /// returns. Fails the launch if it is an adjoint and the cells of its primal
  /// are not known.
  const std::vector<int64_t> &cellsFor(SparseNode &node);
  /// Returns the cells of cellsFor() together with the cells that cellsFor()
  /// leaves out because their incoming adjoints are zero.
  const std::vector<int64_t> &visitedCells(SparseNode &node);
  /// Returns the cells of visitedCells as a shared list; null after a failure.
  ActiveListPtr visitedList(SparseNode &node);
  /// Returns, for adjoints, the active cells that the primal's loops over the
  /// level visited.
  const LoopLists::Entry *findGiven(SparseNode &node);
  /// Returns those cells of cellsFor that are within `reach` of a cell whose
  /// incoming adjoints are not all zero.
  const std::vector<int64_t> &gatheredCellsFor(SparseNode &node, int64_t reach);

  // Read by each launch.
  std::atomic<bool> failed{false};
  /// True if the launch is neither recorded nor part of a sweep: other threads
  /// then check only the fields that its kernel changes.
  std::atomic<bool> isUnrecorded{true};
  /// The kernel that this launch runs, or null, and the thread that launched
  /// it; see RunningLaunches.cpp.
  std::atomic<const Kernel *> running{nullptr};
  std::atomic<const void *> thread{nullptr};
  bool isOfThisThread() const {
    return thread.load(std::memory_order_relaxed) == __builtin_thread_pointer();
  }
  /// Marks the kernel as running. State of the runtime that the caller has read
  /// before this call must be read again.
  void begin(const Kernel &kernel) {
    running.store(&kernel, std::memory_order_release);
    std::atomic_signal_fence(std::memory_order_seq_cst);
  }
  void end() { running.store(nullptr, std::memory_order_release); }
  /// The loop times of the running kernel, or null; and the entry of the loop
  /// that is being timed.
  LoopTimes *loopTimes = nullptr;
  LoopTimes::Entry *measured = nullptr;
  /// The launch's device state; its `code` is null if the launch runs on the
  /// CPU.
  std::unique_ptr<DeviceLaunch> onDevice;
  /// The active cells that the loops of this launch visited.
  LoopLists loops;
  Arena arena;
  /// For launches of adjoints: the cells that the loops of the primal launch
  /// visited, and the name of the primal kernel.
  const LoopLists *given = nullptr;
  const std::string *primalName = nullptr;
  /// For adjoints: the loops that can be skipped in some cells, and the lists
  /// of cells that remain to be visited.
  const std::vector<SkippableLoop> *flags = nullptr;
  std::vector<std::unique_ptr<std::vector<int64_t>>> filtered;
  /// Lists of active cells that were copied from a device for this launch.
  std::vector<ActiveListPtr> fetched;
  const std::vector<int64_t> &
  withoutZeroAdjoints(const SparseNode &node,
                      const std::vector<int64_t> &cells);
  std::mutex failureMutex;
  Status failure;
  HostState *host = nullptr;
  /// Memory for the results of a kernel when the caller passes none.
  std::vector<uint64_t> unwanted;
  std::vector<std::pair<void *, size_t>> sinks;
  ~Launch();
  void noteSink(void *memory, size_t size);
  void freeSinks();
};

/// Calls `body` for compiled code, through whose frames no exception can pass.
/// If memory runs out, fails the launch and returns `otherwise`.
template <typename Result, typename Body>
Result orFail(TaiFrame *frame, Result otherwise, const Body &body) noexcept {
  try {
    return body();
  } catch (...) {
    static_cast<Launch *>(frame)->failWithoutMemory();
    return otherwise;
  }
}
template <typename Body>
void orFail(TaiFrame *frame, const Body &body) noexcept {
  orFail(frame, 0, [&] {
    body();
    return 0;
  });
}

inline HoldKind holdKindOf(AccessKind kind) {
  switch (kind) {
  case AccessKind::Read:
    return HoldKind::Read;
  case AccessKind::Accumulate:
    return HoldKind::Add;
  case AccessKind::Write:
    return HoldKind::Write;
  }
  __builtin_unreachable();
}

/// True if an access, in a launch with the arguments `args`, may touch an
/// element of `zeros`.
bool mayAlias(const OwedZeros &zeros, const Access &access,
              const uint64_t *args);
/// Finds the elements of a box that a launch with the arguments `args` stores,
/// clipped to the field; false if there are none.
bool findElements(const StoredBox &box, const Field &field,
                  const uint64_t *args, OwedZeros::Box &elements);

inline Launch &launchOf(TaiFrame *frame) {
  return *static_cast<Launch *>(frame);
}

inline int32_t Kernel::callDirectly(Launch &launch) {
  launch.trees = bound.bases.data();
  launch.loopTimes = &loopTimes;
  return function.load(std::memory_order_relaxed)(&launch);
}

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_LAUNCH_H
