//===- TapeMemory.cpp - Saved values of a tape ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapeMemory.h"
#include "../TapeServices.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <cstring>
#include <set>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Effects of launches on memory
//===----------------------------------------------------------------------===//

SlabRange TapeMemory::Use::locateAny(const uint64_t *args) const {
  if (fixed.empty())
    return {};
  int64_t number = 0, located = 1;
  for (size_t i = 0; i < fixed.size(); ++i) {
    int64_t position = fixed[i].evaluate(args) - ranges[i].first;
    int64_t extent = ranges[i].count;
    if (position < 0 || position >= extent)
      return {};
    number = number * extent + position;
    located *= extent;
  }
  // If the indices fix one slab, the division below, which each launch would
  // do, is avoided.
  int64_t all = track->slabs.count();
  int64_t count = located == all ? 1 : all / located;
  return {number * count, count};
}

Track &TapeMemory::trackOf(const FieldPtr &field,
                           const std::vector<FixedIndex> &fixed) {
  std::unique_ptr<Track> &track =
      tracks[{&field->tree(), field->layout().placeOffset}];
  // A kernel may use hundreds of slabs of a field that is already cut into
  // slabs.
  if (track &&
      (track->everSaved || fixed.size() <= track->slabs.dimensions().size()))
    return *track;
  std::vector<int> wanted = Slabs::choose(*field, fixed);
  if (!track) {
    track = std::make_unique<Track>(field, std::move(wanted));
    return *track;
  }
  const std::vector<int> &known = track->slabs.dimensions();
  if (wanted.size() <= known.size() ||
      !std::equal(known.begin(), known.end(), wanted.begin()) ||
      std::any_of(parts.begin(), parts.end(), [&](const Part &part) {
        return part.track == track.get() && !part.range.isAll();
      }))
    return *track;
  // Splits slabs, because earlier launches used the whole field, or larger
  // slabs than this launch.
  track->stored.lose({}, lostStored);
  Track finer(track->field, std::move(wanted));
  finer.readAnywhere = track->readAnywhere;
  finer.lastRead = track->lastRead;
  size_t ratio =
      static_cast<size_t>(finer.slabs.count() / track->slabs.count());
  for (uint32_t stamp : track->readAt)
    finer.readAt.insert(finer.readAt.end(), ratio, stamp);
  *track = std::move(finer);
  return *track;
}

TapeMemory::Use TapeMemory::makeUse(const Access &access) {
  Use use;
  use.track = &trackOf(access.field, access.fixed);
  use.fixed.reserve(access.fixed.size());
  use.ranges.reserve(access.fixed.size());
  for (int dimension : use.track->slabs.dimensions()) {
    auto index = std::find_if(
        access.fixed.begin(), access.fixed.end(),
        [&](const FixedIndex &fixed) { return fixed.dimension == dimension; });
    if (index == access.fixed.end())
      break;
    use.fixed.push_back(*index);
    use.ranges.push_back({access.field->firstIndex(dimension),
                          use.track->field->shape()[dimension]});
  }
  if (use.fixed.size() == 1 && use.fixed[0].bits == 64 &&
      use.fixed[0].terms.size() == 1) {
    const FixedIndex &index = use.fixed[0];
    auto shifted = static_cast<uint64_t>(index.constant) -
                   static_cast<uint64_t>(use.ranges[0].first);
    use.single = {index.terms[0], static_cast<int64_t>(shifted),
                  use.ranges[0].count};
  }
  return use;
}

/// Merges uses of every slab of a field at constant indices into one use of the
/// field: a kernel may use hundreds of columns of a matrix of weights.
static void mergeSlabs(std::vector<TapeMemory::Use> &uses) {
  std::map<const Track *, std::set<int64_t>> slabs;
  for (const TapeMemory::Use &use : uses) {
    SlabRange range = use.isConstant() ? use.locate(nullptr) : SlabRange();
    if (range.count == 1)
      slabs[use.track].insert(range.first);
  }
  for (const auto &[track, found] : slabs) {
    if (static_cast<int64_t>(found.size()) != track->slabs.count())
      continue;
    TapeMemory::Use *whole = nullptr;
    for (TapeMemory::Use &use : uses)
      if (use.track == track && use.isConstant())
        whole = &use;
    TapeMemory::Use merged = *whole;
    merged.fixed.clear();
    merged.ranges.clear();
    merged.single = {};
    uses.erase(std::remove_if(uses.begin(), uses.end(),
                              [&, track = track](const TapeMemory::Use &use) {
                                return use.track == track && use.isConstant();
                              }),
               uses.end());
    uses.push_back(std::move(merged));
  }
}

