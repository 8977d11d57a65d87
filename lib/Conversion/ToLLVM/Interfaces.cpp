//===- Interfaces.cpp - Conversions that dialects define ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Upstream's `convert-to-llvm` leaves an op without a conversion as it is, and
// converts the ops in its regions. A kernel must not be converted in part, so
// the dialects of tai refuse their ops there.
//
//===----------------------------------------------------------------------===//

#include "tai/Conversion/ToLLVM/Interfaces.h"
#include "mlir/Conversion/ConvertToLLVM/ToLLVMInterface.h"
#include "mlir/Conversion/LLVMCommon/TypeConverter.h"
#include "mlir/Transforms/DialectConversion.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the pass that removes ops like `op`.
static StringRef findLowering(Operation *op) {
  if (isa<GradOp>(op))
    return "tai-expand-gradients";
  // These passes keep the signature of a function; `tai-to-llvm` changes it.
  if (isa<MatmulOp, TransposeOp, DotOp, SumOp, CrossOp, OuterOp, NormOp,
          TraceOp, DeterminantOp, InverseOp, SolveOp, PolarOp, SvdOp, SymEigOp>(
          op))
    return "tai-scalarize";
  if (isa<AllocaOp, LocalLoadOp, LocalStoreOp>(op))
    return "tai-eliminate-locals";
  return "tai-to-llvm";
}

namespace {
/// Replaces an op that returns its first operand, and tells differentiation
/// something about it.
struct LowerMarker : ConversionPattern {
  LowerMarker(const TypeConverter &converter, StringRef name,
              MLIRContext *context)
      : ConversionPattern(converter, name, /*benefit=*/1, context) {}
  LogicalResult
  matchAndRewrite(Operation *op, ArrayRef<Value> operands,
                  ConversionPatternRewriter &rewriter) const override {
    rewriter.replaceOp(op, operands.front());
    return success();
  }
};

struct RefuseOp : ConversionPattern {
  RefuseOp(StringRef name, MLIRContext *context)
      : ConversionPattern(name, /*benefit=*/1, context) {}
  LogicalResult matchAndRewrite(Operation *op, ArrayRef<Value>,
                                ConversionPatternRewriter &) const override {
    op->emitOpError("has no conversion to the LLVM dialect by itself")
            .attachNote()
        << "run '--" << findLowering(op) << "' before";
    return failure();
  }
};

struct ToLLVMInterface : ConvertToLLVMPatternInterface {
  using ConvertToLLVMPatternInterface::ConvertToLLVMPatternInterface;

  void populateConvertToLLVMConversionPatterns(
      ConversionTarget &target, LLVMTypeConverter &converter,
      RewritePatternSet &patterns) const final {
    MLIRContext *context = patterns.getContext();
    StringRef dialect = getDialect()->getNamespace();
    target.addIllegalDialect(dialect);
    for (RegisteredOperationName name :
         context->getRegisteredOperationsByDialect(dialect)) {
      if (name.getTypeID() == TypeID::get<StopGradientOp>() ||
          name.getTypeID() == TypeID::get<DeriveAsOp>())
        patterns.add<LowerMarker>(converter, name.getStringRef(), context);
      else
        patterns.add<RefuseOp>(name.getStringRef(), context);
    }
  }
};
} // namespace

void tai::registerToLLVMInterfaces(DialectRegistry &registry) {
  registry.addExtension(+[](MLIRContext *, TaiDialect *dialect) {
    dialect->addInterfaces<ToLLVMInterface>();
  });
  registry.addExtension(+[](MLIRContext *, TaiRTDialect *dialect) {
    dialect->addInterfaces<ToLLVMInterface>();
  });
  registry.addExtension(+[](MLIRContext *, TaiMeshDialect *dialect) {
    dialect->addInterfaces<ToLLVMInterface>();
  });
  registry.addExtension(+[](MLIRContext *, CheckDialect *dialect) {
    dialect->addInterfaces<ToLLVMInterface>();
  });
}

/// Returns the interface of a dialect that tai does not lower itself, or null.
/// Ops of OpenMP are converted to themselves, which tai does not compile.
static const ConvertToLLVMPatternInterface *findInterface(Dialect *dialect) {
  if (!dialect ||
      llvm::is_contained({"arith", "builtin", "cf", "func", "gpu", "llvm",
                          "math", "memref", "nvvm", "omp", "scf", "tai",
                          "tai_check", "tai_mesh", "tai_rt", "ub", "vector"},
                         dialect->getNamespace()))
    return nullptr;
  // By its ID: upstream's dialects promise the interface, and asking for it by
  // type is an error where a tool has not registered it.
  return static_cast<const ConvertToLLVMPatternInterface *>(
      dialect->getRegisteredInterface(
          TypeID::get<ConvertToLLVMPatternInterface>()));
}

bool OwnConversions::covers(Operation *op) {
  const ConvertToLLVMPatternInterface *interface =
      findInterface(op->getDialect());
  if (!interface)
    return false;
  auto [names, isNew] = converted.try_emplace(op->getDialect());
  if (isNew) {
    MLIRContext *context = op->getContext();
    ConversionTarget target(*context);
    LLVMTypeConverter converter(context);
    RewritePatternSet patterns(context);
    interface->populateConvertToLLVMConversionPatterns(target, converter,
                                                       patterns);
    for (const std::unique_ptr<RewritePattern> &pattern :
         patterns.getNativePatterns())
      if (std::optional<OperationName> root = pattern->getRootKind())
        names->second.insert(*root);
  }
  return names->second.contains(op->getName());
}

void tai::populateOwnConversions(ArrayRef<Operation *> roots,
                                 ConversionTarget &target,
                                 LLVMTypeConverter &converter,
                                 RewritePatternSet &patterns) {
  llvm::SetVector<Dialect *> dialects;
  for (Operation *root : roots)
    root->walk([&](Operation *op) { dialects.insert(op->getDialect()); });
  for (Dialect *dialect : dialects)
    if (const ConvertToLLVMPatternInterface *interface = findInterface(dialect))
      interface->populateConvertToLLVMConversionPatterns(target, converter,
                                                         patterns);
}
