//===- Rerun.h - Running the primal forward again ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_AD_RERUN_H
#define TAI_AD_RERUN_H

#include "mlir/IR/IRMapping.h"
#include "tai/AD/AdjointBuilder.h"

namespace mlir::tai {

/// The block that is run again for the sake of `op`: the body of the parallel
/// loop around it, or the body of the function. Serialized loops are serial.
Block *getRerunUnit(Operation *op);

/// One block of the primal that is run forward again, at the start of its
/// mirror, and what it records.
class Rerun {
public:
  Rerun(Frame &frame, std::unique_ptr<Rerun> parent)
      : frame(frame), parent(std::move(parent)) {}

  /// A recorded value: the primal block whose mirrors pop it, and one stack for
  /// each component.
  struct Record {
    Block *block;
    SmallVector<Value> stacks;
  };
  /// A mirror that has been left, with the op that marks where values are
  /// popped.
  struct Mirror {
    Block *block;
    Operation *marker;
    DenseSet<Value> popped;
  };

  Frame &frame;
  /// That of a block around this one.
  std::unique_ptr<Rerun> parent;
  /// Stacks are made before this op, which only marks the place.
  Operation *begin = nullptr;
  /// What primal values of the block, and of the blocks in it, are in the
  /// rerun.
  IRMapping values;
  /// How often the second region of a loop has run.
  DenseMap<Operation *, Value> counts;
  llvm::MapVector<Value, Record> records;
  SmallVector<Mirror> mirrors;
};

} // namespace mlir::tai

#endif // TAI_AD_RERUN_H
