//===- ForwardDiff.cpp - Forward-mode variants of kernels -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Copies the functions to differentiate and lets TangentBuilder extend the
// copies. The primal is not changed.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Conventions.h"
#include "tai/AD/DerivativeBuilder.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/AD/Forward/TangentBuilder.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/AD/Prepare/SpectralForms.h"
#include "tai/AD/Prepare/Writers.h"
#include "tai/AD/Signature.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Activity.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_FORWARDDIFF
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The key for getFunctionAttrName of the attribute by which a primal function
/// names its forward-mode copy.
static constexpr StringLiteral kTangent = "tangent";

static bool hasTangentAlready(FunctionOpInterface function) {
  return function->hasAttr(getFunctionAttrName(function, kTangent));
}

/// Adds an argument for the tangents of each argument that is an array of
/// floats. Returns the tangent argument of each array argument.
static DenseMap<Value, Value> addArrays(FunctionOpInterface function) {
  DenseMap<Value, Value> tangents;
  for (unsigned i = 0, e = function.getNumArguments(); i != e; ++i) {
    BlockArgument argument = function.getArgument(i);
    auto type = dyn_cast<MemRefType>(argument.getType());
    if (!type || !isFloatOrVector(type.getElementType()))
      continue;
    unsigned position = function.getNumArguments();
    (void)function.insertArgument(position, type, {}, argument.getLoc());
    tangents[argument] = function.getArgument(position);
  }
  return tangents;
}

namespace {
struct ForwardDiff : tai::impl::ForwardDiffBase<ForwardDiff> {
  using Base::Base;

  void getDependentDialects(DialectRegistry &registry) const override {
    Base::getDependentDialects(registry);
    registerDifferentiableModels(registry);
  }

  void runOnOperation() override {
    SymbolTable symbols(getOperation());
    SmallVector<FunctionOpInterface> functions;
    if (failed(select(symbols, functions)) ||
        failed(checkNested(getOperation())))
      return signalPassFailure();
    bool failedAny = false;
    // After a failure, go on with the next function, so that the errors of all
    // functions are reported.
    for (FunctionOpInterface function : functions)
      failedAny |= failed(differentiate(function, symbols));
    erasePrepared(getOperation());
    if (failedAny)
      signalPassFailure();
  }

  /// The kernels and functions of the given names; or without names, all
  /// kernels, and the functions with the attribute `tai.differentiate`.
  LogicalResult select(SymbolTable &symbols,
                       SmallVectorImpl<FunctionOpInterface> &functions) {
    for (const std::string &name : kernels) {
      auto function = symbols.lookup<FunctionOpInterface>(name);
      if (!function)
        return getOperation().emitError() << "there is no kernel or function '@"
                                          << name << "' to differentiate";
      functions.push_back(function);
    }
    if (!kernels.empty()) {
      takePrepared(getOperation(), functions);
      return success();
    }
    for (auto function : getOperation().getOps<FunctionOpInterface>())
      if (!function.isExternal() && !hasTangentAlready(function) &&
          (isa<KernelOp>(function.getOperation()) ||
           function->hasAttr("tai.differentiate")))
        functions.push_back(function);
    takePrepared(getOperation(), functions);
    return success();
  }

