//===- BlockTrial.h - Autotuning of block sizes -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The best block size depends on registers, caches and the order in which
// blocks access memory, so it is measured. Early launches of a function over
// many iterations try several sizes in turn, between events; some launches
// later, when the events have passed, the fastest size is chosen. The size
// affects results only through the order of float additions; there are no
// trials in deterministic mode.
//
// The best size depends on the number of iterations: launches are classified by
// it, and each class has its own trial. Results are stored for later processes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_DEVICE_BLOCKTRIAL_H
#define TAI_RUNTIME_DEVICE_BLOCKTRIAL_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Device/KeptChoices.h"
#include <functional>
#include <map>
#include <mutex>
#include <vector>

namespace mlir::tai::runtime {

class BlockTrial {
public:
  struct Size {
    unsigned threads;
    /// The maximum number of blocks in the grid of the launch.
    unsigned mostBlocks;
  };
  static constexpr unsigned kAnyBlocks = ~0u >> 1;
  /// Launches over fewer iterations than this are not timed to choose a block
  /// size.
  static constexpr int64_t kLeastIterations = int64_t(1) << 20;

  /// `sizes`: the candidates, of which the first is the default. `found` is
  /// called with the size that is chosen.
  explicit BlockTrial(std::vector<Size> sizes,
                      std::function<void(Size)> found = nullptr)
      : sizes(std::move(sizes)), found(std::move(found)) {}

  /// Chooses sizes[size] without trials.
  void choose(size_t size);

  bool hasEnded();
  /// The chosen block size; the default size until the trials have ended.
  Size best();
  /// Makes one launch: calls `launch` with the block size to try or to use.
  Status run(Device &device, int64_t iterations,
             const std::function<Status(Size)> &launch);

private:
  struct Timed {
    size_t size;
    int64_t iterations;
    std::unique_ptr<DeviceEvent> begin, end;
  };

  Status time(Device &device, int64_t iterations, size_t size,
              const std::function<Status(Size)> &launch);
  void decide(Device &device);

  std::mutex mutex;
  std::vector<Size> sizes;
  std::function<void(Size)> found;
  std::vector<Timed> timed;
  size_t launches = 0, chosen = 0;
  bool isOver = false;
};

/// The timing trials of a device function, by number of iterations.
class BlockTrials {
public:
  /// `key` identifies the function and the device in `kept`; empty if results
  /// are not stored.
  BlockTrials(std::vector<BlockTrial::Size> sizes, KeptChoices kept = {},
              std::string key = "")
      : sizes(std::move(sizes)), kept(std::move(kept)), key(std::move(key)) {}

  /// Returns the trial for launches with this number of iterations, rounded up
  /// to a power of two.
  BlockTrial &of(int64_t iterations);

private:
  std::unique_ptr<BlockTrial> make(unsigned sizeClass) const;
  std::optional<size_t> parse(const std::string &bytes) const;

  std::vector<BlockTrial::Size> sizes;
  KeptChoices kept;
  std::string key;
  std::mutex mutex;
  std::map<unsigned, std::unique_ptr<BlockTrial>> trials;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_DEVICE_BLOCKTRIAL_H
