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
#include "tai/Runtime/Launch/KernelAdjoint.h"
#include "tai/Runtime/Launch/KernelProvider.h"
#include "tai/Runtime/Launch/KernelTables.h"
#include "tai/Runtime/Launch/LastActivity.h"
#include "tai/Runtime/Launch/LoopTimes.h"
#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Threads/Section.h"
#include <optional>

namespace mlir::tai::runtime {

class Kernel;
class Mirror;
struct CheckedKernel;
struct DeviceCode;
struct DeviceImage;
struct Launch;
using KernelPtr = std::shared_ptr<Kernel>;

/// A sparse level over whose active cells a kernel loops: the tree, by its
/// position among the trees of the kernel, and the number of the level in it.
struct LoopLevel {
  int64_t tree;
  int64_t node;
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
  /// True if the kernel only reads and writes the fields of its summary, so
  /// that a launch with the same arguments and the same values changes nothing.
  bool isRepeatable = false;
  /// For a kernel that only loops over active cells: the levels of its loops.
  std::vector<LoopLevel> loopLevels;
  /// For an adjoint kernel: the adjoint fields that it can store without
  /// reading them before, in the order of the bits of TaiFrame::zeroAdjoints.
  std::vector<std::string> storesFirst = {};
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
  bool isRepeatable() const { return info.isRepeatable; }
  const std::vector<std::string> &storesFirst() const {
    return info.storesFirst;
  }
  const std::vector<TreePtr> &trees() const { return info.trees; }

  /// Compiles the kernel now instead of at the first launch. Thread-safe.
  Status resolve();
  bool resolved() const {
    return function.load(std::memory_order_acquire) != nullptr;
  }
  /// The plan and the variants of the adjoint.
  KernelAdjoint &adjoint() { return adjointVariants; }
  const KernelAdjoint &adjoint() const { return adjointVariants; }
  /// The data flow from values that the kernel loads to values that it stores.
  /// Thread-safe.
  const KernelFlows &flows();

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

  /// Fills the tables, for the storage's state `epoch`. Fails if a tree has
  /// been destroyed.
  Status bind(uint64_t epoch);
  /// The tables that bind() has filled.
  const KernelTables &tables() const { return bound; }

  /// True if a launch of the kernel only calls its function with trees and
  /// arguments, without sparse cells, results or adjoints of the caller.
  /// Requires bind().
  bool isDirect() const {
    return bound.sparseNodes.empty() && bound.loopLevels.empty() &&
           info.resultSlots == 0 && info.callerAdjoints.slots == 0;
  }
  /// Calls the function of a direct kernel with the arguments of `launch`.
  int32_t callDirectly(Launch &launch);
  /// The number of the last launch.
  uint64_t lastLaunch() const {
    return prepared.lastLaunch.load(std::memory_order_relaxed);
  }
  void setLastLaunch(uint64_t number) {
    prepared.lastLaunch.store(number, std::memory_order_relaxed);
  }

private:
  friend class Launcher;
  friend class DeviceLaunches;

  /// Fails in a signal handler that has interrupted the compilation of this
  /// kernel.
  Status checkHandler() const { return Section::Entry(section).check(); }
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
  KernelAdjoint adjointVariants;
  std::shared_ptr<CheckedKernel> checked;
  std::optional<KernelFlows> valueFlows;
  /// The variant for forward mode, once the provider has been asked for it.
  std::optional<KernelPtr> tangent;

  /// The kernel's code on the device, loaded when the kernel is first launched.
  std::shared_ptr<DeviceCode> deviceCode;
  LoopTimes loopTimes;
  KernelTables bound;
  /// The epoch of the storage for which `bound` is valid; 0 before the first
  /// bind().
  std::atomic<uint64_t> boundEpoch{0};
  LastActivity lastActivity;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNEL_H
