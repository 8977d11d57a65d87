//===- Mirror.cpp - The memory of a tree on a device ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Copies of trees and fields between host and device, and operations on fields
// that run on the device.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/Mirror.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include "tai/Runtime/Mirror/Slabs.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

/// Bytes between two safepoints of a copy of a field between host and device: a
/// copy of a few milliseconds, compared with which a wait for the device is
/// short.
static constexpr int64_t bytesPerCopy = 16 << 20;

Mirror::~Mirror() {
  if (memory && !sparseTree)
    deviceContext->free(memory);
}

/// The bytes from the first element of a field to the end of the last one.
static int64_t spanOf(const Field &field) {
  const FieldLayout &layout = field.layout();
  int64_t bytes = (field.numComponents() - 1) * layout.componentStride +
                  byteSize(field.scalar());
  for (const std::vector<LayoutLevel> &levels : layout.indices)
    for (const LayoutLevel &level : levels)
      bytes += (level.extent - 1) * level.stride;
  return bytes;
}

void Mirror::noteField(const Field &field, std::optional<OwnedIndices> part) {
  Pieces pieces{field.layout().placeOffset, spanOf(field), 0, 1};
  if (int64_t step = field.evenStep(); part && step != 0) {
    int64_t inner = step;
    for (int d = part->dimension + 1; d < field.rank(); ++d)
      inner *= field.shape()[d];
    int64_t period = inner * field.shape()[part->dimension];
    pieces.first += part->first * inner;
    pieces.bytes = part->count * inner;
    pieces.step = period;
    pieces.count = period ? field.numElements() * step / period : 0;
    room = Room::OwnedIfLarge;
    parts.push_back({&field, *part});
  }
  // Fields that share cells have the same pieces, but for their places there.
  for (Pieces &other : owned) {
    int64_t first = std::min(other.first, pieces.first);
    int64_t end =
        std::max(other.first + other.bytes, pieces.first + pieces.bytes);
    if (other.count == pieces.count && other.step == pieces.step &&
        end - first < other.bytes + pieces.bytes) {
      other.first = first;
      other.bytes = std::min(end, tree.bytes()) - first;
      return;
    }
  }
  owned.push_back(pieces);
}

template <typename Move> Status Mirror::forEachPiece(const Move &move) const {
  if (!isPartial())
    return move(0, tree.bytes());
  Status status;
  for (const Pieces &pieces : owned)
    for (int64_t i = 0; i < pieces.count && status; ++i) {
      int64_t at = pieces.first + i * pieces.step;
      status = move(at, std::min(pieces.bytes, tree.bytes() - at));
    }
  return status;
}

Status Mirror::allocateMemory() {
  // A smaller tree has memory for all its elements, so that no access waits for
  // memory.
  constexpr int64_t share = 4;
  std::string owner = "tree '" + tree.name() + "'";
  bool canReserve = device().limits().reservedPieceBytes > 0;
  if (room == Room::All || !canReserve ||
      tree.bytes() <= deviceContext->mostBytes() / share)
    return deviceContext->allocate(std::max<int64_t>(tree.bytes(), 1), owner,
                                   memory);
  room = Room::Owned;
  int64_t needed = 0;
  (void)forEachPiece([&](int64_t, int64_t bytes) {
    needed += bytes;
    return Status::success();
  });
  int64_t left = deviceContext->leftToReserved(0);
  if (needed > left)
    return Status::failure(
        StatusCode::Memory,
        "out of memory on the device: the rows of this process in " + owner +
            " need " + formatBytes(needed) + ", and " + formatBytes(left) +
            " are free");
  return deviceContext->reserve(tree.bytes(), owner, memory);
}

Status Mirror::allocate(DevicePtr &address) {
  Section::Entry entry(moving);
  Status status = entry.check();
  if (!status)
    return status;
  if (!memory && sparseTree)
    status = sparseTree->allocate(memory);
  else if (!memory)
    status = allocateMemory();
  address = memory;
  return status;
}

