//===- TapeTrust.cpp - What lets a user trust a gradient ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Single records of a tape can be launched again, so that the gradient of one
// can be checked apart from the others, and the reverse sweep can look at the
// adjoints that each record leaves. Neither costs anything while it is not
// asked for.
//
//===----------------------------------------------------------------------===//

#include "../Host/HostWrite.h"
#include "../Launch/Launch.h"
#include "../Mirror/CellElements.h"
#include "../Storage/Scalars.h"
#include "tai/Runtime/Tape/Tape.h"
#include <cmath>

using namespace mlir::tai::runtime;

Status Tape::runRecord(int64_t index) {
  if (index < 0 || index >= numRecords())
    return Status::failure(StatusCode::Usage,
                           "the tape has no record " + std::to_string(index));
  if (recording())
    return Status::failure(StatusCode::Usage,
                           "a record cannot be launched again while its tape "
                           "records");
  const Record &record = records[index];
  auto *other = static_cast<Tape *>(runtime.recordingTape());
  if (record.kind == Kind::Write)
    return runtime.change(getWrite(record));
  if (!record.kernel) {
    const TapeCallback &callback = callbacks[record.payload];
    if (other)
      other->suspend();
    Status status = callback.forward ? callback.forward() : Status::success();
    if (other) {
      (void)other->resume();
      if (status)
        other->recordCallback(callback);
    }
    return status;
  }
  Kernel &kernel = *record.kernel;
  const uint64_t *args = argsOf(index);
  uint64_t number = firstLaunch + record.launch;
  Launch *launch = runtime.acquireLaunch();
  std::vector<uint64_t> results(kernel.resultSlots());
  kernel.prepared.lastLaunch.store(number, std::memory_order_relaxed);
  uint64_t *wanted = results.empty() ? nullptr : results.data();
  Status status = other ? other->launch(*launch, kernel, args, wanted, number)
                        : runtime.run(*launch, kernel, args, wanted, number);
  runtime.releaseLaunch(launch);
  return status;
}

void Tape::watchHealth(bool on) {
  watching = on;
  examined.clear();
}

static void examineElement(const Field &adjoint, const char *address,
                           Tape::Health &found) {
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

/// The same as below where only active cells hold anything.
static void examineCells(const Field &adjoint, int64_t dimension,
                         int64_t position, Tape::Health &found) {
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

/// Examines the elements of an adjoint; those at one position of a dimension,
/// unless that is -1.
static void examineElements(const Field &adjoint, int64_t dimension,
                            int64_t position, Tape::Health &found) {
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

void Tape::examine(size_t index) {
  const Record &record = records[index];
  auto look = [&](const Field &field, int64_t dimension, int64_t position) {
    const Field *adjoint = field.adjoint();
    if (!adjoint || !adjoint->valid())
      return;
    Health found{static_cast<int64_t>(index), &field, 0, 0, 0.0, 0.0};
    if (adjoint->sparseNode())
      examineCells(*adjoint, dimension, position, found);
    else
      examineElements(*adjoint, dimension, position, found);
    examined.push_back(found);
  };
  if (!record.kernel) {
    for (Field *field : liveFields())
      look(*field, -1, -1);
    return;
  }
  const uint64_t *args = argsOf(index);
  for (Field *field : record.kernel->adjointTargets) {
    // One place of the field, or all of it where the reads are at several.
    int64_t dimension = -1, position = -1;
    bool any = false, whole = false;
    for (const Access &access : record.kernel->summary()) {
      if (access.field.get() != field || access.kind != AccessKind::Read)
        continue;
      if (!access.fixed) {
        whole = true;
        break;
      }
      int64_t here = access.fixed->evaluate(args) -
                     field->firstIndex(access.fixed->dimension);
      whole |=
          any && (dimension != access.fixed->dimension || position != here);
      any = true;
      dimension = access.fixed->dimension;
      position = here;
    }
    if (whole || !any || position < 0 || position >= field->shape()[dimension])
      dimension = position = -1;
    look(*field, dimension, position);
  }
}
