//===- OwedZeros.cpp - Zeros that are stored on demand --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/OwedZeros.h"
#include "tai/Runtime/Mirror/Slabs.h"
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

bool OwedZeros::contains(int64_t dimension, int64_t position) const {
  auto d = static_cast<size_t>(dimension);
  return std::any_of(boxes.begin(), boxes.end(), [&](const Box &box) {
    return box.lower[d] <= position && position < box.upper[d];
  });
}

//===----------------------------------------------------------------------===//
// Zeros
//===----------------------------------------------------------------------===//

/// Zeroes the elements of a field in a box. The trailing dimensions that the
/// box covers as a whole form runs of consecutive elements.
static void storeBox(const Field &field, const OwedZeros::Box &box) {
  int rank = field.rank();
  Slabs all(field);
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
