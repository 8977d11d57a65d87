//===- SparseCopies.cpp - Copies of whole sparse fields -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Operations on all active cells of a field, distributed to worker threads if
// there are many. Inactive cells are zero and are not changed.
//
//===----------------------------------------------------------------------===//

#include "../Mirror/CellElements.h"
#include "../Mirror/Mirror.h"
#include "tai/Runtime/Host/FieldCopies.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

/// Calls body(cell) for all active cells of the field, on the workers.
template <typename Body>
void FieldCopies::forEachActiveCell(const Field &field, int64_t bytesOfCell,
                                    const Body &body) const {
  constexpr int64_t bytesPerPart = 128 << 10;
  ActiveListPtr list = field.sparseNode()->list();
  const std::vector<int64_t> &cells = list->cells;
  auto count = static_cast<int64_t>(cells.size());
  struct Job {
    const Body &body;
    const int64_t *cells;
    int64_t count, parts;
  } job{body, cells.data(), count,
        workers.partsOf(count * bytesOfCell, bytesPerPart)};
  workers.parallel(
      job.parts,
      [](void *context, int64_t part) {
        const Job &job = *static_cast<Job *>(context);
        int64_t end = job.count * (part + 1) / job.parts;
        for (int64_t i = job.count * part / job.parts; i < end; ++i)
          job.body(job.cells[i]);
      },
      &job);
}

void FieldCopies::fillActive(Field &field, const void *scalarBytes) const {
  CellElements elements(field);
  if (Mirror *mirror = field.tree().mirror())
    if (mirror->sparse()->fillActive(field, elements, scalarBytes))
      return;
  auto scalar = static_cast<size_t>(byteSize(field.scalar()));
  const auto *bytes = static_cast<const char *>(scalarBytes);
  bool zero = std::all_of(bytes, bytes + scalar, [](char b) { return !b; });
  std::vector<char> pattern;
  if (!zero)
    for (int64_t at = 0; at < elements.bytes(); at += int64_t(scalar))
      pattern.insert(pattern.end(), bytes, bytes + scalar);
  forEachActiveCell(field, elements.bytes(), [&](int64_t cell) {
    if (zero)
      elements.clear(cell);
    else
      elements.store(cell, pattern.data());
  });
}

void FieldCopies::copyInActive(Field &field, const void *array) const {
  (void)field.writable();
  CellElements elements(field);
  auto scalar = static_cast<size_t>(byteSize(field.scalar()));
  int64_t components = field.numComponents();
  int64_t stride = field.layout().componentStride;
  const auto *host = static_cast<const char *>(array);
  forEachActiveCell(field, elements.bytes(), [&](int64_t cell) {
    char *base = elements.base(cell);
    int64_t first = elements.firstNumber(cell);
    for (const CellElements::Element &element : elements.elements()) {
      const char *from =
          host + (first + element.number) * components * int64_t(scalar);
      for (int64_t c = 0; c < components; ++c)
        std::memcpy(base + element.offset + c * stride,
                    from + c * int64_t(scalar), scalar);
    }
  });
}
