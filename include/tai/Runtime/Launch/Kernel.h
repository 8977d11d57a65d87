//===- Kernel.h - Kernels of the runtime ------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A kernel is a function pointer, or a provider of one, with a summary of its
// accesses. The tape works from summaries alone.
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
#include "tai/Runtime/Threads/Section.h"
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

/// An entry of a summary.
struct Access {
  FieldPtr field;
  AccessKind kind;
  /// The fixed indices, in the order of their dimensions: launches with
  /// different values of a fixed index access different elements.
  std::vector<FixedIndex> fixed = {};
  /// For a write: the elements that are certainly stored, independent of the
  /// values of fields. Null where unknown or not a box.
  std::shared_ptr<const std::vector<StoredBox>> boxes = nullptr;

  bool operator==(const Access &other) const {
    return field == other.field && kind == other.kind && fixed == other.fixed;
  }
};

/// A sparse level over whose active cells a kernel loops: the tree, by its
/// position among the trees of the kernel, and the number of the level in it.
struct LoopLevel {
  int64_t tree;
  int64_t node;
};

/// A loop of an adjoint over a sparse field that can be skipped in cells where
/// all of `sources` are zero; with no sources, it cannot be skipped.
struct ZeroAdjoints {
  FieldPtr loop;
  std::vector<FieldPtr> sources;
};

/// An end of a float data flow in a kernel: a field, an array argument, or,
/// with neither, a scalar argument or a result.
struct FlowPlace {
  FieldPtr field = nullptr;
  /// The slot of an array's pointer, its rank and the bytes of an element.
  int64_t slot = -1, rank = 0, elementBytes = 0;
  /// Name of the field or of the argument.
  std::string name = {};
  /// Whether the kernel is differentiated with respect to the argument; for an
  /// array, the slot of the pointer to its adjoint.
  bool hasGradient = false;
  int64_t adjointSlot = -1;
  bool isResult = false;
  /// For an array: the elements that each launch stores, as in Access.
  std::vector<StoredBox> boxes = {};

  bool isArray() const { return slot >= 0; }
};

/// Floats stored to place `to` depend on floats of place `from`; numbers of
/// KernelFlows::places.
struct ValueFlow {
  size_t from, to;
  /// Source location of the store, as "file:line:column".
  std::string place;
  /// The kernel may itself read the stored value.
  bool isReadAgain = false;
};

struct KernelFlows {
  std::vector<FlowPlace> places;
  std::vector<ValueFlow> flows;
};

/// The addresses of an array's elements: `step` divides the distance between
/// any two.
struct ArrayRange {
  uint64_t begin, end;
  uint64_t step, elementBytes;

  bool overlaps(const ArrayRange &other) const;
  bool holds(const ArrayRange &other) const {
    return begin <= other.begin && other.end <= end && step == elementBytes;
  }
};

/// The memory that the adjoint of a kernel reads and changes; known before the
/// adjoint is compiled.
struct AdjointPlan {
  /// The primal fields that the adjoint reads.
  std::vector<Access> reads;
  /// Fields that the adjoint reads in the version before the launch.
  std::vector<FieldPtr> before;
  /// The adjoint re-executes the primal, which changes the fields that it
  /// reads.
  bool reexecutes = false;
  /// If not empty: the kernels recorded instead of this kernel, in this order.
  /// The parts have its arguments; one of the parts may return its results.
  std::vector<KernelPtr> parts;
  /// The plan is that of the zeroing variant of the adjoint, which must be
  /// used.
  bool zeroes = false;
  /// Not final, and not to be cached: the plan may change when further adjoint
  /// fields are declared.
  bool provisional = false;
  /// Fields of whose sparse levels the adjoint reads the activity.
  std::vector<FieldPtr> activity = {};
  /// The adjoint's loops over sparse fields.
  std::vector<ZeroAdjoints> flags = {};
  /// If there is a variant of the adjoint that loads stored outputs: its
  /// accesses beside `reads`. The variant is valid if nothing has changed the
  /// elements of these accesses since the launch.
  std::optional<std::vector<Access>> stored = std::nullopt;
  /// Array arguments whose elements the adjoint reads, by the slots of their
  /// pointers.
  std::vector<int64_t> arrays = {};
};