const TapeMemory::KernelUses &TapeMemory::usesOf(Kernel &kernel) {
  std::unique_ptr<KernelUses> &uses = kernelUses[&kernel];
  if (uses)
    return *uses;
  uses = std::make_unique<KernelUses>();
  const AdjointAccesses &plan = kernel.adjoint().plan();
  auto add = [](std::vector<Use> &list, auto &&use) {
    if (std::find(list.begin(), list.end(), use) == list.end())
      list.push_back(std::forward<decltype(use)>(use));
  };
  for (const Access &access : kernel.summary()) {
    if (access.field->isAdjoint() || !access.field->valid())
      continue;
    Use use = makeUse(access);
    add(uses->touches, use);
    if (access.kind == AccessKind::Read)
      continue;
    use.before = std::any_of(plan.before.begin(), plan.before.end(),
                             [&](const FieldPtr &field) {
                               return &trackOf(field, {}) == use.track;
                             });
    add(uses->changes, std::move(use));
  }
  for (const Access &access : plan.reads)
    if (!access.field->isAdjoint() && access.field->valid())
      add(uses->reads, makeUse(access));
  for (const Access &access : plan.stored.value_or(std::vector<Access>()))
    if (access.field->valid())
      add(uses->stored, makeUse(access));
  mergeSlabs(uses->reads);
  mergeSlabs(uses->stored);
  mergeSlabs(uses->touches);
  return *uses;
}

TapeMemory::Part TapeMemory::followedForward(Track &track, SlabRange range) {
  if (!track.ofPrimal) {
    const std::vector<FieldPtr> &fields = runtime.store().fields();
    auto primal =
        std::find_if(fields.begin(), fields.end(), [&](const FieldPtr &field) {
          return field->dual() == track.field.get();
        });
    track.ofPrimal = primal == fields.end() ? nullptr : *primal;
  }
  const FieldPtr &primal = *track.ofPrimal;
  if (!primal)
    return {&track, range};
  // The slabs of a dual field can differ from the slabs of its primal field, so
  // the whole primal field is followed.
  return {primal->isAdjoint() ? nullptr : &trackOf(primal, {}), {}};
}

const Track *TapeMemory::findTrack(const Field &field) const {
  auto track = tracks.find({&field.tree(), field.layout().placeOffset});
  return track == tracks.end() ? nullptr : track->second.get();
}

bool TapeMemory::isRead(const Field &field) const {
  const Track *track = findTrack(field);
  return track && track->lastRead != 0;
}

//===----------------------------------------------------------------------===//
// Forward
//===----------------------------------------------------------------------===//

Status TapeMemory::beforeLaunch(const KernelUses &uses, const uint64_t *args,
                                uint32_t record, bool isPart) {
  if (Status status = safepoints.checkHandler(); !status)
    return status;
  if (checkpoints) {
    checkpoints->reach(record);
    lost |= !isPart && !changedParts.empty();
  }
  for (const Use &use : uses.changes) {
    bool isStored = use.track->stored.any();
    // The sweep runs no adjoint for a launch that a host function made.
    bool before = use.before && !isPart;
    bool mayBeRead = use.track->lastRead != 0 || before || checkpoints;
    if (!isStored && !mayBeRead)
      continue;
    SlabRange changed = use.locate(args);
    if (isStored)
      use.track->stored.lose(changed, lostStored);
    if (!mayBeRead)
      continue;
    auto [followed, range] = followedFor(*use.track, changed);
    if (!followed)
      continue;
    Track &track = *followed;
    uint32_t stamp = before ? stampOf(record) : track.readStamp(range);
    Status status;
    if (checkpoints) {
      status = checkpoints->log(track, range);
      if (isPart)
        changedParts.push_back({&track, range});
    }
    if (stamp != 0 && status)
      status = propose({&track, range, record, stamp, before});
    if (!status)
      return status;
  }
  return Status::success();
}

