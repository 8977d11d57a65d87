//===- Kernel.h - Compiled kernels as the runtime sees them -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A kernel is a function pointer, or a promise of one, with a summary of what
// it touches. The tape works from summaries alone.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_KERNEL_H
#define TAI_RUNTIME_LAUNCH_KERNEL_H

#include "tai/ABI/Abi.h"
#include "tai/ABI/LaunchAccesses.h"
#include "tai/Runtime/Launch/KernelProvider.h"
#include "tai/Runtime/Launch/LoopTimes.h"
#include "tai/Runtime/Sparse/LoopLists.h"
#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <array>
#include <functional>
#include <mutex>
#include <optional>

namespace mlir::tai::runtime {

class Kernel;
class Mirror;
struct CheckedKernel;
struct DeviceCode;
struct DeviceImage;
using KernelPtr = std::shared_ptr<Kernel>;

/// One line of a summary.
struct Access {
  FieldPtr field;
  AccessKind kind;
  /// The first index that is fixed, if any: launches that differ in it touch
  /// different elements.
  std::optional<FixedIndex> fixed = std::nullopt;
  /// Of a write: the elements that are stored, whatever the fields hold. Null
  /// where that depends on them, or is no box.
  std::shared_ptr<const std::vector<StoredBox>> boxes = nullptr;

  bool operator==(const Access &other) const {
    return field == other.field && kind == other.kind && fixed == other.fixed;
  }
};

/// A sparse level over whose active cells a kernel loops: the tree, by its
/// position among those of the kernel, and the number of the level in it.
struct LoopLevel {
  int64_t tree;
  int64_t node;
};

/// A loop of an adjoint over a sparse field that changes nothing in cells where
/// all of `sources` are zero; without any, it may.
struct ZeroAdjoints {
  FieldPtr loop;
  std::vector<FieldPtr> sources;
  /// It adds to elements that lie below no sparse level.
  bool sumsUp = false;
};

/// Where a kernel reads or stores floats: in a field, in an array among its
/// arguments, or, with neither, in a number that it takes or in what it
/// returns.
struct FlowPlace {
  FieldPtr field = nullptr;
  /// The slot of an array's pointer, its rank and the bytes of an element.
  int64_t slot = -1, rank = 0, elementBytes = 0;
  /// Of the field or of the argument.
  std::string name = {};
  /// The kernel is differentiated by the argument; and the slot of the pointer
  /// to the adjoint of an array.
  bool hasGradient = false;
  int64_t adjointSlot = -1;
  bool isResult = false;
  /// Of an array: elements that each launch stores, as of fields.
  std::vector<StoredBox> boxes = {};

  bool isArray() const { return slot >= 0; }
};

/// Floats of one place on which floats depend that the kernel stores to
/// another; places by their numbers.
struct ValueFlow {
  size_t from, to;
  /// Of the store, as "file:line:column".
  std::string place;
  /// The kernel may itself read what it has stored there.
  bool isReadAgain = false;
};

struct KernelFlows {
  std::vector<FlowPlace> places;
  std::vector<ValueFlow> flows;
};

/// The elements of an array in memory: `step` divides the distance between any
/// two.
struct ArrayRange {
  uint64_t begin, end;
  uint64_t step, elementBytes;

  bool overlaps(const ArrayRange &other) const;
  bool holds(const ArrayRange &other) const {
    return begin <= other.begin && other.end <= end && step == elementBytes;
  }
};

/// What the adjoint of a kernel asks of memory, known before its code is.
struct AdjointPlan {
  /// The fields of the primal that it reads.
  std::vector<Access> reads;
  /// Those that it reads as they were before the launch.
  std::vector<FieldPtr> before;
  /// It changes these while it runs.
  bool reruns = false;
  /// If not empty: what is recorded in the place of the kernel, in this order.
  /// They take its arguments; one of them may return its results.
  std::vector<KernelPtr> parts;
  /// It holds for the form of the adjoint that zeroes, which is the one to use.
  bool zeroes = false;
  /// Nothing of this is worth keeping: there may be more to plan when there are
  /// other adjoint fields.
  bool provisional = false;
  /// It asks which cells of the sparse levels above these are active.
  std::vector<FieldPtr> activity = {};
  /// Its loops over sparse fields.
  std::vector<ZeroAdjoints> flags = {};
  /// There is a form of it that loads what the kernel has stored. Besides what
  /// all forms read it reads these: it is right where nothing has changed them
  /// since the launch.
  bool loadsStored = false;
  std::vector<Access> stored = {};
  /// Array arguments whose elements it reads, by the slots of their pointers.
  std::vector<int64_t> arrays = {};
};

/// The adjoints of arguments and results, which are in memory of the caller. A
/// launch that may be differentiated passes them in slots after those of the
/// arguments: pointers and extents, as for arrays.
struct CallerAdjoints {
  int64_t slots = 0;
  /// The adjoint adds to that of an argument or array.
  bool hasTargets = false;
  /// It reads the adjoint of an array.
  bool hasArrays = false;
  /// The adjoint of a result: its pointer's slot, counted from the first of
  /// these slots, and its size.
  struct Result {
    int64_t slot;
    int64_t bytes;
  };
  std::vector<Result> results;

