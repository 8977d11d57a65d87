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

/// An access of a kernel to a field: an entry of the kernel's summary.
struct Access {
  FieldPtr field;
  AccessKind kind;
  /// The indices that are the same in all iterations of a launch, in the order
  /// of their dimensions: launches with different values of such an index
  /// access different elements.
  std::vector<FixedIndex> fixed = {};
  /// For a write: boxes of elements that the launch certainly stores, whatever
  /// values fields hold. Null if they are unknown or do not form boxes.
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
struct SkippableLoop {
  FieldPtr loop;
  std::vector<FieldPtr> sources;
};

/// An end of a float data flow in a kernel: a field, an array argument, or,
/// with neither, a scalar argument or a result.
struct FlowPlace {
  FieldPtr field = nullptr;
  /// If the place is an array argument: the argument slot of its pointer, its
  /// rank, and the size of an element in bytes.
  int64_t slot = -1, rank = 0, elementBytes = 0;
  /// The name of the field or argument at this end of the data flow.
  std::string name = {};
  /// hasGradient: true if the kernel is differentiated with respect to this
  /// argument. adjointSlot: for an array, the slot of the pointer to its
  /// adjoint.
  bool hasGradient = false;
  int64_t adjointSlot = -1;
  bool isResult = false;
  /// For an array: boxes of elements that each launch certainly stores, as in
  /// Access::boxes.
  std::vector<StoredBox> boxes = {};

  bool isArray() const { return slot >= 0; }
};

/// A data flow of floats through a kernel: values stored to place `to` depend
/// on values read from place `from`. Both are indices into KernelFlows::places.
struct ValueFlow {
  size_t from, to;
  /// Source location of the store, as "file:line:column".
  std::string place;
  /// True if the kernel itself possibly reads the stored value afterwards.
  bool isReadAgain = false;
};

struct KernelFlows {
  std::vector<FlowPlace> places;
  std::vector<ValueFlow> flows;
};

/// The range of addresses of an array's elements. The distance between any two
/// elements is a multiple of `step`.
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
struct AdjointAccesses {
  /// The primal fields that the adjoint reads.
  std::vector<Access> reads;
  /// Fields of which the adjoint reads the contents from before the launch.
  std::vector<FieldPtr> before;
  /// True if the adjoint re-executes the primal kernel, which changes the
  /// fields that the adjoint reads.
  bool reexecutes = false;
  /// If not empty: the kernels into which this kernel was split. The tape
  /// records them, in this order, instead of this kernel. They take the
  /// arguments of this kernel; one of them may return its results.
  std::vector<KernelPtr> parts;
  /// True if this plan describes the zeroing variant of the adjoint, and the
  /// sweep must launch that variant.
  bool zeroes = false;
  /// True if the plan is preliminary, and must not be cached: it may change
  /// when further adjoint fields are declared.
  bool provisional = false;
  /// Fields for which the adjoint reads which cells of the sparse levels above
  /// them are active.
  std::vector<FieldPtr> activity = {};
  /// The adjoint's loops over sparse fields, which can be skipped in cells
  /// where their sources are zero.
  std::vector<SkippableLoop> flags = {};
  /// The accesses, beside `reads`, of the variant of the adjoint that loads
  /// outputs stored by the kernel; no value if there is no such variant. The
  /// variant is valid if nothing has changed the accessed elements since the
  /// launch.
  std::optional<std::vector<Access>> stored = std::nullopt;
  /// Array arguments whose elements the adjoint reads, by the numbers of the
  /// argument slots that hold their pointers.
  std::vector<int64_t> arrays = {};
};

/// The adjoints of arguments and results, in memory of the caller. A launch
/// that may be differentiated passes the adjoints in slots after the slots of
/// the arguments: pointers and extents, as for arrays.
struct CallerAdjoints {
  int64_t slots = 0;
  /// True if the adjoint kernel adds to the adjoint of an argument or array.
  bool hasTargets = false;
  /// True if the adjoint kernel reads the adjoint of an array argument.
  bool hasArrays = false;
  /// The adjoint of a result of the kernel: the slot of its pointer, counted
  /// from the first slot that holds an adjoint, and its size.
  struct Result {
    int64_t slot;
    int64_t bytes;
  };
  std::vector<Result> results;

