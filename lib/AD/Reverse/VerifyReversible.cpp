//===- VerifyReversible.cpp - Rejects irreversible functions --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Refuses constructs that would silently be left out of the gradient: uses of
// arrays other than accesses, and derivatives that end in ops without a rule or
// in memory without an adjoint.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "tai/AD/Reverse/AdjointPlanner.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/DerivativePaths.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class Verifier {
public:
  explicit Verifier(const AdjointPlan &plan)
      : plan(plan), primal(plan.primal) {}

  LogicalResult run();

private:
  void checkArrays();
  void checkDeactivation();
  void checkAccess(DifferentiableAccessInterface access);
  void checkSink(Operation *op);
  InFlightDiagnostic emitError(Operation *op, const Twine &message) {
    hasErrors = true;
    return op->emitError() << message;
  }

  const AdjointPlan &plan;
  FunctionOpInterface primal;
  bool hasErrors = false;
};
} // namespace

static constexpr StringLiteral kInlineFirst =
    "run 'inline' first; a function that calls itself, or that is defined "
    "elsewhere, cannot be differentiated";

/// True for ops that neither read nor write the elements of an array.
static bool isQuery(Operation *op) {
  return isa<memref::DimOp, memref::RankOp, memref::DeallocOp>(op);
}

/// Checks that arrays with a derivative are accessed by single elements only.
void Verifier::checkArrays() {
  DenseSet<Operation *> refused;
  for (BlockArgument argument : primal.getArguments()) {
    if (!isa<MemRefType>(argument.getType()) ||
        !plan.adjointOf(Storage(argument)))
      continue;
    for (Operation *user : argument.getUsers()) {
      auto access = dyn_cast<DifferentiableAccessInterface>(user);
      if (isQuery(user) ||
          (access && access.getAccessedStorage().memref == argument) ||
          !refused.insert(user).second)
        continue;
      InFlightDiagnostic diag = emitError(
          user, "cannot differentiate '" + user->getName().getStringRef() +
                    "' on an array with a derivative");
      if (isa<CallOpInterface>(user))
        diag.attachNote() << kInlineFirst;
      else if (!attachHelpfulPass(diag, user))
        diag.attachNote() << "access its elements by 'memref.load', "
                             "'memref.store' and 'memref.atomic_rmw addf'";
    }
  }
}

/// Deactivation sets all fields below a cell to zero, without a store. A tape
/// undoes that between two launches, but an adjoint cannot undo it within a
/// launch.
void Verifier::checkDeactivation() {
  auto treeOf = [](Operation *op, FlatSymbolRefAttr name) {
    FieldOp field = name ? lookupField(op, name) : FieldOp();
    return field ? field.getTreeAttr() : FlatSymbolRefAttr();
  };
  // For each tree of fields that the primal accesses, one of the accesses.
  DenseMap<Attribute, Operation *> accessed;
  bool any = false;
  primal.walk([&](DifferentiableAccessInterface access) {
    any |= plan.activity.isActiveAccess(access);
    if (FlatSymbolRefAttr tree =
            treeOf(access, access.getAccessedStorage().field))
      accessed.try_emplace(tree, access);
  });
  if (!any)
    return;
  primal.walk([&](DeactivateOp op) {
    Operation *access = accessed.lookup(treeOf(op, op.getFieldAttr()));
    if (!access)
      return;
    emitError(op, "cannot differentiate a kernel that deactivates cells of a "
                  "tree which it reads or writes")
            .attachNote(access->getLoc())
        << "reads or writes it here; deactivate in a kernel of its own, or by "
           "'deactivate_all' between kernels";
  });
}

/// Refuses to store active values to arrays without an adjoint that the
/// function allocates.
void Verifier::checkAccess(DifferentiableAccessInterface access) {
  Storage storage = access.getAccessedStorage();
  if (access.getAccessKind() == AccessKind::Read || !storage.memref ||
      isa<BlockArgument>(storage.memref) || plan.adjointOf(storage) ||
      !plan.activity.isVaried(access.getAccessedValue()))
    return;
  emitError(access, "a derivative is lost in an array that the function makes "
                    "for itself")
          .attachNote()
      << "use a local variable, a field, or an array that is an argument";
}

/// Refuses active values in ops with side effects that have no derivative.
void Verifier::checkSink(Operation *op) {
  // Printing and checking ops accept all values, and the ops in a region are
  // checked one by one.
  if (op->getNumRegions() != 0 || isMemoryEffectFree(op) ||
      isa<PrintOp, AssertOp, PreconditionOp>(op))
    return;
  if (llvm::none_of(op->getOperands(),
                    [&](Value v) { return plan.activity.isVaried(v); }))
    return;
  InFlightDiagnostic diag =
      emitError(op, "a derivative is lost in '" + op->getName().getStringRef() +
                        "', which cannot be differentiated");
  if (isa<AppendOp>(op))
    diag.attachNote() << "store the value to the element by an index; the "
                         "list grows to the highest one";
  if (isa<CallOpInterface>(op))
    diag.attachNote() << kInlineFirst;
  else
    attachHelpfulPass(diag, op);
}

LogicalResult Verifier::run() {
  checkArrays();
  auto hasAdjoint = [&](Storage storage) {
    return static_cast<bool>(plan.adjointOf(storage));
  };
  DerivativeEnds ends{hasAdjoint, plan.shadows.inputs, plan.shadows.outputs};
  (void)verifyDerivativePaths(primal, ends,
                              [&](Operation *op, const Twine &message) {
                                return emitError(op, message);
                              });
  checkDeactivation();
  primal.walk([&](Operation *op) {
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
      checkAccess(access);
    else
      checkSink(op);
  });
  return failure(hasErrors);
}

LogicalResult mlir::tai::verifyReversible(const AdjointPlan &plan) {
  return Verifier(plan).run();
}