  bool hasSources() const { return hasArrays || !results.empty(); }
  /// True if all adjoints that the adjoint kernel reads are known to be zero.
  bool areZero(const uint64_t *callerSlots) const;
};

/// An array among the arguments: its pointer's slot, which those of its extents
/// follow, and the bytes of an element.
struct ArrayArgument {
  int64_t slot, rank, elementBytes;
};

struct KernelInfo {
  std::string name;
  /// Where it stands in the source, as "file:line:column", or empty.
  std::string place = {};
  /// Slots of arguments and results, as Abi.h counts them.
  int64_t argSlots = 0;
  int64_t resultSlots = 0;
  std::vector<ArrayArgument> arrays = {};
  CallerAdjoints callerAdjoints;
  /// The trees of the module, in the order of its `tai.tree` ops.
  std::vector<TreePtr> trees;
  /// What the kernel reads, writes and accumulates. It must be complete: a
  /// field left out is one that the tape may skip.
  std::vector<Access> summary;
  /// The function; null where the provider makes it.
  TaiKernelFn function = nullptr;
  /// Makes what is not here already; may be null where all is.
  std::shared_ptr<KernelProvider> provider;
  /// The adjoint kernel; null where the provider makes it.
  KernelPtr adjoint;
  /// True if `adjoint` leaves zero in the adjoints of what the kernel stores.
  bool zeroesAdjoints = false;
  /// False if an adjoint of the kernel would do nothing; the tape skips it.
  bool differentiable = true;
  /// Where the kernel does nothing but loop over active cells: of which levels.
  std::vector<LoopLevel> loopLevels;
  /// Its code for the device that the runtime uses; null where the function
  /// does everything on the CPU.
  std::shared_ptr<const DeviceImage> image;
};

/// What one launch of a kernel has in common with the next, found out once, so
/// that a launch does not go through the tables of the kernel. There is none
/// for kernels that need more than that their function is called.
struct alignas(64) PreparedLaunch {
  /// The state of the runtime for which it holds; see LaunchState.
  std::atomic<uint64_t> state{0};
  TaiKernelFn function = nullptr;
  void **trees = nullptr;
  int64_t slots = 0;
  bool hasResults = false;
  /// Null for a launch on the CPU.
  const DeviceCode *code = nullptr;
  Mirror *const *mirrors = nullptr, *const *mirrorsEnd = nullptr;
  Mirror *const *changed = nullptr, *const *changedEnd = nullptr;
  /// Adjoint fields that it changes.
  Field *const *adjoints = nullptr, *const *adjointsEnd = nullptr;
  /// Number of the last launch, so that an adjoint launched by hand sees the
  /// same random numbers.
  std::atomic<uint64_t> lastLaunch{0};
};

class Kernel : public std::enable_shared_from_this<Kernel> {
public:
  explicit Kernel(KernelInfo info);

  const std::string &name() const { return info.name; }
  const std::string &place() const { return info.place; }
  /// Bytes that a launch reads and writes, if it touches each element of its
  /// fields (or of the part of them that a fixed index says) once. Negative
  /// where nothing says what it touches, or a field is sparse.
  int64_t touchedBytes() const;
  /// Whether it uses the tree, once it is resolved.
  bool uses(const Tree &tree) const;
  int64_t argSlots() const { return info.argSlots; }
  /// Slots of a launch that may be differentiated.
  int64_t tapeSlots() const {
    return info.argSlots + info.callerAdjoints.slots;
  }
  int64_t resultSlots() const { return info.resultSlots; }
  const std::vector<ArrayArgument> &arrays() const { return info.arrays; }
  const CallerAdjoints &callerAdjoints() const { return info.callerAdjoints; }
  const std::vector<Access> &summary() const { return info.summary; }
  bool differentiable() const { return info.differentiable; }

  /// Compiles now what the first launch would compile. Any thread.
  Status resolve();
  bool resolved() const {
    return function.load(std::memory_order_acquire) != nullptr;
  }
  /// The adjoint, or the form of it that zeroes, made now if need be; null if
  /// there is nothing to differentiate. Any thread.
  Status resolveAdjoint(Kernel *&adjoint, bool zeroes = false);
  /// The same for the forms that load what the kernel has stored: null if there
  /// is none. Ask only where `plan` names what they read.
  Status resolveStoredAdjoint(Kernel *&adjoint, bool zeroes);

