//===- GraphOrder.h - In which order a graph does its steps -----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Which fills of a sequence a graph does before all launches, and which beside
// the first of them: clears of gradients, say, beside all of the forward pass.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_GRAPHORDER_H
#define TAI_LIB_RUNTIME_QUEUE_GRAPHORDER_H

#include "Sequence.h"

namespace mlir::tai::runtime {

/// The steps in their order, but fills as early as they can join others, or
/// stand in front of all: between launches each would be waited for by itself.
class DeviceQueue::GraphOrder {
public:
  explicit GraphOrder(const Sequence &sequence);

  size_t size() const { return order.size(); }
  const Step &operator[](size_t place) const {
    return sequence.steps[order[place]];
  }

  /// The fills in front of a sequence: those that come first, and those beside
  /// what follows, up to a place in the order.
  struct FrontFills {
    std::vector<DeviceFill> first, aside;
    /// How many steps they were, and the place of the first that waits for all.
    size_t count = 0, join = 0;
  };
  /// Nothing where there is little to gain.
  std::optional<FrontFills> splitFront() const;

private:
  const Sequence &sequence;
  /// Numbers of steps.
  std::vector<uint32_t> order;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_GRAPHORDER_H