/// The adjoints of arguments and results, in memory of the caller. A launch
/// that may be differentiated passes the adjoints in slots after the slots of
/// the arguments: pointers and extents, as for arrays.
struct CallerAdjoints {
  int64_t slots = 0;
  /// The adjoint kernel adds to the adjoint of an argument or array.
  bool hasTargets = false;
  /// The adjoint kernel reads the adjoint of an array.
  bool hasArrays = false;
  /// The adjoint of a result: its pointer's slot, counted from the first slot
  /// of an adjoint, and its size.
  struct Result {
    int64_t slot;
    int64_t bytes;
  };
  std::vector<Result> results;

  bool hasSources() const { return hasArrays || !results.empty(); }
  /// True if all adjoints that the adjoint kernel reads are known to be zero.
  bool areZero(const uint64_t *callerSlots) const;
};

/// An array argument: the slot of its pointer, followed by the slots of its
/// extents, and the bytes of an element.
struct ArrayArgument {
  int64_t slot, rank, elementBytes;
};

struct KernelInfo {
  std::string name;
  /// Source location, as "file:line:column", or empty.
  std::string place = {};
  /// Slots of arguments and results; see Abi.h.
  int64_t argSlots = 0;
  int64_t resultSlots = 0;
  std::vector<ArrayArgument> arrays = {};
  CallerAdjoints callerAdjoints;
  /// The trees of the module, in the order of its `tai.tree` ops.
  std::vector<TreePtr> trees;
  /// The accesses of the kernel. The summary must be complete, because the tape
  /// ignores fields that are not listed.
  std::vector<Access> summary;
  /// The function; null where the provider makes it.
  TaiKernelFn function = nullptr;
  /// Makes the parts that are not given here; may be null if all are given.
  std::shared_ptr<KernelProvider> provider;
  /// The adjoint kernel; null where the provider makes it.
  KernelPtr adjoint;
  /// True if `adjoint` zeroes the adjoints of the elements that the kernel
  /// stores.
  bool zeroesAdjoints = false;
  /// False if the adjoint would do nothing; the tape then skips the kernel.
  bool differentiable = true;
  /// For a kernel that only loops over active cells: the levels of its loops.
  std::vector<LoopLevel> loopLevels;
  /// The kernel's code for the runtime's device; null if the function runs on
  /// the CPU alone.
  std::shared_ptr<const DeviceImage> image;
};

/// The data that is the same for all launches of a kernel, so that a launch
/// does not search the kernel's tables. Only for kernels whose launch is a mere
/// call of the function.
struct alignas(64) PreparedLaunch {
  /// The state of the runtime for which this data is valid; see LaunchState.
  std::atomic<uint64_t> state{0};
  TaiKernelFn function = nullptr;
  void **trees = nullptr;
  int64_t slots = 0;
  bool hasResults = false;
  /// Null for a launch on the CPU.
  const DeviceCode *code = nullptr;
  Mirror *const *mirrors = nullptr, *const *mirrorsEnd = nullptr;
  Mirror *const *changed = nullptr, *const *changedEnd = nullptr;
  /// Adjoint fields that the launch changes.
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
  /// Bytes that a launch reads and writes, assuming that the launch accesses
  /// each element of its fields (or of the slab of a fixed index) once.
  /// Negative if the summary is empty, or a field is sparse.
  int64_t touchedBytes() const;
  /// Whether the kernel uses the tree: known once its names are resolved.
  bool uses(const Tree &tree) const;
  int64_t argSlots() const { return info.argSlots; }
  /// Number of slots of a launch that may be differentiated.
  int64_t tapeSlots() const {
    return info.argSlots + info.callerAdjoints.slots;
  }
  int64_t resultSlots() const { return info.resultSlots; }
  const std::vector<ArrayArgument> &arrays() const { return info.arrays; }
  const CallerAdjoints &callerAdjoints() const { return info.callerAdjoints; }
  const std::vector<Access> &summary() const { return info.summary; }
  bool differentiable() const { return info.differentiable; }

  /// Compiles the kernel now instead of at the first launch. Thread-safe.
  Status resolve();
  bool resolved() const {
    return function.load(std::memory_order_acquire) != nullptr;
  }
  /// The adjoint, or its zeroing variant, compiled if necessary; null if there
  /// is nothing to differentiate. Thread-safe.
  Status resolveAdjoint(Kernel *&adjoint, bool zeroes = false);
  /// The variant of the adjoint that loads stored outputs, or its zeroing
  /// variant; null if there is none. Requires plan().stored.
  Status resolveStoredAdjoint(Kernel *&adjoint, bool zeroes);