Status Mirror::upload() {
  Section::Entry entry(moving);
  DevicePtr address = 0;
  Status status = entry.check();
  if (status)
    status = allocate(address);
  const char zero = 0;
  while (status && !onDevice()) {
    uint64_t before = changes;
    if (sparseTree)
      status = pristine ? Status::success() : sparseTree->upload();
    else
      status = forEachPiece([&](int64_t first, int64_t bytes) {
        return pristine
                   ? device().fill(at(first), &zero, 1, bytes)
                   : device().copyIn(at(first), tree.base() + first, bytes);
      });
    if (!status || changes != before)
      continue;
    if (isExported())
      hostCurrent.store(false, std::memory_order_relaxed);
    deviceCurrent.store(true, std::memory_order_release);
  }
  return status;
}

Status Mirror::download() {
  Section::Entry entry(moving);
  Status status = entry.check();
  bool isCopied = false;
  while (status && !onHost() && !isCopied) {
    uint64_t before = changes;
    status = sparseTree ? sparseTree->download()
                        : forEachPiece([&](int64_t first, int64_t bytes) {
                            return device().copyOut(tree.base() + first,
                                                    at(first), bytes);
                          });
    isCopied = changes == before;
    if (status && isCopied && !isExported())
      hostCurrent.store(true, std::memory_order_release);
  }
  return status ? context().report() : std::move(status);
}

/// The number of accesses to single elements that cost about as much as a copy
/// of the whole tree. The tree is copied after so many accesses, so that the
/// cost of the accesses is at most doubled.
static int64_t accessesWorth(int64_t bytes) { return bytes >> 17; }

Status Mirror::read(int64_t offset, void *to, int64_t bytes) {
  Status status;
  if (!onHost() && (isExported() || reads++ < accessesWorth(tree.bytes()))) {
    status = device().copyOut(to, at(offset), bytes);
    return status ? context().report() : std::move(status);
  }
  status = toHost();
  if (status)
    std::memcpy(to, tree.base() + offset, static_cast<size_t>(bytes));
  return status;
}

Status Mirror::write(int64_t offset, const void *from, int64_t bytes) {
  // A single write on the device needs no wait of the host, unlike a read, so a
  // tree remains on the device for more single writes than single reads.
  constexpr int64_t few = 8;
  if (onDevice() &&
      (isExported() || writes++ < few + accessesWorth(tree.bytes()))) {
    pristine = false;
    ++changes;
    // If the copies on the host and on the device are both current, both are
    // written.
    if (onHost())
      std::memcpy(tree.base() + offset, from, static_cast<size_t>(bytes));
    Status status = device().fill(at(offset), from, static_cast<int>(bytes), 1);
    return status && isExported() ? context().queue().settle()
                                  : std::move(status);
  }
  Status status = toHost();
  if (!status)
    return status;
  hostWrites();
  std::memcpy(tree.base() + offset, from, static_cast<size_t>(bytes));
  return status;
}

//===----------------------------------------------------------------------===//
// Trees and fields
//===----------------------------------------------------------------------===//

void Tree::bringToHost() const { mirrored->context().note(mirrored->toHost()); }

void Tree::bringToHostToChange() const {
  Status status = mirrored->toHost();
  // If the copy to the host failed, the host's older data must not count as
  // current.
  if (status)
    mirrored->hostWrites();
  mirrored->context().note(std::move(status));
}

Status Field::loadMirrored(int64_t offset, void *to) const {
  return owner->mirror()->read(offset, to, byteSize(fieldLayout.scalar));
}

Status Field::storeMirrored(int64_t offset, const void *from) const {
  return owner->mirror()->write(offset, from, byteSize(fieldLayout.scalar));
}

/// Guards the storing of owed zeros (see OwedZeros.h): a second thread waits
/// until the zeros are stored.
static Section &storingZeros() {
  static Section section;
  return section;
}

std::shared_ptr<const OwedZeros> Field::owedZeros() const {
  Section::Entry entry(storingZeros());
  return owed;
}

void Field::oweZeros(std::shared_ptr<const OwedZeros> zeros) const {
  if (!zeros && !owesZeros())
    return;
  Section::Entry entry(storingZeros());
  if (entry.isAgain()) {
    owner->mirror()->context().note(entry.check());
    return;
  }
  owed = std::move(zeros);
  owes.store(owed != nullptr, std::memory_order_release);
}

