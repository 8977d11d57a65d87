//===- TapeMemory.h - Saved values of a tape --------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Adjoints read primal values from the fields, unless these have been
// overwritten. For each slab of a field (the elements with the same indices
// along dimensions of fixed indices) this tracks the last record whose adjoint
// reads it. Before a launch changes such a slab, its contents are copied;
// afterwards, only copies of cells that have really changed are kept. The
// reverse sweep swaps them back in, and finally restores the last contents.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_MEMORY_TAPEMEMORY_H
#define TAI_LIB_RUNTIME_TAPE_MEMORY_TAPEMEMORY_H

#include "Checkpoints.h"
#include <algorithm>
#include <map>

namespace mlir::tai::runtime {

class TapeMemory {
public:
  explicit TapeMemory(Runtime &runtime) : runtime(runtime) {}

  /// Attaches checkpoints: from now on, values overwritten by the running
  /// sequence go into snapshots.
  void useCheckpoints(Checkpoints *snapshots) { checkpoints = snapshots; }

  struct Part {
    Track *track;
    SlabRange range;
    bool operator==(const Part &other) const {
      return track == other.track && range == other.range;
    }
  };

  /// Describes how the launches of a kernel use one field.
  struct Use {
    Track *track;
    /// The indices that are fixed in a launch along some leading dimensions, by
    /// which the slabs of the field are told apart.
    std::vector<FixedIndex> fixed;
    /// The range of the field's indices along each dimension in which an access
    /// fixes the index.
    std::vector<SlabRange> ranges;
    /// For a use that changes the field: true if the adjoint reads the contents
    /// from before the launch.
    bool before = false;

    /// The term of the only fixed index, if it is a multiple of one argument
    /// plus a constant: a launch evaluates this term without following
    /// pointers.
    struct Single {
      LaunchTerm term;
      int64_t constant = 0, extent = -1;
    } single;

    /// Returns the slabs of the field that a launch with the arguments `args`
    /// uses; all slabs if an index is not known. Inline, since each launch
    /// evaluates several uses.
    __attribute__((always_inline)) SlabRange
    locate(const uint64_t *args) const {
      if (__builtin_expect(single.extent != track->slabs.count(), false))
        return locateAny(args);
      uint64_t position = static_cast<uint64_t>(single.constant) +
                          static_cast<uint64_t>(single.term.getArgument(args)) *
                              static_cast<uint64_t>(single.term.factor);
      return position < static_cast<uint64_t>(single.extent)
                 ? SlabRange::one(static_cast<int64_t>(position))
                 : SlabRange();
    }
    SlabRange locateAny(const uint64_t *args) const;
    /// True if the kernel uses the same slabs of the field in all launches.
    bool isConstant() const {
      return std::all_of(
          fixed.begin(), fixed.end(),
          [](const FixedIndex &index) { return index.terms.empty(); });
    }
    bool operator==(const Use &other) const {
      return track == other.track && fixed == other.fixed;
    }
  };
  struct KernelUses {
    std::vector<Use> changes;
    /// Reads of the adjoint.
    std::vector<Use> reads;
    /// Reads by the variant of the adjoint that loads the kernel's stored
    /// outputs.
    std::vector<Use> stored;
    /// All accesses of the kernel itself, since the reverse of a host function
    /// that launches the kernel may read this memory.
    std::vector<Use> touches;
    /// True if the tape has adopted the kernel while no other tape recorded.
    bool isAdopted = false;
  };
  /// The part to save and restore for a change of `range`. In forward mode, a
  /// dual is saved with its primal field, so the part is the whole primal
  /// field; its track is null for the tangent of a gradient, which the tape
  /// does not restore. In all other cases, the part is `range` itself.
  Part followedFor(Track &track, SlabRange range) {
    return __builtin_expect(runtime.recordings().isForward(), false)
               ? followedForward(track, range)
               : Part{&track, range};
  }
  /// Returns how a kernel uses fields; plans its adjoint if necessary.
  const KernelUses &usesOf(Kernel &kernel);
  void noteAdopted(const Kernel &kernel) {
    kernelUses.at(&kernel)->isAdopted = true;
  }
  /// Returns how a kernel uses fields, or null before the first usesOf(kernel).
  const KernelUses *findUses(const Kernel &kernel) const {
    auto found = kernelUses.find(&kernel);
    return found == kernelUses.end() ? nullptr : found->second.get();
  }

  //===--------------------------------------------------------------------===//
  // Forward
  //===--------------------------------------------------------------------===//

  /// Must be called before and after a launch. `record`: the number of its
  /// record or, if `isPart`, of the record of the host function that makes the
  /// launch.
  Status beforeLaunch(const KernelUses &uses, const uint64_t *args,
                      uint32_t record, bool isPart);
  void afterLaunch(const KernelUses &uses, const uint64_t *args,
                   uint32_t record);
  /// Notes the accesses of a launch that a host function made, because the
  /// reverse of the function may read whatever the launch has accessed.
  void afterPart(const KernelUses &uses, const uint64_t *args);
  /// Saves the values that a write of the host overwrites: of a field or, with
  /// an index, of one slab. Must be called before the write.
  Status beforeWrite(const FieldPtr &field, const int64_t *index,
                     uint32_t record);
  /// Assigns the launches and writes since the last call to this record, which
  /// is a host function or a write.
  void endParts(uint32_t record, bool readsInReverse);
  /// Drops saved copies of cells that did not change.
  void settle();

