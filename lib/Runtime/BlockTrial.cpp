//===- BlockTrial.cpp - How large blocks should be ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "BlockTrial.h"
#include <limits>

using namespace mlir::tai::runtime;

/// How often each size is tried, of which the quickest counts.
static constexpr size_t kRounds = 3;
/// Launches between the last trial and the decision: the device has come there
/// by then as a rule, so that nobody waits.
static constexpr size_t kLaunchesBetween = 8;
/// What another size must be quicker by than the usual one.
static constexpr double kGain = 0.97;

bool BlockTrial::hasEnded() {
  std::lock_guard<std::mutex> lock(mutex);
  return isOver;
}

BlockTrial::Size BlockTrial::best() {
  std::lock_guard<std::mutex> lock(mutex);
  return sizes[chosen];
}

Status BlockTrial::time(Device &device, int64_t iterations, size_t size,
                        const std::function<Status(Size)> &launch) {
  Timed now{size, iterations, nullptr, nullptr};
  // What cannot be timed is launched all the same.
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
}

Status BlockTrial::run(Device &device, int64_t iterations,
                       const std::function<Status(Size)> &launch) {
  std::unique_lock<std::mutex> lock(mutex);
  // The first launch pays for what is there afterwards.
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
