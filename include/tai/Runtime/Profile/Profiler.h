//===- Profiler.h - Times of kernels and device work ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Total times of kernels, of their loops on a device and of the device's copies
// and fills, and single events on a time line common to host and device. Device
// work is added after it has completed; see DeviceWatch.h.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROFILE_PROFILER_H
#define TAI_RUNTIME_PROFILE_PROFILER_H

#include "tai/Runtime/Device/Device.h"
#include <atomic>
#include <chrono>
#include <deque>
#include <map>
#include <mutex>
#include <thread>
#include <unordered_map>

namespace mlir::tai::runtime {

/// The times that one kernel took while the profiler was on.
struct KernelTimes {
  int64_t launches = 0;
  int64_t totalNs = 0;
  int64_t minNs = 0;
  int64_t maxNs = 0;

  void add(int64_t ns) {
    minNs = launches ? std::min(minNs, ns) : ns;
    maxNs = std::max(maxNs, ns);
    totalNs += ns;
    ++launches;
  }
};

/// Kinds of profiled work. Host: a kernel on the CPU. Device: a function of a
/// kernel on a device. Memory: a copy or fill on a device.
enum class ProfileKind { Host, Device, Memory };

struct ProfileRow {
  std::string kernel;
  KernelTimes times;
  ProfileKind kind = ProfileKind::Host;
  /// "file:line:column", or empty.
  std::string place = {};
  /// The bytes that a launch of the kernel reads plus the bytes that it writes,
  /// each element counted once. Negative if not known.
  int64_t bytes = -1;
  DeviceFunctionFacts facts = {};
  /// The grid of the last launch: blocks, and threads in a block. Occupancy:
  /// resident threads of the function as a fraction of the threads that the
  /// device can hold; negative if not known.
  unsigned blocks = 0, threads = 0;
  double occupancy = -1;
};

/// An event on the time line, in nanoseconds since the runtime was created.
struct TraceEvent {
  /// The profile row to which the event's time was added. Valid as long as the
  /// profiler.
  const ProfileRow *row;
  bool onDevice;
  /// The number of the host thread, in the order of first use.
  int thread;
  int64_t startNs, durationNs;
  /// For an event on a device: the time at which the host queued the work.
  int64_t queuedNs;
  unsigned blocks, threads;
};

class Profiler {
public:
  using Item = size_t;

  bool isOn() const { return on.load(std::memory_order_relaxed); }
  void setOn(bool wanted) { on.store(wanted, std::memory_order_relaxed); }
  int64_t now() const {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(
               std::chrono::steady_clock::now() - origin)
        .count();
  }

  /// Finds the profile row of this kind and name, and creates it if there is
  /// none. The result remains valid when times are cleared.
  Item find(ProfileKind kind, const std::string &name,
            const std::string &place);
  /// Sets, for the profile row of a kernel's device function, the bytes that a
  /// launch reads and writes. For a kernel with several device functions, the
  /// bytes of each are set to unknown.
  void noteBytes(const std::vector<std::string> &functions, int64_t bytes);
  void noteFacts(Item item, const DeviceFunctionFacts &facts,
                 const LaunchShape &shape, double occupancy);
  /// Adds the event's time to the profile row `item`, and stores the event for
  /// the trace.
  void count(Item item, const TraceEvent &event);
  /// Stores an event for the trace, without adding its time to a profile row.
  void keep(Item item, const TraceEvent &event);
  /// The profiler's number for the calling thread, in the order of first use.
  int thread();

  /// The profile rows of work that has run, longest total time first.
  std::vector<ProfileRow> rows() const;
  /// Returns all events of the trace, unordered. `lost` receives the number of
  /// dropped events.
  std::vector<TraceEvent> events(int64_t &lost) const;
  void clear();

private:
  void keepLocked(Item item, const TraceEvent &event);

  /// The most events that a trace keeps: enough for a minute of short kernels,
  /// in 64 MiB.
  static constexpr size_t mostEvents = size_t(1) << 20;

  std::chrono::steady_clock::time_point origin =
      std::chrono::steady_clock::now();
  std::atomic<bool> on{false};
  mutable std::mutex mutex;
  /// The profile rows, in a deque so that references to rows remain valid.
  std::deque<ProfileRow> items;
  std::map<std::pair<ProfileKind, std::string>, Item> known;
  std::unordered_map<std::string, int64_t> bytesOf;
  std::vector<TraceEvent> kept;
  int64_t lostEvents = 0;
  std::unordered_map<std::thread::id, int> threads;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_PROFILE_PROFILER_H
