//===- CudaKernels.cpp - Kernels of the runtime itself --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "CudaKernels.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::cuda;

namespace mlir::tai {
// PTX of Rows.cu, compiled when the project is built.
extern const unsigned char cudaRowKernels[];
extern const unsigned long cudaRowKernelsSize;
extern const unsigned char cudaOverlappedRowKernels[];
extern const unsigned long cudaOverlappedRowKernelsSize;
} // namespace mlir::tai

Status CudaKernels::load() {
  DeviceImage image;
  if (device.limits().hasOverlaps)
    image.bytes.assign(
        reinterpret_cast<const char *>(mlir::tai::cudaOverlappedRowKernels),
        mlir::tai::cudaOverlappedRowKernelsSize);
  else
    image.bytes.assign(
        reinterpret_cast<const char *>(mlir::tai::cudaRowKernels),
        mlir::tai::cudaRowKernelsSize);
  Status status = device.load(image, module);
  const char *kernels[] = {"tai_copy_", "tai_swap_"};
  const char *units[] = {"bytes", "words", "pairs", "quads"};
  for (int u = 0; u < kUnits; ++u)
    for (int k = 0; k < 2 && status; ++k)
      status = device.find(
          *module, (std::string(kernels[k]) + units[u]).c_str(), rows[u][k]);
  if (status)
    status = device.find(*module, "tai_fill_pieces", filler);
  if (status)
    fillBlocks = device.residentBlocks(*filler, taiFillThreads);
  return status;
}

static constexpr uint64_t rowUnitBytes[] = {1, 4, 8, 16};

/// The index in rowUnitBytes of the largest copy unit that divides each of
/// `numbers`.
static int findUnit(std::initializer_list<uint64_t> numbers) {
  int unit = 3;
  for (uint64_t number : numbers)
    while (number % rowUnitBytes[unit])
      --unit;
  return unit;
}

Status CudaKernels::runRows(Kernel kernel, int unit, int64_t units,
                            bool overlaps,
                            std::initializer_list<uint64_t> parameters) {
  if (units == 0)
    return Status::success();
  LaunchShape shape;
  shape.threads = 256;
  shape.overlaps = overlaps;
  constexpr int64_t blocksEach = 8;
  shape.blocks = static_cast<unsigned>(
      std::clamp<int64_t>((units + shape.threads - 1) / shape.threads, 1,
                          blocksEach * device.limits().multiprocessors));
  return device.launch(*rows[unit][kernel], shape, parameters.begin(),
                       static_cast<int>(parameters.size()));
}

Status CudaKernels::runPairs(Kernel kernel, const DeviceRows &one,
                             DevicePtr other, int64_t otherStep,
                             bool overlaps) {
  auto bytes = static_cast<uint64_t>(one.rowBytes);
  auto step = static_cast<uint64_t>(one.step);
  auto stepThere = static_cast<uint64_t>(otherStep);
  int unit = findUnit({one.address, step, other, stepThere, bytes});
  uint64_t size = rowUnitBytes[unit];
  return runRows(kernel, unit, static_cast<int64_t>(bytes / size) * one.rows,
                 overlaps,
                 {one.address, step / size, other, stepThere / size,
                  bytes / size, static_cast<uint64_t>(one.rows)});
}

//===----------------------------------------------------------------------===//
// Fills
//===----------------------------------------------------------------------===//

/// Collects fills of device memory for one launch of the fill kernel.
struct CudaKernels::Filling {
  CudaKernels &kernels;
  bool overlaps;
  unsigned mostBlocks;
  TaiFillTable table = {};

  Status add(const DeviceFill &fill);
  Status run();
};

static int64_t bytesOf(const DeviceRows &rows) {
  return rows.rowBytes * rows.rows * rows.outer;
}

static bool isDense(const DeviceRows &rows) {
  return rows.rows == 1 && rows.outer == 1;
}

Status CudaKernels::Filling::run() {
  if (table.count == 0)
    return Status::success();
  LaunchShape shape;
  shape.threads = taiFillThreads;
  shape.blocks = static_cast<unsigned>(
      std::min<uint64_t>(table.entries[table.count - 1].end,
                         mostBlocks ? mostBlocks : kernels.fillBlocks));
  shape.overlaps = overlaps;
  // The fill kernel has a single parameter, the table of all fills.
  constexpr size_t words = sizeof(table) / sizeof(uint64_t);
  uint64_t slots[words];
  std::memcpy(slots, &table, sizeof(table));
  table = TaiFillTable();
  return kernels.device.launch(*kernels.filler, shape, slots, words);
}

/// Adds a fill to the table, or both halves of a fill too large for an entry.
/// If the table is full, its fills are launched first.
Status CudaKernels::Filling::add(const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  if (bytesOf(rows) <= 0)
    return Status::success();
  if (!isDense(rows) &&
      static_cast<uint64_t>(bytesOf(rows)) >= taiFillMostBytes) {
    DeviceFill first = fill, second = fill;
    bool isOuter = rows.outer > 1;
    int64_t half = (isOuter ? rows.outer : rows.rows) / 2;
    (isOuter ? first.rows.outer : first.rows.rows) = half;
    (isOuter ? second.rows.outer : second.rows.rows) -= half;
    second.rows.address +=
        static_cast<uint64_t>(half * (isOuter ? rows.outerStep : rows.step));
    Status status = add(first);
    return status ? add(second) : std::move(status);
  }
  Status status;
  if (table.count == taiFillEntries)
    status = run();
  auto number = [](int64_t value) { return static_cast<uint64_t>(value); };
  taiFillAdd(&table, rows.address, number(rows.step), number(rows.rowBytes),
             number(rows.rows), number(rows.outerStep), number(rows.outer),
             fill.pattern);
  return status;
}

Status CudaKernels::fill(const std::vector<const DeviceFill *> &fills,
                         bool overlaps, unsigned mostBlocks) {
  Filling filling{*this, overlaps, mostBlocks};
  Status status;
  for (const DeviceFill *fill : fills)
    if (status)
      status = filling.add(*fill);
  return status ? filling.run() : std::move(status);
}
