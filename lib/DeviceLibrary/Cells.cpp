//===- Cells.cpp - Contents of a field's cells ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Copies the elements of a field, cell by cell, between a tree and a dense
// array, and fills them.
//
//===----------------------------------------------------------------------===//

#include "Level.h"
#include "tai/ABI/DeviceAbi.h"

using namespace tai::device;

template <typename T>
static void moveAs(const TaiDeviceCellMove &move, const Level &level,
                   const int64_t *cells, int64_t count, uint64_t other,
                   uint64_t what) {
  auto threads = int64_t(tai_dev_grid_dim()) * tai_dev_block_dim();
  int64_t at =
      int64_t(tai_dev_block_id()) * tai_dev_block_dim() + tai_dev_thread_id();
  auto *dense = reinterpret_cast<T *>(other);
  for (int64_t end = count * move.scalars; at < end; at += threads) {
    int64_t cell = at / move.scalars, scalar = at - cell * move.scalars;
    char *address = level.addressOf(cells[cell]) - level.node.offset +
                    move.place + move.offsets[scalar];
    auto *here = reinterpret_cast<T *>(address);
    switch (what) {
    case TAI_CELLS_LOAD:
      dense[at] = *here;
      break;
    case TAI_CELLS_STORE:
      *here = dense[at];
      break;
    case TAI_CELLS_EXCHANGE: {
      T held = *here;
      *here = dense[at];
      dense[at] = held;
      break;
    }
    default:
      *here = static_cast<T>(other);
    }
  }
}

void tai_dev_move_cells(uint64_t tree, uint64_t moveAddress, uint64_t cells,
                        uint64_t count, uint64_t other, uint64_t what) {
  const auto &move = *reinterpret_cast<const TaiDeviceCellMove *>(moveAddress);
  Level level(reinterpret_cast<char *>(tree), move.node);
  auto *numbers = reinterpret_cast<const int64_t *>(cells);
  auto all = static_cast<int64_t>(count);
  if (all < 0)
    all = numbers[-1];
  switch (move.scalarBytes) {
  case 1:
    return moveAs<uint8_t>(move, level, numbers, all, other, what);
  case 2:
    return moveAs<uint16_t>(move, level, numbers, all, other, what);
  case 4:
    return moveAs<uint32_t>(move, level, numbers, all, other, what);
  default:
    return moveAs<uint64_t>(move, level, numbers, all, other, what);
  }
}
