//===- CellMover.cpp - Cells of a field on a device -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/CellMover.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

Status CellMover::find(const Field &field, const CellElements &elements,
                       std::shared_ptr<CellMover> &mover) {
  mover = nullptr;
  Mirror *mirror = field.tree().mirror();
  if (!mirror || !mirror->sparse())
    return Status::success();
  bool isThere = false;
  Status status = mirror->context().library().load(isThere);
  if (!status || !isThere)
    return status;
  std::shared_ptr<CellMover> &known = mirror->sparse()->moverOf(field);
  if (known) {
    mover = known;
    return status;
  }
  int64_t scalar = byteSize(field.scalar());
  std::vector<int64_t> offsets;
  for (const CellElements::Run &run : elements.runs())
    for (int64_t byte = 0; byte < run.bytes; byte += scalar)
      offsets.push_back(run.offset + byte);
  size_t tableBytes = offsets.size() * sizeof(int64_t);
  std::shared_ptr<CellMover> made(
      new CellMover(*mirror, scalar, elements.bytes()));
  status = DeviceBlock::make(
      mirror->sharedContext(),
      static_cast<int64_t>(sizeof(TaiDeviceCellMove) + tableBytes),
      "places of fields in cells", made->description);
  if (!status)
    return status;
  DevicePtr memory = made->description->get();
  TaiDeviceCellMove head = {
      static_cast<int32_t>(numberOf(field.tree(), *field.sparseNode())),
      static_cast<int32_t>(scalar), static_cast<int64_t>(offsets.size()),
      field.layout().placeOffset,
      reinterpret_cast<const int64_t *>(memory + sizeof(TaiDeviceCellMove))};
  std::vector<char> image(sizeof(head) + tableBytes);
  std::memcpy(image.data(), &head, sizeof(head));
  std::memcpy(image.data() + sizeof(head), offsets.data(), tableBytes);
  status = mirror->device().copyIn(memory, image.data(),
                                   static_cast<int64_t>(image.size()));
  if (status)
    mover = known = std::move(made);
  return status;
}

Status CellMover::run(Cells cells, DevicePtr other, uint64_t what) const {
  if (cells.count == 0)
    return Status::success();
  Status status = mirror.toDevice();
  if (!status)
    return status;
  if (what != TAI_CELLS_LOAD)
    mirror.deviceWrites();
  constexpr unsigned threads = 256;
  return mirror.context().library().launch(
      LibraryKernel::MoveCells, /*blocks=*/0, threads,
      {mirror.at(0), description->get(), cells.numbers,
       static_cast<uint64_t>(cells.count), other, what});
}

Status CellMover::load(Cells cells, DevicePtr to) const {
  return run(cells, to, TAI_CELLS_LOAD);
}
Status CellMover::store(Cells cells, DevicePtr from) const {
  return run(cells, from, TAI_CELLS_STORE);
}
Status CellMover::exchange(Cells cells, DevicePtr with) const {
  return run(cells, with, TAI_CELLS_EXCHANGE);
}
Status CellMover::fill(Cells cells, const void *value) const {
  uint64_t scalar = 0;
  std::memcpy(&scalar, value, static_cast<size_t>(scalarBytes));
  return run(cells, scalar, TAI_CELLS_FILL);
}

//===----------------------------------------------------------------------===//
// Copies between cells on the device and memory of the host
//===----------------------------------------------------------------------===//

Status CellMover::bring(const int64_t *numbers, int64_t count,
                        std::unique_ptr<DeviceBlock> &memory,
                        Cells &cells) const {
  auto bytes = count * static_cast<int64_t>(sizeof(int64_t));
  Status status =
      DeviceBlock::make(mirror.sharedContext(), std::max<int64_t>(bytes, 1),
                        "numbers of cells", memory);
  if (!status)
    return status;
  cells = {memory->get(), count};
  return mirror.device().copyIn(memory->get(), numbers, bytes);
}

template <typename Move>
Status CellMover::moveDense(const std::vector<int64_t> &cells,
                            const Move &move) const {
  if (cells.empty())
    return Status::success();
  auto count = static_cast<int64_t>(cells.size());
  std::unique_ptr<DeviceBlock> numbers, dense;
  Cells there{};
  Status status = bring(cells.data(), count, numbers, there);
  if (status)
    status = DeviceBlock::make(mirror.sharedContext(), count * cellBytes,
                               "copies of fields", dense);
  return status ? move(there, dense->get(), count * cellBytes)
                : std::move(status);
}

Status CellMover::load(const std::vector<int64_t> &cells, char *to) const {
  return moveDense(cells, [&](Cells there, DevicePtr dense, int64_t bytes) {
    Status status = load(there, dense);
    return status ? mirror.device().copyOut(to, dense, bytes)
                  : std::move(status);
  });
}

Status CellMover::store(const std::vector<int64_t> &cells,
                        const char *from) const {
  return moveDense(cells, [&](Cells there, DevicePtr dense, int64_t bytes) {
    Status status = mirror.device().copyIn(dense, from, bytes);
    return status ? store(there, dense) : std::move(status);
  });
}

Status CellMover::clear(const std::vector<int64_t> &cells) const {
  if (cells.empty())
    return Status::success();
  std::unique_ptr<DeviceBlock> numbers;
  Cells there{};
  Status status =
      bring(cells.data(), static_cast<int64_t>(cells.size()), numbers, there);
  const uint64_t zero = 0;
  return status ? fill(there, &zero) : std::move(status);
}
