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

#include "tai/Runtime/Host/FieldCopies.h"
#include "tai/Runtime/Mirror/CellElements.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

/// Calls body(cell) for all active cells of the field, on the workers. False if
/// the host has interrupted the loop.
template <typename Body>
bool FieldCopies::forEachActiveCell(const Field &field, int64_t bytesOfCell,
                                    Interrupts interrupts,
                                    const Body &body) const {
  ActiveListPtr list = field.sparseNode()->list();
  const std::vector<int64_t> &cells = list->cells;
  auto count = static_cast<int64_t>(cells.size());
  // A handler that a safepoint calls may destroy the tree during the copy; the
  // tree's memory stays until the copy ends.
  std::shared_ptr<void> memory = field.tree().sharedMemory();
  return runParts(count, count * bytesOfCell, interrupts,
                  [&](int64_t begin, int64_t end) {
                    for (int64_t i = begin; i < end; ++i)
                      body(cells[static_cast<size_t>(i)]);
                  });
}

bool FieldCopies::fillActive(Field &field, const void *scalarBytes,
                             Interrupts interrupts) const {
  CellElements elements(field);
  if (Mirror *mirror = field.tree().mirror())
    if (mirror->sparse()->fillActive(field, elements, scalarBytes))
      return true;
  auto scalar = static_cast<size_t>(byteSize(field.scalar()));
  const auto *bytes = static_cast<const char *>(scalarBytes);
  bool zero = std::all_of(bytes, bytes + scalar, [](char b) { return !b; });
  std::vector<char> pattern;
  if (!zero)
    for (int64_t at = 0; at < elements.bytes(); at += int64_t(scalar))
      pattern.insert(pattern.end(), bytes, bytes + scalar);
  return forEachActiveCell(field, elements.bytes(), interrupts,
                           [&](int64_t cell) {
                             if (zero)
                               elements.clear(cell);
                             else
                               elements.store(cell, pattern.data());
                           });
}

bool FieldCopies::copyInActive(Field &field, const void *array,
                               Interrupts interrupts) const {
  (void)field.writable();
  CellElements elements(field);
  auto scalar = static_cast<size_t>(byteSize(field.scalar()));
  int64_t components = field.numComponents();
  int64_t stride = field.layout().componentStride;
  const auto *host = static_cast<const char *>(array);
  return forEachActiveCell(
      field, elements.bytes(), interrupts, [&](int64_t cell) {
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