void Field::storeZeros() const {
  Section::Entry entry(storingZeros());
  if (entry.isAgain()) {
    owner->mirror()->context().note(entry.check());
    return;
  }
  if (owed && valid())
    owed->store(*this);
  owed = nullptr;
  owes.store(false, std::memory_order_release);
}

//===----------------------------------------------------------------------===//
// Whole fields
//===----------------------------------------------------------------------===//

/// True if a field is copied and filled on the device: its elements have an
/// even stride, and the device's copy is current.
static bool liesThere(const Mirror &mirror, const Field &field) {
  return field.evenStep() != 0 && mirror.onDevice();
}

/// Copies between arrays of the host and a field on the device. If elements of
/// other fields lie between its elements, the copies go through a dense buffer
/// on the device.
namespace {
class DeviceCopy {
public:
  DeviceCopy(Mirror &mirror, const Field &field)
      : mirror(mirror), field(field),
        bytes(field.numComponents() * byteSize(field.scalar())),
        piece(std::max<int64_t>(bytesPerCopy / bytes, 1)) {}

  /// Calls move(first, count) for ranges of the field's elements.
  template <typename Move> Status run(bool canStop, const Move &move) {
    int64_t count = field.numElements();
    Status status;
    if (!field.contiguous())
      status = DeviceBlock::make(mirror.sharedContext(),
                                 std::min(piece, count) * bytes,
                                 "copies of fields", dense);
    const OwnedIndices *part = mirror.partOf(field);
    if (!status || !mirror.isPartial() || !part)
      return status ? safepoint::runInPieces(count, piece, canStop, move)
                    : std::move(status);
    // The elements of the process are in blocks, one in each period.
    int64_t inner = 1;
    for (int d = part->dimension + 1; d < field.rank(); ++d)
      inner *= field.shape()[d];
    int64_t period = inner * field.shape()[part->dimension];
    for (int64_t at = part->first * inner; at < count && status; at += period)
      status = safepoint::runInPieces(
          part->count * inner, piece, canStop,
          [&](int64_t first, int64_t some) { return move(at + first, some); });
    return status;
  }
  Status copyIn(int64_t first, int64_t count, const char *array) {
    DeviceRows rows = mirror.rows(field, first, count);
    Status status =
        mirror.device().copyIn(dense ? dense->get() : rows.address,
                               array + first * bytes, count * bytes);
    return status && dense
               ? mirror.device().copyRows(rows, dense->get(), rows.rowBytes)
               : std::move(status);
  }
  Status copyOut(int64_t first, int64_t count, char *array) {
    DeviceRows rows = mirror.rows(field, first, count);
    Status status;
    if (dense)
      status = mirror.device().copyRows(
          {dense->get(), rows.rowBytes, rows.rowBytes, rows.rows}, rows.address,
          rows.step);
    return status ? mirror.device().copyOut(array + first * bytes,
                                            dense ? dense->get() : rows.address,
                                            count * bytes)
                  : std::move(status);
  }

private:
  Mirror &mirror;
  const Field &field;
  int64_t bytes, piece;
  std::unique_ptr<DeviceBlock> dense;
};
} // namespace

bool Mirror::copyOut(const Field &field, void *array) {
  if (onHost() || !liesThere(*this, field))
    return false;
  DeviceCopy copy(*this, field);
  Status status = copy.run(/*canStop=*/true, [&](int64_t first, int64_t count) {
    return copy.copyOut(first, count, static_cast<char *>(array));
  });
  if (status)
    status = context().report();
  context().note(std::move(status));
  return true;
}

std::optional<bool> Mirror::copyIn(const Field &field, const void *array,
                                   bool canStop) {
  if (!liesThere(*this, field))
    return std::nullopt;
  DeviceCopy copy(*this, field);
  bool isLost = false;
  Status status = copy.run(canStop, [&](int64_t first, int64_t count) {
    isLost = !onDevice();
    if (isLost)
      return failAsInterrupted();
    deviceWrites();
    return copy.copyIn(first, count, static_cast<const char *>(array));
  });
  // A handler has written to the tree on the host during the copy.
  if (isLost)
    return std::nullopt;
  if (status.code() == StatusCode::Interrupted)
    return false;
  context().note(std::move(status));
  return true;
}

