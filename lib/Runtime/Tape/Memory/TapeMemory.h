//===- TapeMemory.h - What a tape knows and keeps of memory -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Adjoints read primal values, and find them in the fields: as long as nothing
// has overwritten them. For each slab of a field (the elements with one index
// along the dimension that launches fix) this remembers which record last reads
// it in reverse. A launch that is about to change such a slab has its contents
// copied first; afterwards, only copies of cells that really changed are kept.
// The reverse sweep swaps them back in, and forward again when it is done.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_TAPEMEMORY_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_TAPEMEMORY_H

#include "Checkpoints.h"
#include <map>

namespace mlir::tai::runtime {

class TapeMemory {
public:
  explicit TapeMemory(Runtime &runtime) : runtime(runtime) {}

  /// From now on, what changes goes into snapshots while the sequence runs.
  void useCheckpoints(Checkpoints *snapshots) { checkpoints = snapshots; }

  /// A slab, or all of a field for -1.
  struct Part {
    Track *track;
    int64_t slab;
    bool operator==(const Part &other) const {
      return track == other.track && slab == other.slab;
    }
  };

  /// How the launches of a kernel use one field.
  struct Use {
    Track *track;
    /// Where the slab follows from the arguments.
    std::optional<FixedIndex> fixed;
    int64_t firstIndex = 0;
    /// Of changes: the adjoint reads the field as before the launch.
    bool before = false;

    /// The slab, or -1 for any.
    int64_t locate(const uint64_t *args) const;
    /// Whether it is at the same slab in all launches.
    bool isConstant() const { return !fixed || fixed->terms.empty(); }
    bool operator==(const Use &other) const {
      return track == other.track && fixed == other.fixed;
    }
  };
  struct KernelUses {
    std::vector<Use> changes;
    /// By the adjoint.
    std::vector<Use> reads;
    /// By the form of it that loads what the kernel has stored.
    std::vector<Use> stored;
    /// By the kernel, where it changes or reads them: what a host function of
    /// which it is a part may read in reverse.
    std::vector<Use> touches;
    bool reruns = false;
  };
  /// Plans the adjoint of the kernel if need be.
  const KernelUses &usesOf(Kernel &kernel);
  /// The same, or null where nobody has asked yet.
  const KernelUses *findUses(const Kernel &kernel) const {
    auto found = kernelUses.find(&kernel);
    return found == kernelUses.end() ? nullptr : found->second.get();
  }

  //===--------------------------------------------------------------------===//
  // Forward
  //===--------------------------------------------------------------------===//

  /// Before and after a launch. `record` is the number that it has or will
  /// have, or that of the host function that it is part of.
  Status beforeLaunch(const KernelUses &uses, const uint64_t *args,
                      uint32_t record, bool isPart);
  void afterLaunch(const KernelUses &uses, const uint64_t *args,
                   uint32_t record);
  /// After a launch that is part of a host function, which may read in reverse
  /// whatever it has touched.
  void afterPart(const KernelUses &uses, const uint64_t *args);
  /// Before and after the host writes a field or (one index) a slab of it.
  Status beforeWrite(const FieldPtr &field, const int64_t *index,
                     uint32_t record);
  /// The host function to which all parts since the last call belong.
  void endParts(uint32_t record, bool readsInReverse);
  /// Drops the copies of what did not change.
  void settle();

  /// Starts a forward replay of the same records; then before each of them.
  void restart();
  /// `oldest`: the first record whose adjoint may need what is overwritten.
  Status beforeReplay(uint32_t record, uint32_t oldest = 0);
  /// Forgets what was saved; the records from this one on will run again.
  void beginSegment(uint32_t record);
  /// The most that running [from, to) may save.
  int64_t mostBytes(uint32_t from, uint32_t to) const;
  /// What a host function or a write of the host changes; kept for snapshots
  /// only.
  const std::vector<Part> &partsAt(size_t record) const;
  /// Something has changed memory that no record stands for.
  bool lostChanges() const { return lost; }
  void notePeak();

  //===--------------------------------------------------------------------===//
  // Reverse
  //===--------------------------------------------------------------------===//

