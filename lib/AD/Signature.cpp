//===- Signature.cpp - Extra operands of an adjoint function --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Signature.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Interfaces/Differentiable.h"

using namespace mlir;
using namespace mlir::tai;

// Turns the dimensions of a vector into dimensions of the memref of adjoints,
// because atomic additions take scalars alone.
MemRefType mlir::tai::getShadowType(Type type) {
  SmallVector<int64_t> shape;
  auto memref = dyn_cast<MemRefType>(type);
  if (memref) {
    llvm::append_range(shape, memref.getShape());
    type = memref.getElementType();
  }
  if (!isFloatOrVector(type))
    return {};
  if (memref && isa<FloatType>(type))
    return memref;
  if (auto vector = dyn_cast<VectorType>(type)) {
    // The number of components of a scalable vector is not a constant.
    if (vector.isScalable())
      return {};
    llvm::append_range(shape, vector.getShape());
  }
  return MemRefType::get(shape, getElementTypeOrSelf(type));
}

LogicalResult mlir::tai::checkHasDerivative(FunctionOpInterface function,
                                            ArrayRef<int64_t> positions) {
  int64_t numInputs = function.getNumArguments();
  bool takes = false, gives = false;
  for (int64_t i : positions) {
    takes |= i < numInputs;
    gives |= i >= numInputs;
  }
  function->walk([&](DifferentiableAccessInterface access) {
    if (!isFloatOrVector(access.getAccessedValue().getType()))
      return;
    Storage storage = access.getAccessedStorage();
    bool counts = static_cast<bool>(storage.field);
    if (auto argument = dyn_cast_if_present<BlockArgument>(storage.memref);
        argument && argument.getOwner()->getParentOp() == function)
      counts = positions.empty() ||
               llvm::is_contained(positions, argument.getArgNumber());
    bool isRead = access.getAccessKind() == AccessKind::Read;
    takes |= counts && isRead;
    gives |= counts && !isRead;
  });
  // If no `positions` are given, it is enough that the function writes a field
  // or an array argument: the adjoint reads the gradient of the written memory.
  if (gives && (takes || positions.empty()))
    return success();
  InFlightDiagnostic diag = function.emitError()
                            << "there is nothing to differentiate: '@"
                            << getOriginal(function).getName() << "' "
                            << (gives ? "reads" : "writes")
                            << " no array of floats that a derivative is "
                               "wanted of";
  diag.attachNote() << "pass arrays, or name arguments and results by their "
                       "positions, as in '"
                    << getFunctionAttrName(function, kGradients).strref()
                    << " = array<i64: 0, " << numInputs << ">'";
  return diag;
}

FailureOr<AdjointSignature> AdjointSignature::get(FunctionOpInterface function,
                                                  bool arrays) {
  AdjointSignature signature;
  ArrayRef<Type> inputs = function.getArgumentTypes();
  ArrayRef<Type> results = function.getResultTypes();
  StringAttr name = getFunctionAttrName(function, kGradients);
  Attribute given = function->getAttr(name);
  if (!given) {
    for (auto [i, type] : llvm::enumerate(inputs))
      if (arrays && isa<MemRefType>(type) && getShadowType(type))
        signature.arguments.push_back(i);
    return signature;
  }
  auto positions = dyn_cast<DenseI64ArrayAttr>(given);
  if (!positions ||
      !llvm::is_sorted(positions.asArrayRef(), std::less_equal<int64_t>()))
    return function.emitError("expects '")
           << name.strref()
           << "' to be an array of positions in ascending order, such as "
              "array<i64: 0, 2>";
  for (int64_t position : positions.asArrayRef()) {
    int64_t numInputs = inputs.size();
    if (position < 0 || position >= numInputs + int64_t(results.size()))
      return function.emitError("cannot differentiate by position ")
             << position << ": there are " << numInputs << " arguments and "
             << results.size() << " results";
    bool isInput = position < numInputs;
    Type type = isInput ? inputs[position] : results[position - numInputs];
    if (!getShadowType(type))
      return function.emitError("cannot differentiate by ")
             << (isInput ? "argument " : "result ")
             << (isInput ? position : position - numInputs)
             << ", which is no float but " << type;
    if (isInput)
      signature.arguments.push_back(position);
    else
      signature.results.push_back(position - numInputs);
  }
  return signature;
}

SmallVector<MemRefType>
AdjointSignature::getShadowTypes(FunctionOpInterface function) const {
  SmallVector<MemRefType> types;
  for (unsigned position : arguments)
    types.push_back(getShadowType(function.getArgumentTypes()[position]));
  for (unsigned position : results)
    types.push_back(getShadowType(function.getResultTypes()[position]));
  return types;
}
