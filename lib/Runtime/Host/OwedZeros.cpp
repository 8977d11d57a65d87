//===- OwedZeros.cpp - Zeros that whoever looks stores --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "OwedZeros.h"
#include "../Mirror/Slabs.h"
#include "tai/Runtime/Launch/Runtime.h"
#include <algorithm>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Elements
//===----------------------------------------------------------------------===//

void OwedZeros::add(Box box, int64_t dimension) {
  if (!boxes.empty() && dimension >= 0) {
    auto d = static_cast<size_t>(dimension);
    Box &last = boxes.back();
    bool isBeside = true;
    for (size_t i = 0; i < box.lower.size(); ++i)
      isBeside &= i == d || (box.lower[i] == last.lower[i] &&
                             box.upper[i] == last.upper[i]);
    if (isBeside && box.lower[d] <= last.upper[d] &&
        last.lower[d] <= box.upper[d]) {
      last.lower[d] = std::min(last.lower[d], box.lower[d]);
      last.upper[d] = std::max(last.upper[d], box.upper[d]);
      return;
    }
  }
  boxes.push_back(std::move(box));
}

bool OwedZeros::meets(const Access &access, const uint64_t *args) const {
  if (!access.fixed)
    return true;
  auto d = static_cast<size_t>(access.fixed->dimension);
  int64_t position =
      access.fixed->evaluate(args) - access.field->firstIndex(int64_t(d));
  return std::any_of(boxes.begin(), boxes.end(), [&](const Box &box) {
    return box.lower[d] <= position && position < box.upper[d];
  });
}

bool mlir::tai::runtime::findElements(const StoredBox &box, const Field &field,
                                      const uint64_t *args,
                                      OwedZeros::Box &elements) {
  for (const StoredBox::Range &loop : box.loops)
    if (loop.lower.evaluate(args) >= loop.upper.evaluate(args))
      return false;
  elements.lower.clear();
  elements.upper.clear();
  for (size_t d = 0; d < box.ranges.size(); ++d) {
    int64_t first = field.firstIndex(static_cast<int64_t>(d));
    int64_t lower = box.ranges[d].lower.evaluate(args) - first;
    int64_t upper = box.ranges[d].upper.evaluate(args) - first;
    lower = std::max<int64_t>(lower, 0);
    upper = std::min(upper, field.shape()[d]);
    if (lower >= upper)
      return false;
    elements.lower.push_back(lower);
    elements.upper.push_back(upper);
  }
  return true;
}

//===----------------------------------------------------------------------===//
// Zeros
//===----------------------------------------------------------------------===//

/// Zeroes a box. Of its dimensions, from the last on, those that it has whole
/// make up runs of elements that follow one another.
static void storeBox(const Field &field, const OwedZeros::Box &box) {
  int rank = field.rank();
  Slabs all(field, -1);
  int run = rank;
  int64_t runElements = 1;
  while (run > 0) {
    --run;
    int64_t count = box.upper[run] - box.lower[run];
    runElements *= count;
    if (count != field.shape()[run])
      break;
  }
  std::vector<int64_t> index = box.lower;
  while (true) {
    int64_t first = 0;
    for (int d = 0; d < rank; ++d)
      first = first * field.shape()[d] + index[d];
    all.zero(first, runElements);
    int d = run - 1;
    while (d >= 0 && ++index[d] == box.upper[d]) {
      index[d] = box.lower[d];
      --d;
    }
    if (d < 0)
      return;
  }
}

void OwedZeros::store(const Field &field) const {
  for (const Box &box : boxes)
    storeBox(field, box);
}

void Field::storeZeros() const {
  // Of two threads that look, the second one waits until they are there.
  static std::mutex storing;
  std::lock_guard<std::mutex> lock(storing);
  if (owed && valid())
    owed->store(*this);
  owed = nullptr;
}

//===----------------------------------------------------------------------===//
// Who looks
//===----------------------------------------------------------------------===//

void Runtime::oweZeros(const FieldPtr &adjoint,
                       std::shared_ptr<const OwedZeros> zeros) {
  if (!adjoint->valid() || !adjoint->dirty())
    return;
  adjoint->settleZeros();
  // Tangents go along. Others look at the memory of a field that is lent as
  // they like.
  bool forward = isForward();
  Field *dual = forward ? adjoint->dual() : nullptr;
  if (dual && dual->valid())
    zeros->store(*dual);
  if (forward || adjoint->tree().isLent()) {
    zeros->store(*adjoint);
    return;
  }
  std::lock_guard<std::mutex> lock(launchMutex);
  adjoint->oweZeros(std::move(zeros));
  owing.push_back(adjoint);
  owesAny.store(true, std::memory_order_release);
  updateLaunchState();
}

void Runtime::forgetSettled() {
  owing.erase(
      std::remove_if(owing.begin(), owing.end(),
                     [](const FieldPtr &field) { return !field->owesZeros(); }),
      owing.end());
  owesAny.store(!owing.empty(), std::memory_order_release);
  updateLaunchState();
}

void Runtime::settleZeros(const Kernel &kernel, const uint64_t *args) {
  std::lock_guard<std::mutex> lock(launchMutex);
  for (const Access &access : kernel.summary())
    if (const OwedZeros *zeros = access.field->owesZeros())
      if (zeros->meets(access, args))
        access.field->settleZeros();
  forgetSettled();
}

void Runtime::settleZeros() {
  if (!owesZeros())
    return;
  std::lock_guard<std::mutex> lock(launchMutex);
  for (const FieldPtr &field : owing)
    field->settleZeros();
  forgetSettled();
}
