//===- FieldCopies.cpp - Copies of whole fields ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Copies between a field and a row-major host array, and fills. A field that is
// contiguous in row-major order is one copy; otherwise each row along the last
// index is one copy, a strided loop or a gather, depending on its levels. Large
// fields are distributed to worker threads.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Host/FieldCopies.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Threads/Section.h"
#include <algorithm>
#include <array>
#include <cstring>

using namespace mlir::tai::runtime;

/// The number of bytes that a worker thread must copy to be worth the cost of
/// the fork.
static constexpr int64_t bytesPerPart = 128 << 10;
constexpr int64_t bytesPerSafepoint = FieldCopies::bytesPerSafepoint;

static Status gone(const Field &field) {
  return Status::failure(StatusCode::Usage,
                         "field '" + field.name() + "' is gone: its tree '" +
                             field.tree().name() + "' has been destroyed");
}

//===----------------------------------------------------------------------===//
// Checks for interrupts between many small copies
//===----------------------------------------------------------------------===//

template <typename Look> Status CopySafepoints::call(const Look &look) {
  isInHandler = true;
  bool goesOn = look();
  isInHandler = false;
  return goesOn ? Status::success() : failAsInterrupted();
}

Status CopySafepoints::begin(int64_t bytes) {
  isLong = bytes >= 2 * bytesPerSafepoint;
  return isLong ? call([] { return safepoint::look(); }) : Status::success();
}

Status CopySafepoints::pass() {
  return isLong ? call([&] { return watch.look(); }) : Status::success();
}

Status CopySafepoints::checkHandler() const {
  return isInHandler ? failAsInterruptedWork() : Status::success();
}

//===----------------------------------------------------------------------===//
// Copies
//===----------------------------------------------------------------------===//

namespace {
/// Part of a row: element k is at base + offsets[k], or at base + k * step if
/// `offsets` is null. It corresponds to element `first` + k of the host array.
template <typename Data> struct RowPart {
  Data *base;
  const int64_t *offsets;
  int64_t step;
  int64_t first;
  int64_t count;
};
} // namespace

bool FieldCopies::runParts(
    int64_t count, int64_t bytes, Interrupts interrupts,
    const std::function<void(int64_t, int64_t)> &run) const {
  struct Job {
    const std::function<void(int64_t, int64_t)> &run;
    int64_t count, parts;
    bool isLong, canStop;
    std::atomic<bool> isStopped{false};
    safepoint::Watch watch;

    void look() {
      if (!watch.look() && canStop)
        isStopped.store(true, std::memory_order_relaxed);
    }
  } job{
      run,
      count,
      std::max(workers.partsOf(bytes, bytesPerPart), bytes / bytesPerSafepoint),
      bytes >= 2 * bytesPerSafepoint,
      interrupts == Interrupts::Stop,
      {},
      {}};
  // The clock that tells threads to look for interrupts may have stopped;
  // looking once restarts it.
  if (job.isLong && !safepoint::look() && job.canStop)
    return false;
  workers.parallel(
      job.parts,
      [](void *context, int64_t part) {
        Job &job = *static_cast<Job *>(context);
        // Only the calling thread looks for interrupts, on behalf of all
        // workers.
        if (job.isLong && !safepoint::isWorker())
          job.look();
        if (job.isStopped.load(std::memory_order_relaxed))
          return;
        auto bound = [&](int64_t p) {
          return job.count / job.parts * p +
                 job.count % job.parts * p / job.parts;
        };
        job.run(bound(part), bound(part + 1));
      },
      &job,
      job.isLong ? [](void *context) { static_cast<Job *>(context)->look(); }
                 : static_cast<void (*)(void *)>(nullptr));
  return !job.isStopped.load(std::memory_order_relaxed);
}

