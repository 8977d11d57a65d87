//===- LoopAccesses.h - What a parallel loop touches ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_LOOPACCESSES_H
#define TAI_LIB_CONVERSION_TAITOGPU_LOOPACCESSES_H

#include "mlir/IR/BuiltinAttributes.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Runtime/DeviceAccesses.h"

namespace mlir::tai {

/// On a device function: what it touches, as FunctionAccesses encodes it.
constexpr llvm::StringLiteral kAccessesAttrName = "tai.accesses";

/// Follows the addresses in a loop whose accesses have been lowered to those of
/// memory, before it becomes a function. Made as long as the loop is whole;
/// asked when the parameters of the function are known.
class LoopAccesses {
public:
  LoopAccesses(ParallelForOp loop, bool deterministic);

  /// A sum of all iterations that goes to this address, or whose `threads`
  /// partial sums are stored from there on.
  void addSum(Value target, Type type, bool isAddition, int64_t threads);

  /// Finds the number of the parameter that a value from outside has become,
  /// and how far behind that an address is.
  using ParameterFinder =
      llvm::function_ref<std::optional<std::pair<int64_t, int64_t>>(Value)>;

  /// The list, with values from outside by the numbers of their parameters;
  /// null where it is not known what the loop touches.
  DenseI64ArrayAttr encode(ParameterFinder getParameter);

private:
  /// An address with values from outside, which have no numbers yet.
  struct Address {
    runtime::DeviceAccess access;
    Value base;
    SmallVector<std::pair<Value, int64_t>> terms;
  };

  void visit(Operation *op);
  void addSlot(Value value);
  void add(Value pointer, Type type, runtime::DeviceAccess::Kind kind,
           DenseI64ArrayAttr digits);
  void mergeNeighbours();
  bool addIndex(Address &address, Value index, int64_t size,
                ArrayRef<int64_t> digits);
  bool addTerm(Address &address, Value value, int64_t scale, unsigned depth);
  static void widen(Address &address, int64_t count, int64_t step);

  ParallelForOp loop;
  bool deterministic;
  std::optional<LoopBox> box;
  bool isKnown = true;
  bool isPlain = true;
  SmallVector<Address> addresses;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_LOOPACCESSES_H
