//===- ValueFlows.h - Dependence of values on loads -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Data flow of floats from each read to each write, through ops that carry
// derivatives, whether or not the storages have gradients.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_VALUEFLOWS_H
#define TAI_ANALYSIS_VALUEFLOWS_H

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Interfaces/Differentiable.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/ADT/SmallBitVector.h"

namespace mlir::tai {

class ValueFlows {
public:
  /// Analyses the data flow in `function`. `arguments`: its float arguments
  /// that count as sources of data flow, in addition to the storages that it
  /// reads.
  ValueFlows(FunctionOpInterface function, ArrayRef<Value> arguments);

  /// The sources of data flow by number: storages that the function reads.
  SmallVector<Storage> storages;
  /// The accesses of the function to floats.
  SmallVector<DifferentiableAccessInterface> reads, writes;

  /// The numbers of the sources (read storages and arguments) that `value`
  /// depends on.
  const llvm::SmallBitVector &sourcesOf(Value value) { return sources[value]; }

private:
  unsigned number(Storage storage);
  void add(Value to, const llvm::SmallBitVector &more);
  void addOwn(Value to, Storage storage);
  void pass(Value from, Value to);
  void visit(Operation *op);

  DenseMap<Value, llvm::SmallBitVector> sources;
  bool grown = false;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_VALUEFLOWS_H
