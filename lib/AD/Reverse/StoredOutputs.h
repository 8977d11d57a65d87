//===- StoredOutputs.h - Values that a kernel leaves in fields --*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The derivatives of tanh, exp or sqrt need the result, which the kernel has
// often stored: `y[t, i] = tanh(total)`. An adjoint that may rely on the field
// being unchanged loads it instead of recomputing it.
//
// See docs/decisions/0013-stored-outputs.md for when it may.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_AD_REVERSE_STOREDOUTPUTS_H
#define TAI_LIB_AD_REVERSE_STOREDOUTPUTS_H

#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Finds the values of a kernel that fields hold when the kernel has finished,
/// so that its adjoint can load them.
class StoredOutputs {
public:
  /// The location of a value: the element that `store` writes, or its component
  /// number `component` (row-major) unless that is -1.
  struct Place {
    StoreOp store;
    int64_t component = -1;
  };

  StoredOutputs(FunctionOpInterface function, const AccessTable &accesses);

  bool empty() const { return places.empty(); }
  const Place *find(Value value) const {
    auto found = places.find(value);
    return found == places.end() ? nullptr : &found->second;
  }

  /// Loads, in the frame of its block, a value that the kernel has left in a
  /// field; null if the value is in no field, or if loading it saves no work.
  Value load(AdjointBuilder &builder, Frame &frame, Value value);
  /// The primal stores whose stored values the adjoint loads.
  const llvm::SetVector<Operation *> &getUsed() const { return used; }

private:
  llvm::SetVector<Operation *> used;
  DenseMap<Value, Place> places;
};

} // namespace mlir::tai

#endif // TAI_LIB_AD_REVERSE_STOREDOUTPUTS_H
