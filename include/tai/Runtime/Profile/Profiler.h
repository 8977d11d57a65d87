//===- Profiler.h - How long kernels take -----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Sums of the times of kernels, of their loops on a device and of the device's
// copies and fills, and each of them on a line of time that the host and the
// device share. What the device did is added after it has done it; see
// DeviceWatch.h.
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

/// Times of one kernel while the profiler is on.
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

/// A kernel that ran on the CPU; a function of one on a device; what a device
/// did with memory.
enum class ProfileKind { Host, Device, Memory };

struct ProfileRow {
  std::string kernel;
  KernelTimes times;
  ProfileKind kind = ProfileKind::Host;
  /// "file:line:column", or empty.
  std::string place = {};
  /// Of the fields that a launch touches: what it reads, and what it writes,
  /// once each. Negative where that is not known.
  int64_t bytes = -1;
  DeviceFunctionFacts facts = {};
  /// Of the last launch; occupancy: of the threads that the device can hold,
  /// how many of its blocks can be there at a time. Negative for not known.
  unsigned blocks = 0, threads = 0;
  double occupancy = -1;
};

/// Something that took time, in nanoseconds since the runtime was made.
struct TraceEvent {
  /// Of the row that it counts for. Lives as long as the profiler.
  const ProfileRow *row;
  bool onDevice;
  /// Threads of the host are numbered as they come.
  int thread;
  int64_t startNs, durationNs;
  /// On a device: when the host asked for it.
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

  /// The row of this name, made if need be. Items stay when times are cleared.
  Item find(ProfileKind kind, const std::string &name,
            const std::string &place);
  /// What the launches of a kernel touch, for the functions that it has on a
  /// device. Where there are several, who touches what is not known.
  void noteBytes(const std::vector<std::string> &functions, int64_t bytes);
  void noteFacts(Item item, const DeviceFunctionFacts &facts,
                 const LaunchShape &shape, double occupancy);
  /// Counts a time, and keeps the event.
  void count(Item item, const TraceEvent &event);
  /// Keeps the event alone.
  void keep(Item item, const TraceEvent &event);
  /// The number of the calling thread.
  int thread();

  /// Rows that count something, longest total first.
  std::vector<ProfileRow> rows() const;
  /// In no order. `lost`: those for which there was no room.
  std::vector<TraceEvent> events(int64_t &lost) const;
  void clear();

private:
  void keepLocked(Item item, const TraceEvent &event);

  /// Enough for a minute of short kernels, in 64 MiB.
  static constexpr size_t mostEvents = size_t(1) << 20;

  std::chrono::steady_clock::time_point origin =
      std::chrono::steady_clock::now();
  std::atomic<bool> on{false};
  mutable std::mutex mutex;
  /// References to them stay as they are.
  std::deque<ProfileRow> items;
  std::map<std::pair<ProfileKind, std::string>, Item> known;
  std::unordered_map<std::string, int64_t> bytesOf;
  std::vector<TraceEvent> kept;
  int64_t lostEvents = 0;
  std::unordered_map<std::thread::id, int> threads;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_PROFILE_PROFILER_H
