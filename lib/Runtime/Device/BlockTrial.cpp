//===- BlockTrial.cpp - Autotuning of block sizes -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/BlockTrial.h"
#include <limits>

using namespace mlir::tai::runtime;

/// The number of trials of each block size, of which the quickest counts.
static constexpr size_t kRounds = 3;
/// Launches between the last trial and the decision: as a rule, the device has
/// finished the trials by then, so that no wait is needed.
static constexpr size_t kLaunchesBetween = 8;
/// A block size replaces the default size if its time is below this share of
/// the default's time.
static constexpr double kGain = 0.97;

bool BlockTrial::hasEnded() {
  std::lock_guard<std::mutex> lock(mutex);
  return isOver;
}

BlockTrial::Size BlockTrial::best() {
  std::lock_guard<std::mutex> lock(mutex);
  return sizes[chosen];
}

void BlockTrial::choose(size_t size) {
  std::lock_guard<std::mutex> lock(mutex);
  chosen = size;
  isOver = true;
}

Status BlockTrial::time(Device &device, int64_t iterations, size_t size,
                        const std::function<Status(Size)> &launch) {
  Timed now{size, iterations, nullptr, nullptr};
  // A candidate block size that cannot be timed is launched without a
  // measurement.
  bool isTimed = device.record(now.begin).ok();
  Status status = launch(sizes[size]);
  isTimed = isTimed && status.ok() && device.record(now.end).ok();
  if (isTimed)
    timed.push_back(std::move(now));
  else
    isOver = true;
  return status;
}

void BlockTrial::decide(Device &device) {
  isOver = true;
  std::vector<double> quickest(sizes.size(),
                               std::numeric_limits<double>::infinity());
  bool isKnown = !timed.empty() && device.wait(*timed.back().end).ok();
  for (const Timed &one : timed) {
    int64_t ns = 0;
    isKnown = isKnown && device.elapsed(*one.begin, *one.end, ns).ok();
    if (isKnown)
      quickest[one.size] =
          std::min(quickest[one.size], static_cast<double>(ns) /
                                           static_cast<double>(one.iterations));
  }
  timed.clear();
  if (!isKnown)
    return;
  double bar = quickest[0] * kGain;
  for (size_t i = 1; i < sizes.size(); ++i)
    if (quickest[i] < bar) {
      chosen = i;
      bar = quickest[i];
    }
  if (found)
    found(sizes[chosen]);
}

Status BlockTrial::run(Device &device, int64_t iterations,
                       const std::function<Status(Size)> &launch) {
  std::unique_lock<std::mutex> lock(mutex);
  // The first launch of the function is not timed, since it has one-time costs.
  size_t number = launches++;
  size_t trials = kRounds * sizes.size();
  if (!isOver && number >= 1 && number <= trials)
    return time(device, iterations, (number - 1) % sizes.size(), launch);
  if (!isOver && number >= trials + kLaunchesBetween)
    decide(device);
  Size size = sizes[chosen];
  lock.unlock();
  return launch(size);
}

//===----------------------------------------------------------------------===//
// Results that are stored for later processes
//===----------------------------------------------------------------------===//

/// The text that stands for a block size in stored results; without the number
/// of resident blocks, which depends on the device.
static std::string describe(BlockTrial::Size size) {
  return std::to_string(size.threads) +
         (size.mostBlocks == BlockTrial::kAnyBlocks ? " any" : "");
}

std::optional<size_t> BlockTrials::parse(const std::string &bytes) const {
  for (size_t i = 0; i < sizes.size(); ++i)
    if (bytes == describe(sizes[i]))
      return i;
  return std::nullopt;
}

std::unique_ptr<BlockTrial> BlockTrials::make(unsigned sizeClass) const {
  if (key.empty() || !kept.load || !kept.store)
    return std::make_unique<BlockTrial>(sizes);
  // The key contains the candidate sizes, because among other candidates
  // another size may win.
  std::string full = "block size\n" + key + "\n" + std::to_string(sizeClass);
  for (BlockTrial::Size size : sizes)
    full += "\n" + describe(size);
  auto trial = std::make_unique<BlockTrial>(
      sizes, [store = kept.store, full](BlockTrial::Size size) {
        store(full, describe(size));
      });
  if (std::optional<std::string> bytes = kept.load(full))
    if (std::optional<size_t> size = parse(*bytes))
      trial->choose(*size);
  return trial;
}

BlockTrial &BlockTrials::of(int64_t iterations) {
  unsigned sizeClass = 0;
  while (sizeClass < 62 && (int64_t(1) << sizeClass) < iterations)
    ++sizeClass;
  std::lock_guard<std::mutex> lock(mutex);
  std::unique_ptr<BlockTrial> &trial = trials[sizeClass];
  if (!trial)
    trial = make(sizeClass);
  return *trial;
}
