//===- AccessChecks.cpp - Checked accesses under a tape -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/AccessChecks.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/Runtime.h"
#include <algorithm>
#include <limits>
#include <sys/mman.h>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::accesslog;

AccessChecks::Shadow::~Shadow() {
  if (words)
    munmap(words, count * sizeof(int32_t));
}

Status AccessChecks::findShadow(Field &field, const Shadow *&result) {
  Shadow &shadow = shadows[&field];
  result = &shadow;
  if (shadow.words)
    return Status::success();
  size_t count = 0;
  void *memory = MAP_FAILED;
  if (!__builtin_mul_overflow(
          static_cast<size_t>(field.numElements()),
          static_cast<size_t>(field.numComponents() * kShadowWords), &count) &&
      count <= SIZE_MAX / sizeof(int32_t))
    memory = mmap(nullptr, std::max<size_t>(count, 1) * sizeof(int32_t),
                  PROT_READ | PROT_WRITE,
                  MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED)
    return Status::failure(StatusCode::Memory,
                           "out of memory: the accesses to field '" +
                               field.name() +
                               "' cannot be checked, which would need some "
                               "words for each element of its whole box");
  shadow.words = static_cast<int32_t *>(memory);
  shadow.count = std::max<size_t>(count, 1);
  return Status::success();
}

Status AccessChecks::run(Launch &launch, Kernel &kernel, const uint64_t *args,
                         uint64_t *results, uint64_t number) {
  if (runtime.recordings().isForward())
    return Status::failure(StatusCode::Usage,
                           "a tape cannot check the access rules in forward "
                           "mode; check them in a run of its own");
  CheckedKernel *checked = nullptr;
  Status status = kernel.resolveChecked(checked);
  if (!status)
    return status;
  if (!checked || checked->accesses.empty())
    return runtime.launcher().run(launch, kernel, args, results, number);
  int64_t count = static_cast<int64_t>(checked->accesses.size());
  if (nextBase + count > std::numeric_limits<int32_t>::max())
    return Status::failure(StatusCode::Usage,
                           "the tape has too many launches to check their "
                           "accesses");
  slots.assign(args, args + kernel.argSlots());
  auto addArray = [&](const void *data, size_t size) {
    slots.push_back(reinterpret_cast<uint64_t>(data));
    slots.push_back(size);
  };
  for (const FieldPtr &field : checked->fields) {
    const Shadow *shadow = nullptr;
    status = findShadow(*field, shadow);
    if (!status)
      return status;
    addArray(shadow->words, shadow->count);
  }
  log.assign(static_cast<size_t>((count + 1) * kLogWords), 0);
  addArray(log.data(), log.size());
  slots.push_back(static_cast<uint64_t>(nextBase));
  ranges.push_back({nextBase, checked, static_cast<int64_t>(ranges.size())});
  nextBase += count;
  status = runtime.launcher().run(launch, *checked->kernel, slots.data(),
                                  results, number);
  if (status)
    collect(ranges.back());
  return status;
}

AccessPlace AccessChecks::getPlace(int64_t id) const {
  auto after =
      std::partition_point(ranges.begin(), ranges.end(),
                           [&](const Range &range) { return range.base < id; });
  // The access with number `id` is unknown if another thread has not recorded
  // its range of numbers yet.
  if (id <= 0 || after == ranges.begin())
    return {"", -1, AccessKind::Write, "", 0, 0};
  const Range &range = *std::prev(after);
  const CheckedAccess &access = range.kernel->accesses[id - range.base - 1];
  return {range.kernel->kernel->name(),
          range.launch,
          access.kind,
          access.file,
          access.line,
          access.column};
}

/// True for kinds of violations between two iterations of one loop.
static bool isRace(int64_t kind) {
  return kind == static_cast<int64_t>(ViolationKind::Race) ||
         kind == static_cast<int64_t>(ViolationKind::EarlyRead);
}

void AccessChecks::collect(const Range &range) {
  int64_t count = static_cast<int64_t>(range.kernel->accesses.size());
  for (int64_t ordinal = 1; ordinal <= count; ++ordinal) {
    const int64_t *words = log.data() + ordinal * kLogWords;
    int64_t kept = std::min(words[0], kLogEntries);
    std::vector<const int64_t *> entries;
    for (int64_t i = 0; i < kept; ++i)
      if (!racesOnly || isRace(words[1 + 3 * i + 2]))
        entries.push_back(words + 1 + 3 * i);
    total += racesOnly ? static_cast<int64_t>(entries.size()) : words[0];
    // Threads report in any order; sort the reports by element.
    std::sort(entries.begin(), entries.end(),
              [](const int64_t *a, const int64_t *b) { return a[1] < b[1]; });
    for (const int64_t *entry : entries) {
      if (static_cast<int64_t>(found.size()) >= limit)
        break;
      const Field &field = *range.kernel->accesses[ordinal - 1].field;
      Violation violation;
      violation.kind = static_cast<ViolationKind>(entry[2]);
      violation.field = field.name();
      int64_t rest = entry[1], components = field.numComponents();
      violation.component = components > 1 ? rest % components : -1;
      rest /= components;
      violation.indices.resize(field.shape().size());
      for (int64_t dim = field.rank() - 1; dim >= 0; --dim) {
        violation.indices[dim] =
            rest % field.shape()[dim] + field.firstIndex(dim);
        rest /= field.shape()[dim];
      }
      violation.access = getPlace(range.base + ordinal);
      violation.earlier = getPlace(entry[0]);
      found.push_back(std::move(violation));
    }
  }
}
