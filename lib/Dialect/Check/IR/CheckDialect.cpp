//===- CheckDialect.cpp - Programs that check themselves ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Former names are separate ops, because the generic form and bytecode create
// ops by name, without a custom parser. These ops share the verifier of the
// present ops, and nothing else supports them.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/IR/DialectImplementation.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Transforms/InliningUtils.h"
#include "tai/Dialect/Check/IR/Check.h"

using namespace mlir;
using namespace mlir::tai;

#define GET_OP_CLASSES
#include "tai/Dialect/Check/IR/FormerCheckOps.h.inc"

#include "tai/Dialect/Check/IR/CheckDialect.cpp.inc"

#define GET_OP_CLASSES
#include "tai/Dialect/Check/IR/CheckOps.cpp.inc"

#define GET_OP_CLASSES
#include "tai/Dialect/Check/IR/FormerCheckOps.cpp.inc"

//===----------------------------------------------------------------------===//
// Registration
//===----------------------------------------------------------------------===//

namespace {
/// Allows inlining of check ops: helper functions of host programs are inlined
/// together with their checks.
struct CheckInlinerInterface : DialectInlinerInterface {
  using DialectInlinerInterface::DialectInlinerInterface;

  bool isLegalToInline(Operation *, Region *, bool, IRMapping &) const final {
    return true;
  }
  bool isLegalToInline(Region *, Region *, bool, IRMapping &) const final {
    return true;
  }
};
} // namespace

void CheckDialect::initialize() {
  addInterfaces<CheckInlinerInterface>();
  addOperations<
#define GET_OP_LIST
#include "tai/Dialect/Check/IR/CheckOps.cpp.inc"
      >();
  Dialect &tai = *getContext()->getLoadedDialect<TaiDialect>();
  RegisteredOperationName::insert<FormerCheckCloseOp>(tai);
  RegisteredOperationName::insert<FormerCheckGradientOp>(tai);
}

void tai::registerCheckDialect(DialectRegistry &registry) {
  registry.insert<CheckDialect>();
  registry.addExtension(+[](MLIRContext *context, TaiDialect *) {
    // The check dialect is loaded with the tai dialect. This does nothing if
    // the check dialect itself is loading the tai dialect.
    context->loadDialect<CheckDialect>();
  });
}

//===----------------------------------------------------------------------===//
// Verification
//===----------------------------------------------------------------------===//

static LogicalResult verifyGradient(Operation *op, FlatSymbolRefAttr loss,
                                    ArrayAttr wrt,
                                    SymbolTableCollection &symbols) {
  for (auto name : wrt.getAsRange<FlatSymbolRefAttr>()) {
    auto field = symbols.lookupNearestSymbolFrom<FieldOp>(op, name);
    if (!field)
      return op->emitOpError("names '") << name << "', which is not a field";
    // (check_gradient_c2)
    if (!field.getAdjointAttr())
      return op->emitOpError("expects field '")
             << name << "' to have an adjoint";
  }
  // (check_gradient_c1)
  return verifyTape(op, loss, symbols);
}

LogicalResult
CheckGradientOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyGradient(*this, getLossAttr(), getWrt(), symbols);
}

LogicalResult
FormerCheckGradientOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyGradient(*this, getLossAttr(), getWrt(), symbols);
}

//===----------------------------------------------------------------------===//
// Former names
//===----------------------------------------------------------------------===//

/// Parses an op by its former name, and creates the op of the present name.
template <typename Op>
static ParseResult parseFormer(OpAsmParser &parser, OperationState &state) {
  state.name = OperationName(Op::getOperationName(), parser.getContext());
  return Op::parse(parser, state);
}

ParseResult FormerCheckCloseOp::parse(OpAsmParser &parser,
                                      OperationState &state) {
  return parseFormer<CheckCloseOp>(parser, state);
}

ParseResult FormerCheckGradientOp::parse(OpAsmParser &parser,
                                         OperationState &state) {
  return parseFormer<CheckGradientOp>(parser, state);
}

void FormerCheckCloseOp::print(OpAsmPrinter &printer) {
  printer << ' ' << getActual() << ", " << getExpected() << " tolerance ";
  printer.printAttributeWithoutType(getToleranceAttr());
  printer.printOptionalAttrDict((*this)->getAttrs(), {"tolerance"});
  printer << " : " << getActual().getType();
}

void FormerCheckGradientOp::print(OpAsmPrinter &printer) {
  printer << " loss(" << getLossAttr() << ") wrt " << getWrt() << " tolerance ";
  printer.printAttributeWithoutType(getToleranceAttr());
  printer << ' ';
  printer.printRegion(getBody(), /*printEntryBlockArgs=*/true,
                      /*printBlockTerminators=*/false);
  printer.printOptionalAttrDict((*this)->getAttrs(),
                                {"loss", "wrt", "tolerance"});
}

LogicalResult FormerCheckCloseOp::canonicalize(FormerCheckCloseOp op,
                                               PatternRewriter &rewriter) {
  auto check = CheckCloseOp::create(rewriter, op.getLoc(), op.getActual(),
                                    op.getExpected(), op.getToleranceAttr());
  check->setDiscardableAttrs(op->getDiscardableAttrDictionary());
  rewriter.eraseOp(op);
  return success();
}

LogicalResult FormerCheckGradientOp::canonicalize(FormerCheckGradientOp op,
                                                  PatternRewriter &rewriter) {
  auto check = CheckGradientOp::create(rewriter, op.getLoc(), op.getLossAttr(),
                                       op.getWrtAttr(), op.getToleranceAttr());
  check->setDiscardableAttrs(op->getDiscardableAttrDictionary());
  rewriter.inlineRegionBefore(op.getBody(), check.getBody(),
                              check.getBody().end());
  rewriter.eraseOp(op);
  return success();
}

void tai::upgradeFormerChecks(Operation *root) {
  SmallVector<Operation *> former;
  root->walk([&](Operation *op) {
    if (isa<FormerCheckCloseOp, FormerCheckGradientOp>(op))
      former.push_back(op);
  });
  PatternRewriter rewriter(root->getContext());
  for (Operation *op : former) {
    rewriter.setInsertionPoint(op);
    if (auto close = dyn_cast<FormerCheckCloseOp>(op))
      (void)FormerCheckCloseOp::canonicalize(close, rewriter);
    else
      (void)FormerCheckGradientOp::canonicalize(cast<FormerCheckGradientOp>(op),
                                                rewriter);
  }
}