/// Calls `move` for each row of the field along its last index. `data`: the
/// address of the field's first element.
template <typename Data, typename Move>
bool FieldCopies::forEachRow(const Field &field, Data *data,
                             Interrupts interrupts, const Move &move) const {
  const FieldLayout &layout = field.layout();
  const std::vector<int64_t> &shape = field.shape();
  int rank = field.rank();
  if (field.numElements() == 0)
    return true;
  // For each value of an index, the offset that it adds to the address: by a
  // constant step, or by a table.
  std::vector<std::vector<int64_t>> tables(static_cast<size_t>(rank));
  std::vector<int64_t> steps(static_cast<size_t>(rank), 0);
  for (int d = 0; d < rank; ++d) {
    if (findConstantStep(layout.indices[d], steps[d]))
      continue;
    tables[d].resize(static_cast<size_t>(shape[d]));
    for (int64_t i = 0; i < shape[d]; ++i)
      for (const LayoutLevel &level : layout.indices[d])
        tables[d][i] += i / level.divisor % level.extent * level.stride;
  }
  auto contribution = [&](int d, int64_t i) {
    return tables[d].empty() ? i * steps[d] : tables[d][i];
  };

  auto visit = [&](int64_t begin, int64_t end) {
    if (rank == 0) {
      move(RowPart<Data>{data, nullptr, 0, 0, 1});
      return;
    }
    std::vector<int64_t> index(static_cast<size_t>(rank));
    int64_t rest = begin;
    for (int d = rank; d-- > 0;) {
      index[d] = rest % shape[d];
      rest /= shape[d];
    }
    int last = rank - 1;
    while (begin < end) {
      Data *base = data;
      for (int d = 0; d < last; ++d)
        base += contribution(d, index[d]);
      int64_t count = std::min(end - begin, shape[last] - index[last]);
      RowPart<Data> row{base, nullptr, steps[last], begin, count};
      if (tables[last].empty())
        row.base += index[last] * steps[last];
      else
        row.offsets = tables[last].data() + index[last];
      move(row);
      begin += count;
      index[last] = 0;
      for (int d = last - 1; d >= 0; --d) {
        if (++index[d] < shape[d])
          break;
        index[d] = 0;
      }
    }
  };

  // A handler that a safepoint calls may destroy the tree during the copy; the
  // tree's memory stays until the copy ends.
  std::shared_ptr<void> memory = field.tree().sharedMemory();
  return runParts(field.numElements(), field.hostBytes(), interrupts,
                  [&](int64_t begin, int64_t end) { visit(begin, end); });
}

/// Calls body(address, number) for each element of the row; `number` is its
/// position in the host array.
template <typename Data, typename Body>
static void alongRow(const RowPart<Data> &row, const Body &body) {
  if (row.offsets)
    for (int64_t k = 0; k < row.count; ++k)
      body(row.base + row.offsets[k], row.first + k);
  else
    for (int64_t k = 0; k < row.count; ++k)
      body(row.base + k * row.step, row.first + k);
}

/// Calls `body` with the number of bytes of an element, as a compile-time
/// constant for the usual numbers.
template <typename Body> static void withSize(int64_t bytes, const Body &body) {
  switch (bytes) {
  case 1:
    return body(std::integral_constant<size_t, 1>());
  case 2:
    return body(std::integral_constant<size_t, 2>());
  case 4:
    return body(std::integral_constant<size_t, 4>());
  case 8:
    return body(std::integral_constant<size_t, 8>());
  case 12:
    return body(std::integral_constant<size_t, 12>());
  case 16:
    return body(std::integral_constant<size_t, 16>());
  default:
    return body(static_cast<size_t>(bytes));
  }
}

Status FieldCopies::copyOut(const Field &field, void *array) const {
  if (!field.valid())
    return gone(field);
  int64_t scalar = byteSize(field.scalar());
  int64_t components = field.numComponents();
  int64_t element = scalar * components;
  int64_t stride = field.layout().componentStride;
  char *host = static_cast<char *>(array);
  field.settleZeros();
  if (std::shared_ptr<Mirror> mirror = field.tree().sharedMirror();
      mirror && mirror->copyOut(field, array))
    return devices.takeFailure();
  auto copyRow = [&](const RowPart<const char> &row) {
    if (stride != scalar) {
      alongRow(row, [&](const char *from, int64_t k) {
        for (int64_t c = 0; c < components; ++c)
          std::memcpy(host + k * element + c * scalar, from + c * stride,
                      static_cast<size_t>(scalar));
      });
    } else if (!row.offsets && (row.step == element || row.count == 1)) {
      std::memcpy(host + row.first * element, row.base,
                  static_cast<size_t>(row.count * element));
    } else {
      withSize(element, [&](auto size) {
        alongRow(row, [&](const char *from, int64_t k) {
          std::memcpy(host + k * static_cast<int64_t>(size), from, size);
        });
      });
    }
  };
  bool isWhole = forEachRow(field, field.readable(), Interrupts::Stop, copyRow);
  return isWhole ? devices.takeFailure() : failAsInterrupted();
}