  /// The memory accesses of the adjoint. Thread-safe.
  const AdjointPlan &plan();
  /// The data flow from loaded to stored values. Thread-safe.
  const KernelFlows &flows();
  /// Whether there is a plan, and it splits the kernel.
  bool hasParts() const { return adjointPlan && !adjointPlan->parts.empty(); }

  /// Whether the adjoint has a zeroing variant.
  bool hasZeroingAdjoint() const {
    return info.zeroesAdjoints ||
           (info.provider && info.provider->makesZeroingAdjoints());
  }

  /// The variant that checks the access rules; null if there is nothing to
  /// check.
  Status resolveChecked(CheckedKernel *&checked);

  /// The variant for forward mode; the kernel itself if it has no tangents.
  /// Thread-safe.
  Status resolveTangent(Kernel *&tangent);

  /// Call before the kernel is launched, or from its provider. A tree that the
  /// kernel has already is not replaced by a later tree of the same name: the
  /// kernel was compiled for the layout of the first tree.
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
  /// The cells that the loops of the last launch visited. Fails if activity has
  /// changed since in a way that the adjoint cannot handle.
  Status checkActivity(LoopLists &loops, bool &wasLaunched);

  /// Fails for a handler that has interrupted the compilation of this kernel.
  Status checkHandler() const { return Section::Entry(section).check(); }
  /// Fills the tables below; fails if a tree has been destroyed.
  Status bind(uint64_t epoch);
  /// Invalidates the results of `bind` and the prepared launch.
  void forget() {
    boundEpoch.store(0, std::memory_order_release);
    prepared.state.store(0, std::memory_order_release);
  }

  PreparedLaunch prepared;
  KernelInfo info;
  std::atomic<TaiKernelFn> function{nullptr};
  /// The resolver of an adjoint may resolve its primal. Entered during
  /// compilation, which has safepoints.
  mutable Section section;
  using Lock = Section::Entry;
  /// The variants of the adjoint: plain and zeroing, and the same two variants
  /// with stored outputs.
  struct AdjointForm {
    KernelPtr kernel;
    bool asked = false;
    /// Set when the adjoint is known, so that a sweep needs no lock.
    std::atomic<Kernel *> known{nullptr};
  };
  std::array<AdjointForm, 2> adjointForms, storedForms;
  std::shared_ptr<CheckedKernel> checked;
  std::unique_ptr<AdjointPlan> adjointPlan;
  /// The previous plan, which other threads may still read.
  std::unique_ptr<AdjointPlan> provisionalPlan;
  /// Why planning failed: an adjoint without a plan is not launched.
  Status planFailure;
  std::optional<KernelFlows> valueFlows;
  KernelPtr tangent;
  bool tangentAsked = false;

  /// True if no level that the kernel loops over has active cells.
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
  /// The levels of the kernel's loops, if it only loops over active cells;
  /// otherwise empty.
  std::vector<const SparseNode *> loopLevels;
  /// The epoch of the storage for which the tables are valid; 0 is never
  /// current.
  std::atomic<uint64_t> boundEpoch{0};
  /// Whether the kernel accesses an adjoint field, which may owe zeros.
  bool usesAdjoints = false;
  /// Adjoint fields that a launch may change.
  std::vector<Field *> changedAdjoints;
  /// Fields whose adjoints the adjoint kernel adds to: the fields that this
  /// kernel reads.
  std::vector<Field *> adjointTargets;
  /// Fields whose adjoints the adjoint kernel reads: the fields that this
  /// kernel changes.
  std::vector<Field *> adjointSources;
  /// The fields of `adjointSources` that are overwritten, not accumulated.
  std::vector<Field *> overwritten;
  /// Sparse levels of the kernel's trees. For an adjoint that is launched by
  /// hand: the state of the levels when the last launch began, and the cells
  /// that the loops of that launch visited.
  std::vector<SparseNode *> sparseNodes;
  std::mutex activityMutex;
  std::vector<SparseNode::Moment> lastBegins;
  LoopLists lastLoops;
  /// Stamp of the last tape that recorded this kernel.
  uint64_t tapeStamp = 0;
  /// The data of that tape about this kernel.
  const void *tapeUses = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNEL_H