  LogicalResult differentiate(FunctionOpInterface function,
                              SymbolTable &symbols) {
    FunctionOpInterface original = getOriginal(function);
    if (hasTangentAlready(original))
      return success();
    if (failed(checkIsFunction(function)))
      return failure();
    bool isPlain = isa<func::FuncOp>(function.getOperation());
    StringAttr gradients = getFunctionAttrName(function, kGradients);
    AdjointSignature signature;
    SmallVector<int64_t> positions;
    bool namesNumbers = isPlain && function->hasAttr(gradients);
    if (namesNumbers) {
      FailureOr<AdjointSignature> given =
          AdjointSignature::get(function, /*arrays=*/true);
      if (failed(given))
        return failure();
      signature = *given;
      positions.append(signature.arguments.begin(), signature.arguments.end());
      for (unsigned position : signature.results)
        positions.push_back(function.getNumArguments() + position);
      for (Type type : function.getResultTypes())
        if (isa<BaseMemRefType>(type))
          return function.emitError(
              "cannot differentiate a function that returns an array");
    }
    if (failed(checkHasOneBlock(function)))
      return failure();
    if (failed(Conventions::verify(function)) || failed(checkGuards(function)))
      return failure();
    if (isPlain && isWrapped(function))
      for (Type type : original.getResultTypes())
        if (auto tensor = dyn_cast<RankedTensorType>(type);
            tensor && !tensor.hasStaticShape())
          return original.emitError(
                     "cannot make the tangent of a function that "
                     "returns ")
                 << type << ": its sizes are not known before it runs";
    std::string name = (original.getName() + "_fwd").str();
    if (Operation *taken = symbols.lookup(name)) {
      InFlightDiagnostic diag = function.emitError()
                                << "cannot make the tangent '@" << name
                                << "': the name is taken";
      diag.attachNote(taken->getLoc()) << "by this";
      return diag;
    }
    FunctionOpInterface made = function.clone();
    made.setName(name);
    for (StringRef attribute : {"adjoint", "tai.adjoint", kPreparedFor.data(),
                                "tai.differentiate", "summary"})
      made->removeAttr(attribute);
    symbols.insert(made, std::next(function->getIterator()));
    if (namesNumbers) {
      made->removeAttr(gradients);
      passNumbers(cast<func::FuncOp>(made.getOperation()), signature);
    }
    if (failed(extend(made))) {
      symbols.erase(made);
      return failure();
    }
    if (isPlain && !isWrapped(function) &&
        failed(checkHasDerivative(function, positions))) {
      symbols.erase(made);
      return failure();
    }
    if (isPlain) {
      auto plain = cast<func::FuncOp>(made.getOperation());
      auto from = cast<func::FuncOp>(original.getOperation());
      if (isWrapped(function)) {
        symbols.remove(plain);
        plain = wrapDerivative(from, plain, /*isForward=*/true);
        symbols.insert(plain);
      } else if (namesNumbers) {
        symbols.remove(plain);
        plain = wrapNumbers(from, plain, signature);
        symbols.insert(plain);
      }
      takeInterface(from, plain);
    }
    original->setAttr(getFunctionAttrName(function, kTangent),
                      FlatSymbolRefAttr::get(&getContext(), name));
    return success();
  }

  LogicalResult extend(FunctionOpInterface function) {
    DenseMap<Value, Value> arrays;
    if (arrayTangents || !isa<KernelOp>(function.getOperation()))
      arrays = addArrays(function);
    auto tangentOf = [&](Storage storage) -> Storage {
      if (storage.memref)
        return arrays.lookup(storage.memref);
      FieldOp field = lookupField(function, storage.field);
      return field.getDualAttr() && isFloatOrVector(field.getType())
                 ? Storage(field.getDualAttr())
                 : Storage();
    };
    // The stores by which several iterations may write one element are found
    // here. The value and the tangent of the element must come from the same
    // iteration.
    auto changesTangent = [&](DifferentiableAccessInterface store) {
      return tangentOf(store.getAccessedStorage()) &&
             !matchPattern(store.getAccessedValue(), m_Constant());
    };
    if (failed(chooseWriters(function, changesTangent, /*isReversed=*/false)))
      return failure();
    SpectralForms forms(function);
    auto hasTangent = [&](Storage storage) {
      return static_cast<bool>(tangentOf(storage));
    };
    Activity activity(function, hasTangent);
    warnOfActiveFactors(function,
                        [&](Value v) { return activity.isActive(v); });
    TangentBuilder builder(function, tangentOf);
    if (failed(builder.build()))
      return failure();
    markExclusiveAtomics(function);
    return success();
  }
};
} // namespace