  /// Fails if a tree has been destroyed.
  Status beginReverse();
  /// Makes memory what it was after the record, or, where its adjoint wants it
  /// so, before. An adjoint that reruns its kernel changes such fields while it
  /// runs; `leave` then puts them back once more.
  void enter(uint32_t record, bool reruns);
  void leave(bool reruns);
  /// Makes memory what it was after all records.
  void endReverse();

  int64_t savedBytes() const { return saved; }
  int64_t peakBytes() const { return peak; }
  /// Bytes kept at a record.
  int64_t bytesAt(uint32_t record) const;
  /// Fields that some adjoint reads.
  bool isRead(const Field &field) const;
  /// Fields that hold what some adjoint may load as stored.
  bool isStored(const Field &field) const {
    const Track *track = findTrack(field);
    return track && track->stored.any();
  }
  /// Whether what the record has stored was not changed by a later one.
  bool holdsStored(uint32_t record) const {
    uint32_t stamp = stampOf(record);
    return stamp >= lostStored.size() || !lostStored[stamp];
  }
  /// Fields that some record reads or changes.
  bool isTouched(const Field &field) const { return findTrack(field); }
  /// Fields that the reverse sweep needs as they are. What is recomputed reads
  /// whatever launches read.
  bool minds(const Field &field) const {
    return checkpoints ? isTouched(field) : isRead(field);
  }
  bool empty() const { return pieces.empty(); }
  /// No launch of the sequence changes what an adjoint wants as it was.
  bool savesNothing() const { return pieces.empty() && candidates.empty(); }

private:
  /// A copy that may have to be made whenever the sequence runs.
  struct Candidate {
    Track *track;
    int64_t slab;
    uint32_t record;
    uint32_t stamp;
    bool before;
  };

  const Track *findTrack(const Field &field) const;
  Track &trackOf(const FieldPtr &field, const std::optional<FixedIndex> &fixed);
  Use makeUse(const Access &access);
  Status propose(Candidate candidate);
  size_t firstCandidate(uint32_t record) const;
  Status save(const Candidate &candidate);
  Status addPiece(const Candidate &candidate, int64_t cell, int64_t endCell);
  void stampSaved(const Candidate &candidate, int64_t cell, int64_t endCell);
  /// Cells that the record has made active held zeros before.
  void keepZeros();
  static void swap(Piece &piece, std::vector<char> &spare);
  /// Those of one record, on the workers where there is much to do.
  void swapAll(const std::vector<Piece *> &some);
  template <typename Visit> void forEachEntered(const Visit &visit);

  static uint32_t stampOf(uint32_t record) { return record + 2; }

  Runtime &runtime;
  /// By place: fields that name the same one share it.
  std::map<std::pair<const Tree *, int64_t>, std::unique_ptr<Track>> tracks;
  std::unordered_map<const Kernel *, std::unique_ptr<KernelUses>> kernelUses;
  std::vector<Candidate> candidates;
  /// Of the record to come: what its host function touches, and changes.
  std::vector<Part> parts, changedParts;
  std::unordered_map<size_t, std::vector<Part>> partsByRecord;
  bool lost = false;
  /// By stamp: records that have lost what they stored.
  std::vector<bool> lostStored;
  Checkpoints *checkpoints = nullptr;
  /// In the order of their records.
  std::vector<Piece> pieces;
  /// Those from here on have not been compared yet.
  size_t unsettled = 0;
  /// Of the record that runs: what is kept of sparse fields.
  std::vector<Candidate> growing;
  /// Next candidate of a forward replay.
  size_t nextCandidate = 0;
  /// In a reverse sweep: pieces from here on have been put back.
  size_t cursor = 0;
  /// The record whose pieces of the kind `before` have been put back.
  int64_t entered = -1;
  std::vector<char> spare;
  std::vector<Piece *> some;
  std::vector<char> beforeCopy;
  std::vector<std::unique_ptr<DeviceBlock>> beforeBlocks;
  int64_t saved = 0;
  int64_t peak = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_TAPEMEMORY_H
