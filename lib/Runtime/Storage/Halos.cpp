//===- Halos.cpp - Halos that are current ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/Halos.h"
#include <algorithm>
#include <atomic>
#include <mutex>

using namespace mlir::tai::runtime;
using halos::Halo;

/// The oldest halos beyond this number are fetched again.
static constexpr size_t kMost = 256;

/// Guards the list. `isEmpty` tells writes of the host in programs without a
/// mesh that there is nothing to remove.
static std::mutex mutex;
static std::vector<Halo> known;
static std::atomic<bool> isEmpty{true};
static int64_t leftOut = 0;

static bool haveOneForm(const Halo &a, const Halo &b) {
  return a.extents == b.extents && a.strides == b.strides;
}

template <typename Predicate> static void removeIf(Predicate isGone) {
  if (isEmpty.load(std::memory_order_acquire))
    return;
  std::lock_guard<std::mutex> lock(mutex);
  known.erase(std::remove_if(known.begin(), known.end(), isGone), known.end());
  isEmpty.store(known.empty(), std::memory_order_release);
}

bool halos::isCurrent(const Halo &halo) {
  std::lock_guard<std::mutex> lock(mutex);
  bool found = std::any_of(known.begin(), known.end(), [&](const Halo &other) {
    return other.field == halo.field && other.address == halo.address &&
           haveOneForm(other, halo) && other.before >= halo.before &&
           other.after >= halo.after;
  });
  leftOut += found;
  return found;
}

void halos::add(Halo halo) {
  std::lock_guard<std::mutex> lock(mutex);
  if (known.size() == kMost)
    known.erase(known.begin());
  known.push_back(std::move(halo));
  isEmpty.store(false, std::memory_order_release);
}

void halos::removeChanged(const Halo &part) {
  removeIf([&](const Halo &halo) {
    return halo.field == part.field &&
           (halo.address == part.address || !haveOneForm(halo, part));
  });
}

void halos::remove(const void *field) {
  removeIf([&](const Halo &halo) { return halo.field == field; });
}

void halos::removeAll() {
  removeIf([](const Halo &) { return true; });
}

int64_t halos::numLeftOut() {
  std::lock_guard<std::mutex> lock(mutex);
  return leftOut;
}
