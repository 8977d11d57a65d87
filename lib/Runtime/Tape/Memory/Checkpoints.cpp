//===- Checkpoints.cpp - Snapshots in place of saved values ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Checkpoints.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <limits>
#include <new>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Schedules
//===----------------------------------------------------------------------===//

/// The binomial coefficient n over k, limited to `most`.
static int64_t choose(int64_t n, int64_t k) {
  constexpr int64_t most = std::numeric_limits<int64_t>::max() / 4;
  k = std::min(k, n - k);
  if (k < 0)
    return 0;
  double result = 1;
  int64_t exact = 1;
  for (int64_t i = 1; i <= k; ++i) {
    result *= double(n - k + i) / double(i);
    if (result > 1e17)
      return most;
    exact = exact * (n - k + i) / i;
  }
  return exact;
}

int64_t mlir::tai::runtime::binomialCost(int64_t steps, int64_t snapshots) {
  if (steps <= 1)
    return 0;
  snapshots = std::clamp<int64_t>(snapshots, 1, steps);
  // Finds the least r with choose(snapshots + r, snapshots) >= steps.
  int64_t repeats = 1;
  while (choose(snapshots + repeats, snapshots) < steps)
    ++repeats;
  return repeats * steps - choose(snapshots + repeats, snapshots + 1);
}

int64_t mlir::tai::runtime::binomialSplit(int64_t steps, int64_t snapshots) {
  // The position of the next snapshot is found by bisection, since the cost is
  // a convex function of it.
  auto cost = [&](int64_t at) {
    return at + binomialCost(at, snapshots) +
           binomialCost(steps - at, snapshots - 1);
  };
  int64_t low = 1, high = steps - 1;
  while (low < high) {
    int64_t middle = (low + high) / 2;
    if (cost(middle) <= cost(middle + 1))
      high = middle;
    else
      low = middle + 1;
  }
  return low;
}

//===----------------------------------------------------------------------===//
// Snapshots
//===----------------------------------------------------------------------===//

void Checkpoints::restart() {
  logs.clear();
  finals.clear();
  growing.clear();
  unsettled = 0;
  lacksTangents = false;
  stride = 1;
  total = finalBytes = largest = most = 0;
}

void Checkpoints::rewind() {
  growing.clear();
  unsettled = logs.front().pieces.size();
  stride = 1;
  most = count();
}

void Checkpoints::push(uint32_t record) {
  logs.push_back({record, ++ids, 0, {}});
  unsettled = 0;
  most = std::max(most, count());
}

bool Checkpoints::tooMany() const {
  if (policy.budget > 0)
    // Room is left for the next snapshot, the final contents of the fields, and
    // the values of a single record: each at most the largest snapshot so far.
    return total + 3 * largest > policy.budget;
  if (policy.snapshots > 0)
    return count() >= policy.snapshots;
  // Without a limit, the number of snapshots is kept between once and twice the
  // number of records between two snapshots.
  return count() >= 2 * int64_t(stride);
}

void Checkpoints::reach(uint32_t record) {
  if (logs.empty())
    return push(record);
  if (record - logs.back().start < stride)
    return;
  while (count() > 1 && tooMany())
    thin();
  if (record - logs.back().start < stride)
    return;
  if (count() == 1 && tooMany())
    return;
  push(record);
}

void Checkpoints::thin() {
  for (size_t i = (logs.size() - 1) / 2 * 2 + 1; i > 0; i -= 2) {
    if (i < logs.size())
      mergeIntoPrevious(i);
    if (i < 2)
      break;
  }
  stride *= 2;
}

Status Checkpoints::log(Track &track, SlabRange range) {
  Status status = logOne(track, range);
  if (!runtime.recordings().isForward()) {
    lacksTangents |= track.field->dual() != nullptr;
    return status;
  }
  Track *tangent = track.tangentIn(runtime);
  return status && tangent ? logOne(*tangent, range) : std::move(status);
}

Status Checkpoints::logOne(Track &track, SlabRange range) {
  Log &top = logs.back();
  track.refresh();
  track.loggedBy.resize(static_cast<size_t>(track.numCells()));
  track.everSaved = true;
  if (track.slabs.byCell())
    growing.push_back(&track);
  if (Status status = safepoints.begin(track.field->hostBytes()); !status)
    return status;
  return track.forEachRun(
      range, [&](int64_t cell) { return track.loggedBy[cell] != top.id; },
      [&](int64_t cell, int64_t endCell) {
        Piece piece{&track, top.start, false, cell, endCell, {}};
        Status status = safepoints.pass();
        if (status)
          status = piece.allocate(runtime, bytes());
        if (!status)
          return status;
        std::fill(track.loggedBy.begin() + cell,
                  track.loggedBy.begin() + endCell, top.id);
        top.bytes += piece.keptBytes();
        total += piece.keptBytes();
        top.pieces.push_back(std::move(piece));
        return status;
      });
}

static int64_t bytesOf(const std::vector<Piece> &pieces, size_t first = 0) {
  int64_t bytes = 0;
  for (size_t i = first; i < pieces.size(); ++i)
    bytes += pieces[i].bytes();
  return bytes;
}

