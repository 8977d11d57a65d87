//===- BlockTrial.h - How large blocks should be ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// How many threads a block should have depends on registers, caches and the
// order in which blocks reach memory: it is measured. Early launches of a
// function over many iterations try several sizes in turn, with events around
// them; some launches later, when the device has come there, the quickest
// stays. Results do not depend on it but by the order of float additions, so
// that there are no trials in deterministic mode.
//
// What is best for a million iterations need not be for a hundred: launches of
// similar numbers of iterations have trials of their own. What they have found
// is kept for the next process, which then makes none.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_DEVICE_BLOCKTRIAL_H
#define TAI_LIB_RUNTIME_DEVICE_BLOCKTRIAL_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Device/KeptBlockSizes.h"
#include <functional>
#include <map>
#include <mutex>
#include <vector>

namespace mlir::tai::runtime {

class BlockTrial {
public:
  struct Size {
    unsigned threads;
    /// That many blocks of so many threads run at a time.
    unsigned mostBlocks;
  };
  static constexpr unsigned kAnyBlocks = ~0u >> 1;
  /// Launches over fewer iterations say little.
  static constexpr int64_t kLeastIterations = int64_t(1) << 20;

  /// The first is the one to take unless another is quicker. `found` is told
  /// what the trials have shown.
  explicit BlockTrial(std::vector<Size> sizes,
                      std::function<void(Size)> found = nullptr)
      : sizes(std::move(sizes)), found(std::move(found)) {}

  /// Takes this one of the sizes, without trials.
  void choose(size_t size);

  bool hasEnded();
  /// The best that is known.
  Size best();
  /// Makes one launch, which `launch` queues with the size that it is given.
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

/// The trials of a function.
class BlockTrials {
public:
  /// `key` says which function on which device this is; empty where nobody else
  /// knows.
  BlockTrials(std::vector<BlockTrial::Size> sizes, KeptBlockSizes kept = {},
              std::string key = "")
      : sizes(std::move(sizes)), kept(std::move(kept)), key(std::move(key)) {}

  /// Those of launches with as many iterations up to the next power of two.
  BlockTrial &of(int64_t iterations);

private:
  std::unique_ptr<BlockTrial> make(unsigned sizeClass) const;
  std::optional<size_t> parse(const std::string &bytes) const;

  std::vector<BlockTrial::Size> sizes;
  KeptBlockSizes kept;
  std::string key;
  std::mutex mutex;
  std::map<unsigned, std::unique_ptr<BlockTrial>> trials;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_DEVICE_BLOCKTRIAL_H
