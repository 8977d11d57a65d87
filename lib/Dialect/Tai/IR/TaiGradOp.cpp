//===- TaiGradOp.cpp - Verification of tai.grad ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// True if values of `type` can have derivatives: floats, and vectors and
/// memrefs of floats.
static bool hasDerivative(Type type) {
  if (auto memref = dyn_cast<MemRefType>(type))
    type = memref.getElementType();
  return isa<FloatType>(getElementTypeOrSelf(type)) &&
         (isa<FloatType>(type) || isa<VectorType>(type));
}

static SmallVector<int64_t>
getActive(std::optional<ArrayRef<int64_t>> positions, ArrayRef<Type> types) {
  if (positions)
    return llvm::to_vector(*positions);
  SmallVector<int64_t> active;
  for (auto [i, type] : llvm::enumerate(types))
    if (hasDerivative(type))
      active.push_back(i);
  return active;
}

SmallVector<int64_t> GradOp::getActiveArguments(FunctionOpInterface function) {
  return getActive(getWrt(), function.getArgumentTypes());
}

SmallVector<int64_t> GradOp::getActiveResults(FunctionOpInterface function) {
  return getActive(getOf(), function.getResultTypes());
}

/// (grad_c2)
static LogicalResult verifyPositions(GradOp op, StringRef kind,
                                     ArrayRef<int64_t> positions,
                                     ArrayRef<Type> types) {
  if (!llvm::is_sorted(positions, std::less_equal<int64_t>()))
    return op.emitOpError("expects the positions of ")
           << kind << "s in ascending order";
  for (int64_t i : positions) {
    if (i < 0 || i >= static_cast<int64_t>(types.size()))
      return op.emitOpError("names ")
             << kind << " " << i << " of '@" << op.getCallee()
             << "', which has " << types.size();
    if (!hasDerivative(types[i]))
      return op.emitOpError("cannot differentiate by ")
             << kind << " " << i << " of '@" << op.getCallee()
             << "', which is no float but " << types[i];
  }
  return success();
}

LogicalResult GradOp::verifySymbolUses(SymbolTableCollection &symbols) {
  // (grad_c1)
  Operation *named = symbols.lookupNearestSymbolFrom(*this, getCalleeAttr());
  auto function = dyn_cast_or_null<FunctionOpInterface>(named);
  if (!function || isa<KernelOp>(named) || function.isExternal()) {
    InFlightDiagnostic diag = emitOpError("names '@")
                              << getCallee()
                              << "', which is no function with a body";
    if (isa_and_nonnull<KernelOp>(named))
      diag.attachNote(named->getLoc())
          << "a kernel is differentiated by launches under a 'tai.tape'";
    return diag;
  }
  ArrayRef<Type> inputs = function.getArgumentTypes();
  ArrayRef<Type> outputs = function.getResultTypes();
  SmallVector<int64_t> arguments = getActiveArguments(function);
  SmallVector<int64_t> results = getActiveResults(function);
  if (failed(verifyPositions(*this, "argument", arguments, inputs)) ||
      failed(verifyPositions(*this, "result", results, outputs)))
    return failure();

  // (grad_c3)
  SmallVector<Type> gradients;
  unsigned numShadows = 0;
  for (int64_t i : arguments) {
    if (isa<MemRefType>(inputs[i]))
      ++numShadows;
    else
      gradients.push_back(inputs[i]);
  }
  size_t wanted = inputs.size() + numShadows + results.size();
  if (getOperands().size() != wanted)
    return emitOpError("expects ")
           << wanted << " operands: " << inputs.size() << " arguments of '@"
           << getCallee() << "', " << numShadows
           << " memrefs for gradients, and " << results.size()
           << " derivatives of results, but got " << getOperands().size();
  auto check = [&](unsigned at, Type type, const Twine &what) -> LogicalResult {
    if (getOperand(at).getType() == type)
      return success();
    return emitOpError("expects operand ")
           << at << ", " << what << ", to be " << type << ", but got "
           << getOperand(at).getType();
  };
  for (auto [i, type] : llvm::enumerate(inputs))
    if (failed(check(i, type, "argument " + Twine(i) + " of the function")))
      return failure();
  unsigned at = inputs.size();
  for (int64_t i : arguments) {
    auto memref = dyn_cast<MemRefType>(inputs[i]);
    if (!memref)
      continue;
    // The gradient of an array of vectors is an array of scalars: the
    // dimensions of the vectors become dimensions of the array.
    Type element = memref.getElementType();
    SmallVector<int64_t> shape(memref.getShape());
    if (auto vector = dyn_cast<VectorType>(element))
      llvm::append_range(shape, vector.getShape());
    Type type = isa<FloatType>(element)
                    ? memref
                    : MemRefType::get(shape, getElementTypeOrSelf(element));
    if (failed(check(at++, type, "the gradient of argument " + Twine(i))))
      return failure();
  }
  for (int64_t i : results) {
    if (isa<MemRefType>(outputs[i]))
      return emitOpError("cannot differentiate by result ")
             << i << " of '@" << getCallee()
             << "', which is a memref; pass it as an argument";
    if (failed(check(at++, outputs[i], "the derivative by result " + Twine(i))))
      return failure();
  }
  if (!llvm::equal(getResultTypes(), gradients))
    return emitOpError("expects the results ")
           << gradients << ", the gradients of numbers and vectors, but got "
           << getResultTypes();
  // (grad_c4)
  if (arguments.empty() || (results.empty() && numShadows == 0))
    return emitOpError("has nothing to differentiate: '@")
           << getCallee() << "' has no active "
           << (arguments.empty() ? "argument" : "result or memref");
  return success();
}
