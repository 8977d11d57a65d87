//===- AdjointHealth.cpp - Statistics of adjoints in a sweep --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "AdjointHealth.h"
#include "../TapeServices.h"
#include "tai/Runtime/Mirror/CellElements.h"
#include "tai/Runtime/Storage/Scalars.h"
#include <cmath>

using namespace mlir::tai::runtime;

static void examineElement(const Field &adjoint, const char *address,
                           RecordHealth &found) {
  for (int64_t c = 0; c < adjoint.numComponents(); ++c) {
    double value = loadF64(adjoint.scalar(),
                           address + c * adjoint.layout().componentStride);
    if (std::isnan(value)) {
      ++found.nans;
    } else if (std::isinf(value)) {
      ++found.infs;
    } else {
      found.maxAbs = std::max(found.maxAbs, std::fabs(value));
      found.sumSquares += value * value;
    }
  }
}

/// Examines the elements of a sparse adjoint at one position along a dimension,
/// like examineElements: only active cells have values.
static void examineCells(const Field &adjoint, int64_t dimension,
                         int64_t position, RecordHealth &found) {
  CellElements elements(adjoint);
  if (dimension >= 0 && !elements.separates(static_cast<int>(dimension)))
    dimension = -1;
  ActiveListPtr list = adjoint.sparseNode()->list();
  for (int64_t cell : list->cells)
    if (dimension < 0 ||
        elements.position(cell, static_cast<int>(dimension)) == position)
      for (const CellElements::Element &element : elements.elements())
        examineElement(adjoint, elements.base(cell) + element.offset, found);
}

/// Examines the elements of an adjoint at one position along a dimension, or
/// all elements if `dimension` is -1.
static void examineElements(const Field &adjoint, int64_t dimension,
                            int64_t position, RecordHealth &found) {
  int rank = adjoint.rank();
  std::vector<int64_t> index(rank), first(rank), last(rank);
  for (int d = 0; d < rank; ++d) {
    first[d] = adjoint.firstIndex(d) + (d == dimension ? position : 0);
    last[d] = d == dimension ? first[d]
                             : adjoint.firstIndex(d) + adjoint.shape()[d] - 1;
    if (last[d] < first[d])
      return;
  }
  index = first;
  const char *tree = adjoint.tree().readable();
  while (true) {
    examineElement(adjoint, tree + adjoint.elementOffset(index.data()), found);
    int d = rank - 1;
    while (d >= 0 && index[d] == last[d]) {
      index[d] = first[d];
      --d;
    }
    if (d < 0)
      return;
    ++index[d];
  }
}

void AdjointHealth::look(size_t index, const Field &field, int64_t dimension,
                         int64_t position) {
  const Field *adjoint = field.adjoint();
  if (!adjoint || !adjoint->valid())
    return;
  RecordHealth found{static_cast<int64_t>(index), &field, 0, 0, 0.0, 0.0};
  if (adjoint->sparseNode())
    examineCells(*adjoint, dimension, position, found);
  else
    examineElements(*adjoint, dimension, position, found);
  examined.push_back(found);
}

void AdjointHealth::examine(size_t index, const std::vector<Field *> &live) {
  for (const Field *field : live)
    look(index, *field, -1, -1);
}

void AdjointHealth::examine(const TapeRecording &recording, size_t index) {
  const TapeRecording::Record &record = recording[index];
  const uint64_t *args = recording.args(record);
  for (const Field *field : record.kernel->tables().adjointTargets) {
    // Examines the position that all reads of the record share, or else the
    // whole field.
    int64_t dimension = -1, position = -1;
    bool any = false, whole = false;
    for (const Access &access : record.kernel->summary()) {
      if (access.field.get() != field || access.kind != AccessKind::Read)
        continue;
      if (access.fixed.empty()) {
        whole = true;
        break;
      }
      const FixedIndex &fixed = access.fixed.front();
      int64_t here = fixed.evaluate(args) - field->firstIndex(fixed.dimension);
      whole |= any && (dimension != fixed.dimension || position != here);
      any = true;
      dimension = fixed.dimension;
      position = here;
    }
    if (whole || !any || position < 0 || position >= field->shape()[dimension])
      dimension = position = -1;
    look(index, *field, dimension, position);
  }
}