  bool hasSources() const { return hasArrays || !results.empty(); }
  /// True if all those adjoints of the caller that the adjoint kernel reads are
  /// known to be zero. `callerSlots`: the slots of a launch that hold adjoints.
  bool areZero(const uint64_t *callerSlots) const;
};

/// An array argument: the argument slot of its pointer, which the slots of its
/// extents follow, and the bytes of an element.
struct ArrayArgument {
  int64_t slot, rank, elementBytes;
};

struct KernelInfo {
  std::string name;
  /// The source location of the kernel, as "file:line:column", or empty.
  std::string place = {};
  /// The numbers of 8-byte slots that the arguments and the results take; see
  /// Abi.h.
  int64_t argSlots = 0;
  int64_t resultSlots = 0;
  std::vector<ArrayArgument> arrays = {};
  CallerAdjoints callerAdjoints;
  /// The trees that the kernel's module declares, in the order of its
  /// `tai.tree` ops.
  std::vector<TreePtr> trees;
  /// The accesses of the kernel. The summary must be complete, because the tape
  /// ignores fields that are not listed.
  std::vector<Access> summary;
  /// The kernel's code for the CPU; null if the provider compiles it.
  TaiKernelFn function = nullptr;
  /// Makes, on demand, those parts of the kernel (function, adjoint, ...) that
  /// are null in this description; may itself be null if no part is missing.
  std::shared_ptr<KernelProvider> provider;
  /// The adjoint kernel; null if the provider makes it.
  KernelPtr adjoint;
  /// True if `adjoint` zeroes the adjoints of the elements that the kernel
  /// stores.
  bool zeroesAdjoints = false;
  /// False if the adjoint kernel would do nothing; the tape then skips the
  /// kernel.
  bool differentiable = true;
  /// For a kernel that only loops over active cells: the levels of its loops.
  std::vector<LoopLevel> loopLevels;
  /// The kernel's code for the runtime's device; null if the function runs on
  /// the CPU alone.
  std::shared_ptr<const DeviceImage> image;
};

/// Data that all launches of a kernel share, collected so that a launch need
/// not search the kernel's tables. Only for kernels whose launch is a mere call
/// of the function.
struct alignas(64) PreparedLaunch {
  /// The epoch of the runtime for which this data is valid; see LaunchState.
  std::atomic<uint64_t> state{0};
  TaiKernelFn function = nullptr;
  void **trees = nullptr;
  int64_t slots = 0;
  bool hasResults = false;
  /// The kernel's code on the device; null if the kernel runs on the CPU.
  const DeviceCode *code = nullptr;
  Mirror *const *mirrors = nullptr, *const *mirrorsEnd = nullptr;
  Mirror *const *changed = nullptr, *const *changedEnd = nullptr;
  /// The adjoint fields that the launch changes, as a range of pointers.
  Field *const *adjoints = nullptr, *const *adjointsEnd = nullptr;
  /// The number of the kernel's last launch: an adjoint that the user launches
  /// later uses the same random numbers.
  std::atomic<uint64_t> lastLaunch{0};
};

class Kernel : public std::enable_shared_from_this<Kernel> {
public:
  explicit Kernel(KernelInfo info);

  const std::string &name() const { return info.name; }
  const std::string &place() const { return info.place; }
  /// The number of bytes that a launch reads and writes, assuming that the
  /// launch accesses each element of its fields (or, with a fixed index, each
  /// element at that index) once. Negative if the summary is empty, or a field
  /// is sparse.
  int64_t touchedBytes() const;
  /// True if the kernel accesses the tree. Known only after the kernel has been
  /// resolved.
  bool uses(const Tree &tree) const;
  int64_t argSlots() const { return info.argSlots; }
  /// The number of argument slots of a launch that may be differentiated:
  /// arguments, then adjoints of arguments and results.
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
  /// Gives the adjoint kernel, or with `zeroes` its zeroing variant; compiles
  /// it if necessary. Null if there is nothing to differentiate. Thread-safe.
  Status resolveAdjoint(Kernel *&adjoint, bool zeroes = false);
  /// Gives the variant of the adjoint that loads outputs stored by this kernel,
  /// with `zeroes` its zeroing variant; null if there is no such variant.
  /// Requires that plan().stored has a value. Thread-safe.
  Status resolveStoredAdjoint(Kernel *&adjoint, bool zeroes);

  /// The plan of the adjoint: the memory that it reads and changes.
  /// Thread-safe.
  const AdjointAccesses &plan();
  /// The data flow from values that the kernel loads to values that it stores.
  /// Thread-safe.
  const KernelFlows &flows();
  /// True if the adjoint has been planned and the plan splits the kernel into
  /// several kernels.
  bool hasParts() const { return adjointPlan && !adjointPlan->parts.empty(); }

  /// True if the adjoint has a variant that zeroes the adjoints of the elements
  /// that this kernel stores.
  bool hasZeroingAdjoint() const {
    return info.zeroesAdjoints ||
           (info.provider && info.provider->makesZeroingAdjoints());
  }