/// Cuts a field whose elements are not evenly spaced into pieces whose elements
/// are, one piece for each combination of the indices with the largest steps.
/// Empty if there are too many pieces, or no piece is evenly spaced.
static std::vector<DeviceRows> findPieces(const Mirror &mirror,
                                          const Field &field) {
  struct Axis {
    int64_t extent, step;
  };
  constexpr int64_t most = 4096;
  const FieldLayout &layout = field.layout();
  if (layout.componentStride != byteSize(field.scalar()))
    return {};
  std::vector<Axis> axes;
  for (int d = 0; d < field.rank(); ++d) {
    int64_t step;
    if (!findConstantStep(layout.indices[d], step))
      return {};
    if (field.shape()[d] > 1)
      axes.push_back({field.shape()[d], step});
  }
  std::sort(axes.begin(), axes.end(),
            [](const Axis &a, const Axis &b) { return a.step < b.step; });
  // The axes with the smallest steps are merged into a row of evenly spaced
  // elements: an axis belongs to the row if its step is the length of the row
  // so far.
  int64_t rows = 1, step = field.numComponents() * layout.componentStride;
  size_t even = 0;
  for (; even < axes.size(); ++even) {
    if (even == 0)
      step = axes[0].step;
    else if (axes[even].step != step * rows)
      break;
    rows *= axes[even].extent;
  }
  // The next axis of the field counts groups of rows.
  Axis group{1, 0};
  if (even < axes.size())
    group = axes[even++];
  std::vector<int64_t> offsets{layout.placeOffset};
  for (; even < axes.size(); ++even) {
    std::vector<int64_t> all;
    for (int64_t i = 0; i < axes[even].extent; ++i)
      for (int64_t offset : offsets) {
        if (static_cast<int64_t>(all.size()) == most)
          return {};
        all.push_back(offset + i * axes[even].step);
      }
    offsets = std::move(all);
  }
  int64_t rowBytes = field.numComponents() * layout.componentStride;
  if (rowBytes == step) {
    rowBytes *= rows;
    rows = 1;
  }
  std::vector<DeviceRows> pieces;
  pieces.reserve(offsets.size());
  for (int64_t offset : offsets)
    pieces.push_back(
        {mirror.at(offset), step, rowBytes, rows, group.step, group.extent});
  return pieces;
}

/// Queues deferred work if other libraries use the raw memory of the tree,
/// because these libraries do not ask for the work.
static void settleLent(const Mirror &mirror) {
  if (mirror.isExported())
    mirror.context().note(mirror.context().queue().settle());
}

DeviceRows Mirror::ownedRows(const Field &field, int64_t first,
                             int64_t count) const {
  const OwnedIndices *part = partOf(field);
  if (!part)
    return rows(field, first, count);
  // The elements with one index along the dimension are in blocks, one block in
  // each period.
  int64_t inner = 1;
  for (int d = part->dimension + 1; d < field.rank(); ++d)
    inner *= field.shape()[d];
  int64_t period = inner * field.shape()[part->dimension];
  bool isWhole = period > 0 && first % period == 0 && count % period == 0;
  int64_t bytes = field.numComponents() * byteSize(field.scalar());
  int64_t step = field.evenStep(), blocks = isWhole ? count / period : 0;
  if (!isWhole || (step != bytes && blocks != 1))
    return rows(field, first, count);
  DeviceRows found =
      rows(field, first + part->first * inner, part->count * inner);
  if (step == bytes && blocks != 1) {
    found.step = period * bytes;
    found.rows = blocks;
  }
  return found;
}

bool Mirror::fill(const Field &field, const void *scalarBytes) {
  if (!onDevice())
    return false;
  if (!liesThere(*this, field)) {
    std::vector<DeviceRows> pieces = findPieces(*this, field);
    if (pieces.empty())
      return false;
    deviceWrites();
    auto size = static_cast<int>(byteSize(field.scalar()));
    for (const DeviceRows &piece : pieces)
      context().note(piece.rows == 1 && piece.outer == 1
                         ? device().fill(piece.address, scalarBytes, size,
                                         piece.rowBytes / size)
                         : device().fillRows(piece, scalarBytes, size));
    settleLent(*this);
    return true;
  }
  deviceWrites();
  auto size = static_cast<int>(byteSize(field.scalar()));
  Device &target = device();
  DeviceRows rows = ownedRows(field, 0, field.numElements());
  context().note(rows.rows == 1 ? target.fill(rows.address, scalarBytes, size,
                                              rows.rowBytes / size)
                                : target.fillRows(rows, scalarBytes, size));
  settleLent(*this);
  return true;
}