void TapeMemory::afterLaunch(const KernelUses &uses, const uint64_t *args,
                             uint32_t record) {
  settle();
  for (const Use &use : uses.reads)
    use.track->markRead(use.locate(args), stampOf(record));
  for (const Use &use : uses.stored)
    use.track->stored.mark(use.locate(args), use.track->slabs.count(),
                           stampOf(record), lostStored);
}

void TapeMemory::afterPart(const KernelUses &uses, const uint64_t *args) {
  settle();
  for (const Use &use : uses.touches)
    parts.push_back({use.track, use.locate(args)});
}

Status TapeMemory::beforeWrite(const FieldPtr &written, const int64_t *index,
                               uint32_t record) {
  if (Status status = safepoints.checkHandler(); !status)
    return status;
  Track *followed = followedFor(trackOf(written, {}), {}).track;
  if (!followed)
    return Status::success();
  Track &track = *followed;
  const std::vector<int> &dimensions = track.slabs.dimensions();
  SlabRange range;
  if (index && !dimensions.empty()) {
    range = SlabRange::one(0);
    for (int d : dimensions)
      range.first =
          range.first * written->shape()[d] + index[d] - written->firstIndex(d);
  }
  parts.push_back({&track, range});
  track.stored.lose(range, lostStored);
  uint32_t stamp = track.readStamp(range);
  if (checkpoints) {
    checkpoints->reach(record);
    changedParts.push_back({&track, range});
    Status status = checkpoints->log(track, range);
    if (!status)
      return status;
  }
  return stamp ? propose({&track, range, record, stamp, false})
               : Status::success();
}

void TapeMemory::endParts(uint32_t record, bool readsInReverse) {
  if (readsInReverse)
    for (const Part &part : parts)
      part.track->markRead(part.range, stampOf(record));
  parts.clear();
  if (!changedParts.empty()) {
    std::vector<Part> &kept = partsByRecord[record];
    for (const Part &part : changedParts)
      if (std::find(kept.begin(), kept.end(), part) == kept.end())
        kept.push_back(part);
    changedParts.clear();
  }
}

const std::vector<TapeMemory::Part> &TapeMemory::partsAt(size_t record) const {
  static const std::vector<Part> none;
  auto found = partsByRecord.find(record);
  return found == partsByRecord.end() ? none : found->second;
}

Status TapeMemory::propose(Candidate candidate) {
  candidates.push_back(candidate);
  return checkpoints ? Status::success() : save(candidate);
}

Status TapeMemory::save(const Candidate &proposed) {
  Candidate candidate = proposed;
  auto [followed, range] = followedFor(*proposed.track, proposed.range);
  if (!followed)
    return Status::success();
  candidate.track = followed;
  candidate.range = range;
  Track &track = *followed;
  Status status = saveOne(candidate);
  if (!runtime.recordings().isForward()) {
    if (track.field->dual())
      tangents = Tangents::Lacking;
    return status;
  }
  Track *tangent = track.tangentIn(runtime);
  if (!status || !tangent)
    return status;
  Candidate its = candidate;
  its.track = tangent;
  return saveOne(its);
}

Status TapeMemory::saveOne(const Candidate &candidate) {
  Track &track = *candidate.track;
  track.refresh();
  track.savedAt.resize(static_cast<size_t>(track.numCells()));
  track.everSaved = true;
  if (track.slabs.byCell())
    growing.push_back(candidate);
  if (Status status = safepoints.begin(track.field->hostBytes()); !status)
    return status;
  return track.forEachRun(
      candidate.range,
      [&](int64_t cell) { return track.savedAt[cell] <= candidate.stamp; },
      [&](int64_t cell, int64_t endCell) {
        return addPiece(candidate, cell, endCell);
      });
}

Status TapeMemory::addPiece(const Candidate &candidate, int64_t cell,
                            int64_t endCell) {
  Track &track = *candidate.track;
  Piece piece{&track, candidate.record, candidate.before, cell, endCell, {}};
  Status status = safepoints.pass();
  if (status)
    status = piece.allocate(runtime,
                            saved + (checkpoints ? checkpoints->bytes() : 0));
  if (!status)
    return status;
  stampSaved(candidate, cell, endCell);
  saved += piece.keptBytes();
  pieces.push_back(std::move(piece));
  return Status::success();
}

