//===- Launch.h - The state of one launch -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Every frame that a kernel sees is the base of a Launch: the runtime alone
// makes frames. Launches are reused, and with them their scratch memory, so
// that a launch allocates nothing.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_LAUNCH_LAUNCH_H
#define TAI_LIB_RUNTIME_LAUNCH_LAUNCH_H

#include "../Mirror/DeviceContext.h"
#include "../Mirror/OwedZeros.h"
#include "tai/Runtime/Launch/LoopTimes.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Sparse/LoopLists.h"

namespace mlir::tai::runtime {

/// Memory that is handed out piece by piece and taken back all at once.
class Arena {
public:
  Arena() = default;
  ~Arena();
  Arena(const Arena &) = delete;
  Arena &operator=(const Arena &) = delete;

  /// `bytes` (a multiple of 64) bytes aligned to 64, or null. `dirtyBytes` are
  /// those at the start that may hold something else than zeros. Any thread.
  char *allocate(int64_t bytes, int64_t &dirtyBytes);
  /// Takes everything back. What is kept is one block of the size that was
  /// needed, so that the next launch finds it in one piece.
  void reset();
  bool used() const { return anyUsed; }

private:
  struct Block {
    char *address;
    int64_t size;
    int64_t used;
    int64_t touched; // bytes that have ever been handed out
  };
  static bool map(int64_t bytes, Block &block);
  static void unmap(const Block &block);

  bool anyUsed = false;
  std::mutex mutex;
  std::vector<Block> blocks;
  int64_t wanted = 0;
};

/// What a host program has open.
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
  }

  Runtime &owner() const { return *static_cast<Runtime *>(runtime); }
  /// Keeps the first failure.
  void fail(Status status);
  bool hasFailed() const { return failed.load(std::memory_order_relaxed); }
  /// A safepoint of the thread that launched, or of one that helps it. False
  /// where the launch is to end.
  bool passSafepoint() {
    return __builtin_expect(__atomic_load_n(&tick, __ATOMIC_RELAXED) ==
                                safepoint::now(),
                            true) ||
           look();
  }
  /// The same once there has been a tick.
  bool look();
  Status takeFailure();
  /// Into how many parts a loop is cut. Loops about which the estimate does not
  /// decide are measured.
  int64_t partition(int64_t n, int64_t cost, bool reduces);
  /// Scratch memory that a launch which has failed may write to.
  void *sink(int64_t bytes);

  /// The cells that a loop over a sparse level goes over; kept until the kernel
  /// returns. Fails where the launch is an adjoint and its primal has none to
  /// give.
  const std::vector<int64_t> &cellsFor(SparseNode &node);
  /// The same with those whose incoming adjoints are zero.
  const std::vector<int64_t> &visitedCells(SparseNode &node);
  /// As a list; null after a failure.
  ActiveListPtr visitedList(SparseNode &node);
  /// Of adjoints: what the loops of the primal over the level went over.
  const LoopLists::Entry *findGiven(SparseNode &node);
  /// Of those: the ones with others around that are not vain.
  const std::vector<int64_t> &gatheredCellsFor(SparseNode &node, int64_t reach);

  // What each launch looks at.
  std::atomic<bool> failed{false};
  /// Whether other threads know of it by the fields that its kernel changes
  /// alone: it is neither recorded nor part of a sweep.
  std::atomic<bool> isPlain{true};
  /// The kernel whose code runs, or null, and the thread that launched it; see
  /// RunningLaunches.cpp.
  std::atomic<const Kernel *> running{nullptr};
  std::atomic<const void *> thread{nullptr};
  bool isOfThisThread() const {
    return thread.load(std::memory_order_relaxed) == __builtin_thread_pointer();
  }
  /// The state of the runtime has to be looked at after `begin`.
  void begin(const Kernel &kernel) {
    running.store(&kernel, std::memory_order_release);
    std::atomic_signal_fence(std::memory_order_seq_cst);
  }
  void end() { running.store(nullptr, std::memory_order_release); }
  /// Of the kernel that runs, or null; and the loop to be measured, once its
  /// partition has been asked for.
  LoopTimes *loopTimes = nullptr;
  LoopTimes::Entry *measured = nullptr;
  /// What it has on the device; `DeviceLaunch::code` is null where it runs on
  /// the CPU.
  std::unique_ptr<DeviceLaunch> onDevice;
  /// What the loops of this launch went over.
  LoopLists loops;
  Arena arena;
  /// Of adjoints: what those of the primal did, and its name.
  const LoopLists *given = nullptr;
  const std::string *primalName = nullptr;
  /// Of adjoints: which cells their loops may leave out, and what is left.
  const std::vector<ZeroAdjoints> *flags = nullptr;
  std::vector<std::unique_ptr<std::vector<int64_t>>> filtered;
  /// Lists that were brought from a device.
  std::vector<ActiveListPtr> fetched;
  const std::vector<int64_t> &withoutVain(const SparseNode &node,
                                          const std::vector<int64_t> &cells);
  std::mutex failureMutex;
  Status failure;
  HostState *host = nullptr;
  /// For kernels with results when the caller wants none.
  std::vector<uint64_t> unwanted;
  std::vector<std::pair<void *, size_t>> sinks;
  ~Launch();
  void freeSinks();
};

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

/// Whether a launch may touch one of the elements by this access.
bool mayAlias(const OwedZeros &zeros, const Access &access,
              const uint64_t *args);
/// The elements of a box in a launch with these arguments, those within the
/// field; false where there are none.
bool findElements(const StoredBox &box, const Field &field,
                  const uint64_t *args, OwedZeros::Box &elements);

inline Launch &launchOf(TaiFrame *frame) {
  return *static_cast<Launch *>(frame);
}

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_LAUNCH_LAUNCH_H