//===----------------------------------------------------------------------===//
// Parts of fields
//===----------------------------------------------------------------------===//

DeviceRows Slabs::rowsOf(int64_t first, int64_t count) const {
  const Mirror &mirror = *field->tree().mirror();
  if (isRowMajor)
    return mirror.ownedRows(*field, first, count);
  int slowDimension = slowDimensions.front();
  int64_t rowBytes = bytes;
  for (int d = slowDimension + 1; d < field->rank(); ++d)
    rowBytes *= field->shape()[d];
  int64_t slab = first / slabElements;
  return {mirror.at(field->layout().placeOffset + slab * rowBytes),
          field->shape()[slowDimension] * rowBytes, rowBytes,
          count * bytes / rowBytes};
}

Status Slabs::keepOnDevice(int64_t first, int64_t count,
                           std::unique_ptr<DeviceBlock> &block) const {
  Mirror &mirror = *field->tree().mirror();
  Status status = mirror.toDevice();
  DeviceRows rows{};
  int64_t kept = count * bytes;
  if (status && !mover) {
    rows = rowsOf(first, count);
    kept = rows.rowBytes * rows.rows;
  }
  if (status)
    status = DeviceBlock::makeKept(mirror.sharedContext(), kept, block);
  if (!status)
    return status;
  if (mover) {
    CellMover::Cells cells{};
    status = bringNumbers(first, count, cells);
    return status ? mover->load(cells, block->get()) : std::move(status);
  }
  return mirror.context().queue().copyKept(
      {block->get(), rows.rowBytes, rows.rowBytes, rows.rows}, rows.address,
      rows.step);
}

Status Slabs::zerosOnDevice(int64_t first, int64_t count,
                            std::unique_ptr<DeviceBlock> &block) const {
  Mirror &mirror = *field->tree().mirror();
  Status status = mirror.toDevice();
  int64_t kept = count * bytes;
  if (status && !mover) {
    DeviceRows rows = rowsOf(first, count);
    kept = rows.rowBytes * rows.rows;
  }
  if (status)
    status = DeviceBlock::makeKept(mirror.sharedContext(), kept, block);
  const char zero = 0;
  return status ? mirror.device().fill(block->get(), &zero, 1, kept)
                : std::move(status);
}

template <typename MoveCells, typename MoveRows>
void Slabs::changeOnDevice(int64_t first, int64_t count,
                           const MoveCells &moveCells,
                           const MoveRows &moveRows) const {
  Mirror &mirror = *field->tree().mirror();
  // An exchange of elements that stops halfway could not be undone.
  safepoint::Unstoppable whole;
  if (Status status = mirror.toDevice(); !status) {
    mirror.context().note(std::move(status));
    return;
  }
  if (mover) {
    CellMover::Cells cells{};
    Status status = bringNumbers(first, count, cells);
    mirror.context().note(status ? moveCells(cells) : std::move(status));
    return;
  }
  mirror.deviceWrites();
  mirror.context().note(moveRows(mirror.device(), rowsOf(first, count)));
}

void Slabs::storeOnDevice(int64_t first, int64_t count,
                          const DeviceBlock &block) const {
  changeOnDevice(
      first, count,
      [&](CellMover::Cells cells) { return mover->store(cells, block.get()); },
      [&](auto &device, const DeviceRows &rows) {
        return rows.rows == 1
                   ? device.copy(rows.address, block.get(), rows.rowBytes)
                   : device.copyRows(rows, block.get(), rows.rowBytes);
      });
}

void Slabs::exchangeOnDevice(int64_t first, int64_t count,
                             const DeviceBlock &block) const {
  changeOnDevice(
      first, count,
      [&](CellMover::Cells cells) {
        return mover->exchange(cells, block.get());
      },
      [&](auto &device, const DeviceRows &rows) {
        return device.swapRows(rows, block.get(), rows.rowBytes);
      });
}