void TapeMemory::stampSaved(const Candidate &candidate, int64_t cell,
                            int64_t endCell) {
  std::vector<uint32_t> &savedAt = candidate.track->savedAt;
  // A saved piece that is restored before the adjoint of its record serves that
  // adjoint too.
  uint32_t stamp = stampOf(candidate.record) + (candidate.before ? 1 : 0);
  std::fill(savedAt.begin() + cell, savedAt.begin() + endCell, stamp);
}

void TapeMemory::keepZeros() {
  for (const Candidate &candidate : growing) {
    Track &track = *candidate.track;
    auto first = static_cast<int64_t>(track.savedAt.size());
    track.refresh();
    int64_t end = track.numCells(), longest = track.longestRun();
    track.savedAt.resize(static_cast<size_t>(end));
    if (first < end)
      stampSaved(candidate, first, end);
    for (; first < end; first += longest)
      pieces.push_back({&track,
                        candidate.record,
                        candidate.before,
                        first,
                        std::min(first + longest, end),
                        {}});
  }
  growing.clear();
}

void TapeMemory::notePeak() {
  peak = std::max(peak, saved + (checkpoints ? checkpoints->bytes() : 0));
}

void TapeMemory::settle() {
  // This function returns early, because most launches of most programs save
  // nothing.
  if (growing.empty() && unsettled == pieces.size() && !checkpoints)
    return;
  keepZeros();
  if (checkpoints && checkpoints->count() > 0)
    checkpoints->settle();
  int64_t bytes = 0;
  for (size_t i = unsettled; i < pieces.size(); ++i)
    bytes += pieces[i].bytes();
  // If the host has interrupted the comparison, all copies are kept, needed or
  // not.
  bool compares = safepoints.begin(bytes).ok();
  size_t kept = unsettled;
  for (size_t i = unsettled; i < pieces.size(); ++i) {
    compares = compares && safepoints.pass().ok();
    Piece &piece = pieces[i];
    Track &track = *piece.track;
    if (compares && piece.holds()) {
      // The contents have not changed, so the last read still needs a save
      // before a later change.
      saved -= piece.keptBytes();
      std::fill(track.savedAt.begin() + piece.cell,
                track.savedAt.begin() + piece.endCell, 0);
      continue;
    }
    if (kept != i)
      pieces[kept] = std::move(piece);
    ++kept;
  }
  pieces.resize(kept);
  unsettled = kept;
  notePeak();
}

void TapeMemory::restart() {
  beginSegment(0);
  peak = 0;
  if (checkpoints)
    checkpoints->restart();
}

void TapeMemory::beginSegment(uint32_t record) {
  for (const Piece &piece : pieces)
    std::fill(piece.track->savedAt.begin() + piece.cell,
              piece.track->savedAt.begin() + piece.endCell, 0);
  pieces.clear();
  growing.clear();
  unsettled = 0;
  saved = 0;
  tangents = Tangents::Kept;
  nextCandidate = firstCandidate(record);
}

size_t TapeMemory::firstCandidate(uint32_t record) const {
  return static_cast<size_t>(
      std::lower_bound(candidates.begin(), candidates.end(), record,
                       [](const Candidate &candidate, uint32_t wanted) {
                         return candidate.record < wanted;
                       }) -
      candidates.begin());
}

Status TapeMemory::beforeReplay(uint32_t record, uint32_t oldest) {
  for (; nextCandidate < candidates.size() &&
         candidates[nextCandidate].record <= record;
       ++nextCandidate) {
    const Candidate &candidate = candidates[nextCandidate];
    if (candidate.stamp < stampOf(oldest))
      continue;
    Status status = save(candidate);
    if (!status)
      return status;
  }
  return Status::success();
}

int64_t TapeMemory::mostBytes(uint32_t from, uint32_t to) const {
  int64_t bytes = 0;
  for (size_t i = firstCandidate(from);
       i < candidates.size() && candidates[i].record < to; ++i)
    if (candidates[i].stamp >= stampOf(from))
      bytes += candidates[i].track->bytesOf(candidates[i].range);
  // In forward mode the duals of the fields are saved, too, and have the same
  // size.
  return runtime.recordings().isForward() ? 2 * bytes : bytes;
}

int64_t TapeMemory::bytesAt(uint32_t record) const {
  auto at = std::lower_bound(pieces.begin(), pieces.end(), record,
                             [](const Piece &piece, uint32_t record) {
                               return piece.record < record;
                             });
  int64_t bytes = 0;
  for (; at != pieces.end() && at->record == record; ++at)
    bytes += at->keptBytes();
  return bytes;
}

