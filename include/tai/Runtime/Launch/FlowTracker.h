//===- FlowTracker.h - Ends of derivatives ----------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Follows launches in order and finds, for each field and array, the cuts in
// the derivative of its values. A cut is a store of a value with a derivative
// to memory without one, from which the value was read again.
//
// If a launch changes nothing of this state, and does not depend on its
// arguments, the next launch of its kernel costs one look-up.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_FLOWTRACKER_H
#define TAI_RUNTIME_LAUNCH_FLOWTRACKER_H

#include "tai/Runtime/Launch/Kernel.h"
#include <map>
#include <unordered_map>
#include <unordered_set>

namespace mlir::tai::runtime {

/// The address range of an array argument of a launch; arrays are contiguous.
inline ArrayRange rangeOf(const FlowPlace &place, const uint64_t *args) {
  auto bytes = static_cast<uint64_t>(place.elementBytes);
  uint64_t all = bytes;
  for (int64_t d = 0; d < place.rank; ++d)
    all *= args[place.slot + 1 + d];
  return {args[place.slot], args[place.slot] + all, bytes, bytes};
}

class FlowTracker {
public:
  enum class Mode : uint8_t { Reverse, Forward };

  /// Numbers of cuts, ascending.
  using CutSet = std::vector<unsigned>;

  /// Creates a tracker of derivatives. `fields`: all fields of the runtime.
  FlowTracker(Mode mode, const std::vector<FieldPtr> &fields);

  /// Marks a field as having a tangent, in forward mode.
  void addSource(const Field &field);
  /// Notes that the memory at `address`, which a later launch gets, is a copy
  /// of `array`.
  void addCopy(uint64_t address, const ArrayRange &array) {
    copies[address] = array;
  }

  void launch(Kernel &kernel, const uint64_t *args);
  /// Notes that the host has overwritten the field or array.
  void overwrite(const Field &field);
  void overwrite(const ArrayRange &array);

  /// The places at which derivatives of the field's values were cut off.
  const CutSet &cutsOf(const Field &field) const;
  /// The places at which derivatives of arrays were cut off, for arrays with
  /// gradients for whose adjoints `isWanted` holds.
  using Wants = std::function<bool(uint64_t adjoint, uint64_t bytes)>;
  CutSet cutsOfArrays(const Wants &isWanted) const;
  const CutSet &cutsOfResults() const { return fromResults; }

  /// nameOf: a key for a cut (its kernel and location), by which a cut is
  /// reported only once. describe: the text of the warning.
  std::string nameOf(unsigned cut) const;
  std::string describe(unsigned cut) const;

private:
  struct State {
    /// For a field with a dual: true if the field may have a tangent.
    bool isActive = false;
    CutSet cuts;

    bool empty() const { return !isActive && cuts.empty(); }
    /// Adds the tangent and the cuts of `more`; returns true if this state has
    /// changed.
    bool add(const State &more);
  };
  struct ArrayState {
    ArrayRange range;
    uint64_t adjoint; // of an array with a gradient
    State state;
  };
  struct Cut {
    std::string kernel;
    std::string line;
    std::string fromName, toName;
    bool isFromSource, isToArray;
  };
  struct Known {
    bool dependsOnArguments;
    uint64_t version = 0;
  };

  bool hasDerivative(const FlowPlace &place) const;
  bool endsDerivatives(const FlowPlace &place) const;
  bool isIgnored(const FlowPlace &place) const;
  ArrayRange findRange(const FlowPlace &place, const uint64_t *args) const;
  State stateOf(const FlowPlace &place, const uint64_t *args) const;
  void store(const FlowPlace &place, const uint64_t *args, const State &added,
             bool replaces);
  unsigned number(const Kernel &kernel, const KernelFlows &known,
                  const ValueFlow &flow);
  bool dependsOnArguments(Kernel &kernel) const;

  Mode mode;
  /// Fields that are adjoints or duals of other fields, and are not tracked
  /// themselves.
  std::unordered_set<const Field *> companions;
  std::unordered_map<const Field *, State> ofFields;
  /// The tracked states of arrays, by the first address of each array.
  std::multimap<uint64_t, ArrayState> ofArrays;
  uint64_t longest = 0;
  std::unordered_map<uint64_t, ArrayRange> copies;
  std::vector<Cut> cuts;
  std::map<std::pair<std::string, std::string>, unsigned> cutNumbers;
  CutSet fromResults;
  std::unordered_map<const Kernel *, Known> kernels;
  /// A number that grows with each change of any tracked state.
  uint64_t version = 1;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_FLOWTRACKER_H