  /// Gives the variant of the kernel that checks the data access rules; null if
  /// there is nothing to check.
  Status resolveChecked(CheckedKernel *&checked);

  /// Gives the variant of the kernel for forward mode; the kernel itself if it
  /// has no tangents. Thread-safe.
  Status resolveTangent(Kernel *&tangent);

  /// Sets the kernel's trees. Must be called before the kernel is launched, or
  /// by its provider. If the kernel already has a tree of some name, a later
  /// tree of this name does not replace it, because the kernel was compiled for
  /// the layout of the first tree.
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
  /// Gives, for an adjoint launched by the user, the cells that the loops of
  /// the kernel's last launch visited. Fails if activity has changed since then
  /// in a way that the adjoint cannot handle.
  Status checkActivity(LoopLists &loops, bool &wasLaunched);

  /// Fails in a signal handler that has interrupted the compilation of this
  /// kernel.
  Status checkHandler() const { return Section::Entry(section).check(); }
  /// Fills the tables of fields and trees that launches use (the members
  /// below), for the storage's state `epoch`. Fails if a tree has been
  /// destroyed.
  Status bind(uint64_t epoch);
  /// Invalidates the results of `bind` and the prepared launch.
  void forget() {
    boundEpoch.store(0, std::memory_order_release);
    prepared.state.store(0, std::memory_order_release);
  }

  PreparedLaunch prepared;
  KernelInfo info;
  std::atomic<TaiKernelFn> function{nullptr};
  /// The lock of a kernel's compilation. A section rather than a mutex, because
  /// compilation has safepoints, and the resolver of an adjoint may resolve its
  /// primal.
  mutable Section section;
  using Lock = Section::Entry;
  /// A variant of the adjoint kernel. There are four: plain and zeroing, each
  /// without and with loading of stored outputs.
  struct AdjointForm {
    KernelPtr kernel;
    bool asked = false;
    /// The adjoint kernel, once it has been made: a sweep reads this pointer
    /// without a lock.
    std::atomic<Kernel *> known{nullptr};
  };
  std::array<AdjointForm, 2> adjointForms, storedForms;
  std::shared_ptr<CheckedKernel> checked;
  std::unique_ptr<AdjointAccesses> adjointPlan;
  /// The plan of the adjoint before the current plan, kept because other
  /// threads may still read it.
  std::unique_ptr<AdjointAccesses> provisionalPlan;
  /// The error of the attempt to plan the adjoint: an adjoint without a plan is
  /// not launched.
  Status planFailure;
  std::optional<KernelFlows> valueFlows;
  KernelPtr tangent;
  bool tangentAsked = false;

  /// True if the kernel only loops over active cells of sparse levels, and no
  /// such level has an active cell.
  bool hasNoActiveCells() const {
    for (const SparseNode *level : loopLevels)
      if (level->mayBeActive())
        return false;
    return true;
  }

  /// The kernel's code on the device, loaded when the kernel is first launched.
  std::shared_ptr<DeviceCode> deviceCode;
  std::vector<void *> bases;
  LoopTimes loopTimes;
  /// If the kernel only loops over active cells: the sparse levels of its
  /// loops. Otherwise empty.
  std::vector<const SparseNode *> loopLevels;
  /// The epoch of the storage for which the tables of bind() are valid; 0
  /// before the first bind().
  std::atomic<uint64_t> boundEpoch{0};
  /// True if the kernel accesses an adjoint field, for which zeros may have to
  /// be stored first.
  bool usesAdjoints = false;
  /// The adjoint fields that a launch of this kernel may change.
  std::vector<Field *> changedAdjoints;
  /// Fields to whose adjoints the adjoint kernel adds: the fields that this
  /// kernel reads.
  std::vector<Field *> adjointTargets;
  /// Fields whose adjoints the adjoint kernel reads: the fields that this
  /// kernel changes.
  std::vector<Field *> adjointSources;
  /// The fields that the kernel overwrites rather than adds to; a subset of
  /// `adjointSources`.
  std::vector<Field *> overwritten;
  /// Sparse levels of the kernel's trees. For an adjoint that is launched by
  /// hand: the state of the levels when the last launch began, and the cells
  /// that the loops of that launch visited.
  std::vector<SparseNode *> sparseNodes;
  std::mutex activityMutex;
  std::vector<SparseNode::Moment> lastBegins;
  LoopLists lastLoops;
  /// The stamp (a unique number) of the last tape that recorded this kernel.
  uint64_t tapeStamp = 0;
  /// Data about this kernel that belongs to the tape with stamp `tapeStamp`.
  const void *tapeUses = nullptr;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNEL_H