  /// What the adjoint asks of memory. Any thread.
  const AdjointPlan &plan();
  /// Which values that it stores depend on which that it reads. Any thread.
  const KernelFlows &flows();
  /// Whether the plan, if there is one, has parts.
  bool hasParts() const { return adjointPlan && !adjointPlan->parts.empty(); }

  /// Whether there is an adjoint that zeroes what the kernel stores.
  bool hasZeroingAdjoint() const {
    return info.zeroesAdjoints ||
           (info.provider && info.provider->makesZeroingAdjoints());
  }

  /// The form that checks the access rules; null if there is nothing to check.
  Status resolveChecked(CheckedKernel *&checked);

  /// What is launched in the place of this kernel in forward mode: itself, if
  /// it has no tangents to carry. Any thread.
  Status resolveTangent(Kernel *&tangent);

  /// To be called before the kernel is launched or from its resolver. A tree
  /// of the name of one that the kernel has already stays that one: it was
  /// made for its layout, not for that of a later tree of the same name.
  void setTrees(std::vector<TreePtr> trees);
  void setSummary(std::vector<Access> summary);
  void setLoopLevels(std::vector<LoopLevel> levels);
  void setDeviceImage(std::shared_ptr<const DeviceImage> image);

private:
  friend class Launcher;
  friend class DeviceLaunches;
  friend struct TapedKernel;

  void noteBegin();
  void noteLoops(const LoopLists &loops);
  /// What the loops of the last launch went over. Fails if activity has changed
  /// since so that the adjoint cannot run.
  Status checkActivity(LoopLists &loops, bool &wasLaunched);

  /// Fills the tables below; fails if a tree has been destroyed.
  Status bind(uint64_t epoch);
  /// What `bind` and launches have found out does not hold any more.
  void forget() {
    boundEpoch.store(0, std::memory_order_release);
    prepared.state.store(0, std::memory_order_release);
  }

  PreparedLaunch prepared;
  KernelInfo info;
  std::atomic<TaiKernelFn> function{nullptr};
  /// Recursive: the resolver of an adjoint may resolve its primal. Held while
  /// code is made, which looks up.
  std::recursive_timed_mutex mutex;
  using Lock = safepoint::Guard<std::recursive_timed_mutex>;
  /// Of the forms of the adjoint: the plain one and the one that zeroes, and
  /// these two where they load what the kernel has stored.
  struct AdjointForm {
    KernelPtr kernel;
    bool asked = false;
    /// Set once the adjoint has been found, so that a sweep takes no lock.
    std::atomic<Kernel *> known{nullptr};
  };
  std::array<AdjointForm, 2> adjointForms, storedForms;
  std::shared_ptr<CheckedKernel> checked;
  std::unique_ptr<AdjointPlan> adjointPlan;
  /// The one before, which others may look at still.
  std::unique_ptr<AdjointPlan> provisionalPlan;
  /// Why there is no plan: an adjoint that nobody planned for is not launched.
  Status planFailure;
  std::optional<KernelFlows> valueFlows;
  bool adjointReruns = false;
  bool loadsStored = false;
  bool alwaysZeroes = false;
  KernelPtr tangent;
  bool tangentAsked = false;

  /// True if none of the levels that the kernel loops over has active cells.
  bool hasNoActiveCells() const {
    for (const SparseNode *level : loopLevels)
      if (level->mayBeActive())
        return false;
    return true;
  }

  /// The code on the device, loaded when the kernel is first launched.
  std::shared_ptr<DeviceCode> deviceCode;
  std::vector<void *> bases;
  LoopTimes loopTimes;
  /// The levels that it loops over and does nothing else, or none.
  std::vector<const SparseNode *> loopLevels;
  /// State of the storage for which the tables hold; 0 is never current.
  std::atomic<uint64_t> boundEpoch{0};
  /// Adjoint fields that a launch may change.
  std::vector<Field *> changedAdjoints;
  /// Fields whose adjoints its adjoint adds to (fields that it reads).
  std::vector<Field *> adjointTargets;
  /// Fields whose adjoints its adjoint reads (fields that it changes).
  std::vector<Field *> adjointSources;
  /// Those of them that are overwritten, not accumulated.
  std::vector<Field *> overwritten;
  /// Sparse levels of its trees. Of the last launch: when it began for them,
  /// and what its loops went over, so that an adjoint launched by hand can
  /// tell.
  std::vector<SparseNode *> sparseNodes;
  std::mutex activityMutex;
  std::vector<SparseNode::Moment> lastBegins;
  LoopLists lastLoops;
  /// Stamp of the last tape that holds this kernel.
  uint64_t tapeStamp = 0;
  /// What that tape knows of it.
  const void *tapeUses = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNEL_H
