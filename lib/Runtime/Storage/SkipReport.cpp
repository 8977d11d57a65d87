//===- SkipReport.cpp - Counters of skips as text -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Most counters are incremented where something is skipped. The amount of
// memory in use is queried from the operating system.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/TreeStore.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <sys/mman.h>
#include <unistd.h>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

/// The bytes of the resident pages, among the pages that [begin, end) lies on.
static int64_t usedBytes(const char *begin, const char *end) {
  static const int64_t page = sysconf(_SC_PAGESIZE);
  auto first = reinterpret_cast<intptr_t>(begin) / page * page;
  auto last = (reinterpret_cast<intptr_t>(end) + page - 1) / page * page;
  int64_t used = 0;
  unsigned char present[4096];
  while (first < last) {
    int64_t pages = std::min<int64_t>(sizeof(present), (last - first) / page);
    if (mincore(reinterpret_cast<void *>(first),
                static_cast<size_t>(pages * page), present) != 0)
      return used;
    used += page * std::count_if(present, present + pages,
                                 [](unsigned char state) { return state & 1; });
    first += pages * page;
  }
  return used;
}

int64_t mlir::tai::runtime::bytesInUse(const Field &field) {
  int64_t elements = field.numElements();
  if (const SparseNode *node = field.sparseNode())
    elements = elements / node->numCells() * node->numActive();
  return elements * field.numComponents() * byteSize(field.scalar());
}

/// The addresses of the first byte of a field and after its last byte.
static std::pair<const char *, const char *> getSpan(const Field &field) {
  const FieldLayout &layout = field.layout();
  int64_t first = layout.placeOffset;
  int64_t last = first + (field.numComponents() - 1) * layout.componentStride +
                 byteSize(layout.scalar);
  for (const std::vector<LayoutLevel> &levels : layout.indices)
    for (const LayoutLevel &level : levels)
      last += (level.extent - 1) * level.stride;
  const char *base = field.tree().base();
  return {base + first, base + last};
}

void TreeStore::countMemory(SkipAmounts &amounts) const {
  auto at = [&](SkipCount counter) -> int64_t & {
    return amounts[static_cast<unsigned>(counter)];
  };
  for (const auto &[name, tree] : treesByName) {
    at(SkipCount::BytesReserved) += tree->bytes();
    // Trees above this size have too many pages to ask about each one.
    constexpr int64_t largest = int64_t(64) << 30;
    at(SkipCount::BytesUsed) +=
        tree->bytes() <= largest
            ? usedBytes(tree->base(), tree->base() + tree->bytes())
            : tree->activeCellBytes();
  }
  std::vector<std::pair<const char *, const char *>> spans;
  for (const FieldPtr &field : fieldList) {
    if (!field->isAdjoint())
      continue;
    if (!field->sparseNode()) {
      spans.push_back(getSpan(*field));
      continue;
    }
    at(SkipCount::GradientBytesReserved) += field->numElements() *
                                            field->numComponents() *
                                            byteSize(field->scalar());
    at(SkipCount::GradientBytesUsed) += bytesInUse(*field);
  }
  // Gradients whose cells are shared are interleaved, so spans of memory that
  // overlap are merged.
  std::sort(spans.begin(), spans.end());
  for (size_t i = 0; i < spans.size();) {
    auto [begin, end] = spans[i];
    for (++i; i < spans.size() && spans[i].first <= end; ++i)
      end = std::max(end, spans[i].second);
    at(SkipCount::GradientBytesReserved) += end - begin;
    at(SkipCount::GradientBytesUsed) +=
        std::min<int64_t>(usedBytes(begin, end), end - begin);
  }
}

//===----------------------------------------------------------------------===//
// Counters
//===----------------------------------------------------------------------===//

std::string mlir::tai::runtime::skipTable(SkipSet skips,
                                          const SkipAmounts &amounts) {
  std::string text;
  for (unsigned s = 0; s < kNumSkips; ++s) {
    auto skip = static_cast<Skip>(s);
    std::string line = kSkips[s].name;
    line.resize(std::max<size_t>(line.size(), 22), ' ');
    line += skips.has(skip) ? "on   " : "off  ";
    const char *separator = "";
    for (unsigned i = 0; i < kNumSkipCounts; ++i) {
      if (kSkipCounts[i].skip != skip)
        continue;
      std::string name = kSkipCounts[i].name;
      bool isBytes = name.rfind("bytes", 0) == 0;
      std::replace(name.begin(), name.end(), '_', ' ');
      line += separator + name + ' ' +
              (isBytes ? formatBytes(amounts[i]) : std::to_string(amounts[i]));
      separator = ", ";
    }
    text += line + '\n';
  }
  return text;
}