//===----------------------------------------------------------------------===//
// Reverse
//===----------------------------------------------------------------------===//

void TapeMemory::swap(Piece &piece) {
  const Slabs &slabs = piece.track->slabs;
  // A saved piece that was all zeros has no memory until it is restored.
  if (!piece.block && slabs.onDevice()) {
    Status status =
        slabs.zerosOnDevice(piece.first(), piece.count(), piece.block);
    if (!status) {
      piece.track->field->tree().mirror()->context().note(std::move(status));
      return;
    }
  }
  if (piece.block) {
    slabs.exchangeOnDevice(piece.first(), piece.count(), *piece.block);
    return;
  }
  if (slabs.byCell()) {
    slabs.exchange(piece.first(), piece.count(), piece.data.get());
    return;
  }
  // If memory runs out here, some pieces would be swapped and others not, so
  // the swap uses a small buffer on the stack.
  char few[8 << 10];
  char *held = few;
  int64_t element = slabs.elementBytes();
  int64_t most = static_cast<int64_t>(sizeof few) / element;
  std::vector<char> large;
  if (most == 0) {
    large.resize(static_cast<size_t>(element));
    held = large.data();
    most = 1;
  }
  for (int64_t i = 0; i < piece.count(); i += most) {
    int64_t count = std::min(most, piece.count() - i);
    char *kept = piece.data.get() + i * element;
    slabs.load(piece.first() + i, count, held);
    slabs.store(piece.first() + i, count, kept);
    std::memcpy(kept, held, static_cast<size_t>(count * element));
  }
}

/// Swaps the saved pieces [begin, end) with the contents of fields, on worker
/// threads if there are many.
void TapeMemory::swapSome(size_t begin, size_t end, int64_t bytes) {
  constexpr int64_t bytesPerPart = 1 << 20;
  // The saved pieces of one record do not overlap, so that several threads can
  // swap them.
  struct Job {
    Piece *const *pieces;
    int64_t count, parts;
  } job{some.data() + begin, static_cast<int64_t>(end - begin),
        std::clamp<int64_t>(bytes / bytesPerPart, 1,
                            2 * int64_t(runtime.threads()))};
  if (job.parts == 1 ||
      std::any_of(job.pieces, job.pieces + job.count, [](const Piece *piece) {
        return piece->block || piece->track->slabs.onDevice();
      })) {
    std::for_each(job.pieces, job.pieces + job.count,
                  [](Piece *piece) { swap(*piece); });
    return;
  }
  runtime.workers().parallel(
      job.parts,
      [](void *context, int64_t part) {
        const Job &job = *static_cast<Job *>(context);
        int64_t end = job.count * (part + 1) / job.parts;
        for (int64_t i = job.count * part / job.parts; i < end; ++i)
          swap(*job.pieces[i]);
      },
      &job);
}

Status TapeMemory::swapAll(FieldCopies::Interrupts interrupts) {
  int64_t bytes = 0;
  bool canStop = interrupts == FieldCopies::Interrupts::Stop;
  for (Piece *piece : some) {
    bytes += piece->bytes();
    if (piece->track->slabs.byCell() && !piece->track->slabs.onDevice() &&
        !piece->data)
      piece->data.reset(new char[static_cast<size_t>(piece->bytes())]());
    if (canStop)
      if (Status status = piece->track->bring(); !status)
        return status;
  }
  Status status = safepoints.begin(bytes);
  if (!status && canStop)
    return status;
  // Interruptions are held back, since they must not leave a piece of memory
  // half swapped.
  safepoint::Unstoppable whole;
  auto isStopped = [&] {
    return canStop && safepoint::Unstoppable::wasAsked();
  };
  for (size_t begin = 0, end = 0; begin < some.size(); begin = end) {
    if (begin > 0)
      (void)safepoints.pass();
    if (isStopped()) {
      for (size_t i = 0; i < begin; ++i) {
        swap(*some[i]);
        (void)safepoints.pass();
      }
      return failAsInterrupted();
    }
    int64_t most = FieldCopies::bytesPerSafepoint * int64_t(runtime.threads());
    int64_t taken = 0;
    while (end < some.size() && taken < most)
      taken += some[end++]->bytes();
    swapSome(begin, end, taken);
  }
  return Status::success();
}