void Checkpoints::settle() {
  Log &top = logs.back();
  // Cells that the record has activated held zeros before it.
  for (Track *track : growing) {
    auto first = static_cast<int64_t>(track->loggedBy.size());
    track->refresh();
    int64_t end = track->numCells(), longest = track->longestRun();
    track->loggedBy.resize(static_cast<size_t>(end), top.id);
    for (; first < end; first += longest)
      top.pieces.push_back(
          {track, top.start, false, first, std::min(first + longest, end), {}});
  }
  growing.clear();
  size_t kept = unsettled;
  // If the host has interrupted the comparison, all copies are kept, needed or
  // not.
  bool compares = safepoints.begin(bytesOf(top.pieces, unsettled)).ok();
  for (size_t i = unsettled; i < top.pieces.size(); ++i) {
    compares = compares && safepoints.pass().ok();
    Piece &piece = top.pieces[i];
    if (compares && piece.holds()) {
      std::fill(piece.track->loggedBy.begin() + piece.cell,
                piece.track->loggedBy.begin() + piece.endCell, 0);
      top.bytes -= piece.keptBytes();
      total -= piece.keptBytes();
      continue;
    }
    if (kept != i)
      top.pieces[kept] = std::move(piece);
    ++kept;
  }
  top.pieces.resize(kept);
  unsettled = kept;
  largest = std::max(largest, top.bytes);
}

Status Checkpoints::restore() {
  const std::vector<Piece> &pieces = logs.back().pieces;
  Status status = safepoints.begin(bytesOf(pieces));
  for (const Piece &piece : pieces) {
    if (status)
      status = piece.track->bring();
    if (!status)
      return status;
    piece.putBack();
    status = safepoints.pass();
  }
  return status;
}

/// Merges a snapshot into the previous one, whose older contents replace the
/// snapshot's own where both hold a part.
void Checkpoints::mergeIntoPrevious(size_t index) {
  Log &older = logs[index - 1], &newer = logs[index];
  uint32_t mark = ++ids;
  for (const Piece &piece : older.pieces) {
    Track &track = *piece.track;
    track.marks.resize(static_cast<size_t>(track.numCells()));
    std::fill(track.marks.begin() + piece.cell,
              track.marks.begin() + piece.endCell, mark);
  }
  std::vector<Piece> merged;
  for (Piece &piece : newer.pieces) {
    Track &track = *piece.track;
    for (int64_t cell = piece.cell; cell < piece.endCell; ++cell)
      if (track.loggedBy[cell] == newer.id)
        track.loggedBy[cell] = older.id;
    // The older snapshot can lack contents of this field, or of cells that
    // became active later.
    track.marks.resize(static_cast<size_t>(track.numCells()));
    auto begin = track.marks.begin() + piece.cell;
    auto end = track.marks.begin() + piece.endCell;
    if (std::all_of(begin, end,
                    [&](uint32_t found) { return found == mark; })) {
      total -= piece.keptBytes();
      continue;
    }
    older.bytes += piece.keptBytes();
    merged.push_back(std::move(piece));
  }
  for (Piece &piece : older.pieces)
    merged.push_back(std::move(piece));
  older.pieces = std::move(merged);
  largest = std::max(largest, older.bytes);
  bool wasTop = index + 1 == logs.size();
  logs.erase(logs.begin() + static_cast<ptrdiff_t>(index));
  if (wasTop)
    unsettled = logs.back().pieces.size();
}

void Checkpoints::pop() { mergeIntoPrevious(logs.size() - 1); }

Status Checkpoints::keepFinal() {
  finals.clear();
  finalBytes = 0;
  Status status = copyFinals();
  if (!status) {
    finals.clear();
    finalBytes = 0;
  }
  return status;
}

Status Checkpoints::copyFinals() {
  uint32_t mark = ++ids;
  int64_t bytesOfLogs = 0;
  for (const Log &log : logs)
    bytesOfLogs += log.bytes;
  Status status = safepoints.begin(bytesOfLogs);
  for (const Log &log : logs)
    for (const Piece &piece : log.pieces) {
      Track &track = *piece.track;
      track.marks.resize(static_cast<size_t>(track.numCells()));
      auto begin = track.marks.begin() + piece.cell;
      auto end = track.marks.begin() + piece.endCell;
      if (std::all_of(begin, end,
                      [&](uint32_t found) { return found == mark; }))
        continue;
      std::fill(begin, end, mark);
      Piece copy{&track, 0, false, piece.cell, piece.endCell, {}};
      if (status)
        status = safepoints.pass();
      if (status)
        status = copy.allocate(runtime, bytes());
      if (!status)
        return status;
      finalBytes += copy.bytes();
      finals.push_back(std::move(copy));
    }
  return status;
}

void Checkpoints::restoreFinal() {
  safepoint::Unstoppable whole;
  (void)safepoints.begin(finalBytes);
  for (const Piece &piece : finals) {
    (void)safepoints.pass();
    piece.putBack();
  }
  finals.clear();
  finalBytes = 0;
}

Status Checkpoints::checkBudget(int64_t leafBytes) const {
  int64_t least = 2 * largest + leafBytes;
  if (policy.budget <= 0 || least <= policy.budget)
    return Status::success();
  return Status::failure(StatusCode::Memory,
                         "a memory budget of " + formatBytes(policy.budget) +
                             " is too small for this tape: launches change " +
                             formatBytes(largest) +
                             ", of which it keeps what stood there first "
                             "and last, and the values of one launch, " +
                             formatBytes(leafBytes) + ": at least " +
                             formatBytes(least));
}
