//===- IterationShadow.h - Who came to an element ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Arrays of a kernel in which the iterations of a loop leave their numbers at
// the elements that they reach, for checks at run time.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_ACCUMULATIONS_ITERATIONSHADOW_H
#define TAI_LIB_TRANSFORMS_ACCUMULATIONS_ITERATIONSHADOW_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"

namespace mlir::tai {

/// Describes the element of an access, for messages.
std::string describeElement(DifferentiableAccessInterface access);

/// The shadow array of one storage in one loop: for each component, the number
/// of the iteration that reached it.
class IterationShadow {
public:
  /// Emits the extents of the storage before the loop; nullopt if there are too
  /// many elements. If `isWanted` is given, accesses are only checked in
  /// launches in which this condition holds.
  static std::optional<IterationShadow>
  create(ParallelForOp loop, DifferentiableAccessInterface access,
         Value isWanted = {});

  /// Creates a shadow array filled with -1: allocated before the loop, freed
  /// after it.
  Value createArray();
  /// Moves the insertion point of the builder before `access`.
  void moveTo(DifferentiableAccessInterface access);
  /// Emits code that writes the number of the iteration to the shadow of all
  /// components that `access` reaches. Returns an i1: true if no other
  /// iteration had left its number there.
  Value leave(Value array, DifferentiableAccessInterface access);
  /// Emits the test that no other iteration has left its number at a component
  /// that `access` reaches.
  Value isFree(Value array, DifferentiableAccessInterface access);
  /// Fails the launch at `access` unless the condition holds. `message` follows
  /// the name of the element.
  void require(Value condition, DifferentiableAccessInterface access,
               const Twine &message);

private:
  IterationShadow(ParallelForOp loop) : loop(loop), b(loop.getLoc(), loop) {}

  SmallVector<Value> getNumbers(DifferentiableAccessInterface access);
  Value getIteration();
  Value isNoneOr(Value number, Value own);
  Value index(int64_t value);
  Value real(double value);

  ParallelForOp loop;
  ImplicitLocOpBuilder b;
  SmallVector<Value> extents;
  /// The shape of an element of the storage; empty for scalars.
  SmallVector<int64_t> shape;
  /// The number of components of the whole storage.
  Value size;
  Value isWanted;
};

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_ACCUMULATIONS_ITERATIONSHADOW_H