Status TapeMemory::failWithoutTangents() {
  return Status::failure(
      StatusCode::Usage,
      "the tape has saved values that were overwritten without their tangents, "
      "because it was not recorded in forward mode; replay it in forward mode "
      "before its gradient is taken there: tape.replay()");
}

Status TapeMemory::beginReverse() {
  if (Status status = safepoints.checkHandler(); !status)
    return status;
  // Memory is allocated now, because the steps below must not fail.
  some.reserve(pieces.size());
  cursor = pieces.size();
  entered = -1;
  for (const Piece &piece : pieces)
    if (!piece.track->field->valid())
      return Status::failure(StatusCode::Usage,
                             "the tape has saved values of field '" +
                                 piece.track->field->name() +
                                 "', whose tree has been destroyed");
  // In forward mode, values that were saved without tangents cannot be
  // restored.
  if (runtime.recordings().isForward() && tangents == Tangents::Lacking)
    return failWithoutTangents();
  return Status::success();
}

/// Calls `visit` for the saved pieces that are restored before the adjoint of
/// the record which the sweep entered last.
template <typename Visit> void TapeMemory::forEachEntered(const Visit &visit) {
  for (size_t i = cursor; i > 0 && pieces[i - 1].record == entered; --i)
    if (pieces[i - 1].before)
      visit(pieces[i - 1]);
}

Status TapeMemory::enter(uint32_t record, bool reexecutes) {
  while (cursor > 0 && pieces[cursor - 1].record > record) {
    size_t first = cursor;
    uint32_t last = pieces[first - 1].record;
    some.clear();
    for (; first > 0 && pieces[first - 1].record == last; --first)
      if (!pieces[first - 1].before || entered != last)
        some.push_back(&pieces[first - 1]);
    if (Status status = swapAll(FieldCopies::Interrupts::Stop); !status)
      return status;
    cursor = first;
  }
  entered = record;
  some.clear();
  forEachEntered([&](Piece &piece) { some.push_back(&piece); });
  if (Status status = swapAll(FieldCopies::Interrupts::Stop); !status) {
    entered = -1;
    return status;
  }
  if (!reexecutes)
    return Status::success();
  beforeCopy.clear();
  beforeBlocks.clear();
  Status status;
  forEachEntered([&](Piece &piece) {
    if (status)
      status = safepoints.pass();
    if (!status)
      return;
    if (piece.block) {
      std::unique_ptr<DeviceBlock> copy;
      status =
          piece.track->slabs.keepOnDevice(piece.first(), piece.count(), copy);
      beforeBlocks.push_back(std::move(copy));
      return;
    }
    size_t at = beforeCopy.size();
    beforeCopy.resize(at + static_cast<size_t>(piece.bytes()));
    piece.track->slabs.load(piece.first(), piece.count(),
                            beforeCopy.data() + at);
  });
  return status;
}

void TapeMemory::leave(bool reexecutes) {
  if (!reexecutes)
    return;
  safepoint::Unstoppable whole;
  size_t at = 0, next = 0;
  forEachEntered([&](Piece &piece) {
    if (piece.block) {
      if (const std::unique_ptr<DeviceBlock> &copy = beforeBlocks[next++])
        piece.track->slabs.storeOnDevice(piece.first(), piece.count(), *copy);
      return;
    }
    (void)safepoints.pass();
    piece.track->slabs.store(piece.first(), piece.count(),
                             beforeCopy.data() + at);
    at += static_cast<size_t>(piece.bytes());
  });
}

void TapeMemory::endReverse() {
  // The saved pieces of the last record that have `before` set are restored
  // already.
  some.clear();
  for (; cursor > 0 && pieces[cursor - 1].record == entered; --cursor)
    if (!pieces[cursor - 1].before)
      some.push_back(&pieces[cursor - 1]);
  (void)swapAll(FieldCopies::Interrupts::Wait);
  while (cursor < pieces.size()) {
    uint32_t next = pieces[cursor].record;
    some.clear();
    for (; cursor < pieces.size() && pieces[cursor].record == next; ++cursor)
      some.push_back(&pieces[cursor]);
    (void)swapAll(FieldCopies::Interrupts::Wait);
  }
  entered = -1;
}