bool FieldCopies::copyIn(Field &field, const void *array,
                         Interrupts interrupts) const {
  field.countWrite();
  field.oweZeros(nullptr);
  if (field.sparseNode())
    return copyInActive(field, array, interrupts);
  int64_t scalar = byteSize(field.scalar());
  int64_t components = field.numComponents();
  int64_t element = scalar * components;
  int64_t stride = field.layout().componentStride;
  const char *host = static_cast<const char *>(array);
  if (std::shared_ptr<Mirror> mirror = field.tree().sharedMirror())
    if (std::optional<bool> isWhole =
            mirror->copyIn(field, array, interrupts == Interrupts::Stop))
      return *isWhole;
  auto copyRow = [&](const RowPart<char> &row) {
    if (stride != scalar) {
      alongRow(row, [&](char *to, int64_t k) {
        for (int64_t c = 0; c < components; ++c)
          std::memcpy(to + c * stride, host + k * element + c * scalar,
                      static_cast<size_t>(scalar));
      });
    } else if (!row.offsets && (row.step == element || row.count == 1)) {
      std::memcpy(row.base, host + row.first * element,
                  static_cast<size_t>(row.count * element));
    } else {
      withSize(element, [&](auto size) {
        alongRow(row, [&](char *to, int64_t k) {
          std::memcpy(to, host + k * static_cast<int64_t>(size), size);
        });
      });
    }
  };
  return forEachRow(field, field.writable(), interrupts, copyRow);
}

/// Fills elements that have one stride throughout the field: the rows of a
/// small field are too short to be filled one by one. Returns false if the
/// stride is not uniform, or if there are too many elements for one thread.
static bool fillEvenly(const Field &field, char *data, const char *scalar,
                       bool isZero) {
  int64_t size = byteSize(field.scalar());
  int64_t element = field.numComponents() * size, step = field.evenStep();
  if (step == 0 || field.hostBytes() > 8 * bytesPerPart)
    return false;
  if (step == element && isZero) {
    std::memset(data, 0, static_cast<size_t>(field.hostBytes()));
    return true;
  }
  char pattern[16];
  if (element > static_cast<int64_t>(sizeof(pattern)))
    return false;
  for (int64_t at = 0; at < element; at += size)
    std::memcpy(pattern + at, scalar, static_cast<size_t>(size));
  auto fill = [&](auto elementSize) {
    char *end = data + field.numElements() * step;
    for (char *at = data; at != end; at += step)
      std::memcpy(at, pattern, elementSize);
  };
  switch (element) {
  case 4:
    fill(std::integral_constant<size_t, 4>());
    return true;
  case 8:
    fill(std::integral_constant<size_t, 8>());
    return true;
  case 12:
    fill(std::integral_constant<size_t, 12>());
    return true;
  case 16:
    fill(std::integral_constant<size_t, 16>());
    return true;
  }
  return false;
}

bool FieldCopies::fill(Field &field, const void *scalarBytes,
                       Interrupts interrupts) const {
  field.countWrite();
  field.oweZeros(nullptr);
  if (field.sparseNode())
    return fillActive(field, scalarBytes, interrupts);
  int64_t scalar = byteSize(field.scalar());
  int64_t components = field.numComponents();
  int64_t stride = field.layout().componentStride;
  const char *bytes = static_cast<const char *>(scalarBytes);
  bool zero = std::all_of(bytes, bytes + scalar, [](char b) { return !b; });
  if (Mirror *mirror = field.tree().mirror();
      mirror && mirror->fill(field, scalarBytes))
    return true;
  char *data = field.writable();
  if (fillEvenly(field, data, bytes, zero))
    return true;
  bool isWhole = true;
  withSize(scalar, [&](auto size) {
    auto fillRow = [&](const RowPart<char> &row) {
      bool dense = stride == scalar && !row.offsets &&
                   (row.step == components * scalar || row.count == 1);
      if (dense && zero) {
        std::memset(row.base, 0,
                    static_cast<size_t>(row.count * components * scalar));
      } else if (dense) {
        char *at = row.base, *end = at + row.count * components * scalar;
        for (; at < end; at += static_cast<size_t>(size))
          std::memcpy(at, bytes, size);
      } else {
        alongRow(row, [&](char *to, int64_t) {
          for (int64_t c = 0; c < components; ++c)
            std::memcpy(to + c * stride, bytes, size);
        });
      }
    };
    isWhole = forEachRow(field, data, interrupts, fillRow);
  });
  return isWhole;
}