  /// Starts a forward replay of the same records; call beforeReplay before each
  /// of them.
  void restart();
  /// Saves the values that a repeated record overwrites. `oldest`: the first
  /// record whose adjoint may need them.
  Status beforeReplay(uint32_t record, uint32_t oldest = 0);
  /// Drops all saved values, since the records from `record` on will be
  /// re-executed.
  void beginSegment(uint32_t record);
  /// An upper bound of the bytes that running the records [from, to) may save.
  int64_t mostBytes(uint32_t from, uint32_t to) const;
  /// The parts of fields that the record, a host function or a write of the
  /// host, changes; kept for snapshots only.
  const std::vector<Part> &partsAt(size_t record) const;
  /// True if memory was changed by an action that is not recorded.
  bool lostChanges() const { return lost; }
  void notePeak();

  //===--------------------------------------------------------------------===//
  // Reverse
  //===--------------------------------------------------------------------===//

  /// Fails if a tree has been destroyed, and in forward mode if values were
  /// saved without their tangents.
  Status beginReverse();
  static Status failWithoutTangents();
  /// Restores memory to the state after the record; but fields whose version
  /// before the record the adjoint reads, to that version. If the adjoint
  /// `reexecutes` (re-executes) its kernel, it changes such fields; `leave`
  /// then restores them again. Fails if the host interrupts it; then, only
  /// `endReverse` may follow.
  Status enter(uint32_t record, bool reexecutes);
  void leave(bool reexecutes);
  /// Restores memory to its state after all records.
  void endReverse();

  int64_t savedBytes() const { return saved; }
  int64_t peakBytes() const { return peak; }
  /// The bytes saved at a record.
  int64_t bytesAt(uint32_t record) const;
  /// True if some adjoint reads the primal values of the field.
  bool isRead(const Field &field) const;
  /// True if the field holds stored outputs that some adjoint may load.
  bool isStored(const Field &field) const {
    const Track *track = findTrack(field);
    return track && track->stored.any();
  }
  /// True if no later record has changed the outputs that this record has
  /// stored.
  bool holdsStored(uint32_t record) const {
    uint32_t stamp = stampOf(record);
    return stamp >= lostStored.size() || !lostStored[stamp];
  }
  /// True if some record reads or changes the field.
  bool isTouched(const Field &field) const { return findTrack(field); }
  /// True if the reverse sweep needs the current values of the field. With
  /// checkpoints, re-executed launches need whatever launches read.
  bool needsValues(const Field &field) const {
    return checkpoints ? isTouched(field) : isRead(field);
  }
  bool empty() const { return pieces.empty(); }
  /// True if no launch of the sequence changes values that an adjoint reads.
  bool savesNothing() const { return pieces.empty() && candidates.empty(); }

private:
  /// A range of values that runs of the sequence may have to save, and the
  /// record that overwrites them.
  struct Candidate {
    Track *track;
    SlabRange range;
    uint32_t record;
    uint32_t stamp;
    bool before;
  };

  Part followedForward(Track &track, SlabRange range);
  const Track *findTrack(const Field &field) const;
  Track &trackOf(const FieldPtr &field, const std::vector<FixedIndex> &fixed);
  Use makeUse(const Access &access);
  Status propose(Candidate candidate);
  size_t firstCandidate(uint32_t record) const;
  Status save(const Candidate &candidate);
  Status saveOne(const Candidate &candidate);
  Status addPiece(const Candidate &candidate, int64_t cell, int64_t endCell);
  void stampSaved(const Candidate &candidate, int64_t cell, int64_t endCell);
  /// Saves zeros as the former contents of cells that the record has activated.
  void keepZeros();
  static void swap(Piece &piece);
  /// Swaps all pieces in `some`, which are of one record, with the contents of
  /// fields. If the host interrupts the swaps, the swapped pieces are swapped
  /// back.
  Status swapAll(FieldCopies::Interrupts interrupts);
  void swapSome(size_t begin, size_t end, int64_t bytes);
  template <typename Visit> void forEachEntered(const Visit &visit);

  static uint32_t stampOf(uint32_t record) { return record + 2; }

  Runtime &runtime;
  /// The tracks by tree and offset: fields at the same place of a tree share a
  /// track.
  std::map<std::pair<const Tree *, int64_t>, std::unique_ptr<Track>> tracks;
  std::unordered_map<const Kernel *, std::unique_ptr<KernelUses>> kernelUses;
  std::vector<Candidate> candidates;
  /// parts: accesses to memory since the last record, by launches of a host
  /// function and by writes. changedParts: the changes among them, kept for
  /// snapshots.
  std::vector<Part> parts, changedParts;
  std::unordered_map<size_t, std::vector<Part>> partsByRecord;
  bool lost = false;
  /// For the stamp of each record: true if its stored outputs have been changed
  /// since.
  std::vector<bool> lostStored;
  Checkpoints *checkpoints = nullptr;
  /// The saved pieces, in the order of their records.
  std::vector<Piece> pieces;
  /// The saved pieces from this number on have not been compared with their
  /// fields yet.
  size_t unsettled = 0;
  /// Values that were saved outside forward mode lack their tangents.
  enum class Tangents { Kept, Lacking };
  Tangents tangents = Tangents::Kept;
  /// Checks for interrupts during saves, comparisons and restorations.
  CopySafepoints safepoints;
  /// Saves from sparse fields in which the running record may activate cells.
  std::vector<Candidate> growing;
  /// The number of the next element of `candidates` in a forward replay.
  size_t nextCandidate = 0;
  /// In a reverse sweep, the saved pieces from this number on have been
  /// restored.
  size_t cursor = 0;
  /// The record whose saved pieces with `before` have been restored, or -1.
  int64_t entered = -1;
  std::vector<Piece *> some;
  std::vector<char> beforeCopy;
  std::vector<std::unique_ptr<DeviceBlock>> beforeBlocks;
  int64_t saved = 0;
  int64_t peak = 0;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_MEMORY_TAPEMEMORY_H
