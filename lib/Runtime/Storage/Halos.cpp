//===- Halos.cpp - Halos that are current ---------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/Halos.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// The oldest halos beyond this number are fetched again.
static constexpr size_t kMost = 256;

static bool haveOneForm(const Halo &a, const Halo &b) {
  return a.extents == b.extents && a.strides == b.strides;
}

template <typename Predicate> void Halos::removeIf(Predicate isGone) {
  if (isEmpty.load(std::memory_order_acquire))
    return;
  std::lock_guard<std::mutex> lock(mutex);
  known.erase(std::remove_if(known.begin(), known.end(), isGone), known.end());
  isEmpty.store(known.empty(), std::memory_order_release);
}

bool Halos::isCurrent(const Halo &halo) const {
  std::lock_guard<std::mutex> lock(mutex);
  return std::any_of(known.begin(), known.end(), [&](const Halo &other) {
    return other.field == halo.field && other.address == halo.address &&
           haveOneForm(other, halo) && other.before >= halo.before &&
           other.after >= halo.after;
  });
}

void Halos::add(Halo halo) {
  std::lock_guard<std::mutex> lock(mutex);
  if (known.size() == kMost)
    known.erase(known.begin());
  known.push_back(std::move(halo));
  isEmpty.store(false, std::memory_order_release);
}

void Halos::removeChanged(const Halo &part) {
  removeIf([&](const Halo &halo) {
    return halo.field == part.field &&
           (halo.address == part.address || !haveOneForm(halo, part));
  });
}

void Halos::remove(const void *field) {
  removeIf([&](const Halo &halo) { return halo.field == field; });
}

void Halos::removeAll() {
  removeIf([](const Halo &) { return true; });
}
