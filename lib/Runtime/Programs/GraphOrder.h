//===- GraphOrder.h - The order of a graph's steps --------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Chooses the fills of a sequence that run before all launches, and the fills
// that run in parallel with the first launches: the zeroing of gradients, for
// example, in parallel with the forward pass.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_PROGRAMS_GRAPHORDER_H
#define TAI_LIB_RUNTIME_PROGRAMS_GRAPHORDER_H

#include "tai/Runtime/Programs/Sequence.h"

namespace mlir::tai::runtime::programs {

/// The steps in order, except that fills are moved to earlier fills, or to the
/// front: between launches, each fill would be a separate graph node.
class GraphOrder {
public:
  explicit GraphOrder(const Sequence &sequence);

  size_t size() const { return order.size(); }
  const Step &operator[](size_t place) const {
    return sequence.steps[order[place]];
  }

  /// The fills at the front of a sequence: those that run first, and those in
  /// parallel with later steps, up to the step `join` in the order.
  struct FrontFills {
    std::vector<DeviceFill> first, aside;
    /// count: the number of fill steps at the front of the sequence. join: the
    /// position, in the order, of the first step that waits for the fills in
    /// `aside`.
    size_t count = 0, join = 0;
  };
  /// Chooses the fills that run at the front of the sequence; returns no value
  /// if the gain would be small.
  std::optional<FrontFills> splitFront() const;

private:
  const Sequence &sequence;
  /// The numbers of the sequence's steps, in the order in which they run.
  std::vector<uint32_t> order;
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_LIB_RUNTIME_PROGRAMS_GRAPHORDER_H
