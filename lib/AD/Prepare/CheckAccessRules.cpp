//===- CheckAccessRules.cpp - The global data access rules ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Looks for races of iterations of one parallel loop on an element of a field
// with an adjoint, which make its value and its gradient undefined. Only
// certain races are reported; a legal program is never rejected.
//
//===----------------------------------------------------------------------===//

#include "../SelectedFunctionsPass.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Matchers.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/Activity.h"
#include "tai/Analysis/Races.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_CHECKACCESSRULES
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

static std::string getName(DifferentiableAccessInterface access) {
  if (FlatSymbolRefAttr field = access.getAccessedStorage().field)
    return ("field '@" + field.getValue() + "'").str();
  return "array";
}

/// Returns the number of iterations of a loop along dimension `dim`, if it is
/// constant.
static std::optional<int64_t> getExtent(Operation *loop, unsigned dim) {
  auto getConstant = [](Value value) -> std::optional<int64_t> {
    APInt constant;
    if (!matchPattern(value, m_ConstantInt(&constant)))
      return std::nullopt;
    return constant.getSExtValue();
  };
  std::optional<int64_t> lower, upper;
  if (auto parallel = dyn_cast<ParallelForOp>(loop)) {
    if (parallel.isStructFor()) {
      FieldLayout layout =
          *getFieldLayout(lookupField(parallel, parallel.getFieldAttr()));
      // A loop over the active cells of a sparse field has no trip count that
      // is known at compile time.
      if (parallel.getLevel() || layout.path.getFirstSparse())
        return std::nullopt;
      return layout.shape[dim];
    }
    lower = getConstant(parallel.getLowerBounds()[dim]);
    upper = getConstant(parallel.getUpperBounds()[dim]);
  } else if (auto serial = dyn_cast<scf::ForOp>(loop)) {
    if (matchPattern(serial.getStep(), m_One())) {
      lower = getConstant(serial.getLowerBound());
      upper = getConstant(serial.getUpperBound());
    }
  }
  if (!lower || !upper)
    return std::nullopt;
  return *upper - *lower;
}

/// A parallel loop around `access`, with no branch in between, of which at
/// least two iterations reach the same element; or null.
static Operation *findRepeatingLoop(DifferentiableAccessInterface access) {
  SmallVector<IndexExpr> indices = getIndexExprs(access.getAccessIndices());
  SmallVector<IndexExpr> parts = getIndexExprs(access.getAccessComponents());
  indices.append(parts);
  Operation *op = access;
  for (Operation *parent = op->getParentOp();
       isa<ParallelForOp, scf::ForOp>(parent); parent = parent->getParentOp()) {
    // Each index must consist of loop indices and values from outside of the
    // loop: other values can differ in each iteration.
    for (const IndexExpr &index : indices)
      if (!index.allOf([&](Value value) {
            return isa<BlockArgument>(value) ||
                   !parent->isAncestor(value.getDefiningOp());
          }))
        return nullptr;
    unsigned dims = isa<scf::ForOp>(parent)
                        ? 1
                        : cast<ParallelForOp>(parent).getInductionVars().size();
    Block &body = parent->getRegion(0).front();
    for (BlockArgument argument : body.getArguments().drop_front(dims))
      for (const IndexExpr &index : indices)
        if (index.mentions(argument))
          return nullptr; // carried
    for (unsigned dim = 0; dim != dims; ++dim) {
      Value iv = body.getArgument(dim);
      bool isUsed = llvm::any_of(
          indices, [&](const IndexExpr &index) { return index.mentions(iv); });
      std::optional<int64_t> extent = getExtent(parent, dim);
      if (!isUsed && extent && *extent >= 2 && !isSerialLoop(parent))
        return parent;
    }
  }
  return nullptr;
}

namespace {
/// Checks one function.
class Checker {
public:
  Checker(FunctionOpInterface function, const Activity &activity)
      : table(function), activity(activity) {}

  LogicalResult check() {
    for (auto &[storage, accesses] : table.getStorages()) {
      for (DifferentiableAccessInterface access : accesses)
        checkRepeated(access);
      for (DifferentiableAccessInterface first : accesses)
        for (DifferentiableAccessInterface second : accesses)
          if (first.getAccessKind() == AccessKind::Accumulate &&
              second.getAccessKind() == AccessKind::Read)
            checkEarlyRead(first, second);
      checkRaces(accesses);
    }
    return failure(hasErrors);
  }

private:
  InFlightDiagnostic report(Operation *op, const Twine &message) {
    hasErrors = true;
    return op->emitError() << message;
  }

  bool isActive(DifferentiableAccessInterface access) {
    return activity.isActiveAccess(access);
  }

  /// Reports a store in a parallel loop whose indices do not depend on the
  /// loop.
  void checkRepeated(DifferentiableAccessInterface access) {
    if (access.getAccessKind() != AccessKind::Write || !isActive(access))
      return;
    Operation *loop = findRepeatingLoop(access);
    if (!loop || !reported.insert(access).second)
      return;
    InFlightDiagnostic diag = report(
        access, "an element of " + getName(access) +
                    " is overwritten in every iteration of a parallel "
                    "loop, so its value and its gradient would be wrong");
    diag.attachNote(loop->getLoc()) << "the indices do not depend on this loop";
    diag.attachNote() << "accumulate with 'tai.atomic add', or store to an "
                         "element for each iteration";
  }

  /// Reports a read of an element after an accumulation in the same parallel
  /// loop: other iterations may still accumulate to the element (rule 2).
  void checkEarlyRead(DifferentiableAccessInterface accumulation,
                      DifferentiableAccessInterface read) {
    Operation *loop = getEnclosingParallelLoop(accumulation);
    if (!loop || !loop->isAncestor(read) || !isActive(read) ||
        reported.contains(read) || !runsAfter(accumulation, read) ||
        !reachSameElement(accumulation, read))
      return;
    auto parallel = dyn_cast<ParallelForOp>(loop);
    if (!parallel || parallel.getSerialize() ||
        findRepeatingLoop(accumulation) != loop)
      return;
    reported.insert(read);
    InFlightDiagnostic diag = report(
        read, "an element of " + getName(read) +
                  " is read before its accumulation is done, so its value and "
                  "its gradient would be wrong");
    diag.attachNote(accumulation->getLoc())
        << "other iterations of the loop still accumulate here";
    diag.attachNote() << "read it in a later loop";
  }

  /// Reports iterations of a parallel loop that reach the same element, if one
  /// of them stores to the element, or if one writes it and another reads it.
  void checkRaces(const Accesses &accesses) {
    for (size_t i = 0; i != accesses.size(); ++i) {
      DifferentiableAccessInterface write = accesses[i];
      if (write.getAccessKind() == AccessKind::Read)
        continue;
      bool isStore = write.getAccessKind() == AccessKind::Write;
      for (size_t j = 0; j != accesses.size(); ++j) {
        DifferentiableAccessInterface other = accesses[j];
        bool isRead = other.getAccessKind() == AccessKind::Read;
        bool isOrdered = other.getAccessKind() != AccessKind::Write || j > i;
        if ((!isRead && (!isStore || !isOrdered)) || reported.contains(other) ||
            reported.contains(write) ||
            (!isActive(other) && (isRead || !isActive(write))))
          continue;
        if (Operation *loop = findRace(write, other))
          reportRace(write, other, loop);
      }
    }
  }

  void reportRace(DifferentiableAccessInterface write,
                  DifferentiableAccessInterface other, Operation *loop) {
    bool isRead = other.getAccessKind() == AccessKind::Read;
    reported.insert(other);
    InFlightDiagnostic diag = report(
        other, "an element of " + getName(other) + " is " +
                   (isRead ? "read" : "written") +
                   " here by one iteration of a parallel loop, while another "
                   "one writes it, so its value and its gradient would be "
                   "wrong");
    diag.attachNote(write->getLoc()) << "written here";
    diag.attachNote(loop->getLoc())
        << "run this loop on one thread ('serialize')"
        << (isRead ? ", or write to another field and copy it in a later loop"
                   : ", or accumulate with 'tai.atomic add'");
  }

  AccessTable table;
  const Activity &activity;
  DenseSet<Operation *> reported;
  bool hasErrors = false;
};

struct CheckAccessRules
    : SelectedFunctionsPass<CheckAccessRules, tai::impl::CheckAccessRulesBase> {
  using SelectedFunctionsPass::SelectedFunctionsPass;

  LogicalResult runOnFunction(FunctionOpInterface function) {
    markAllAnalysesPreserved();
    Activity activity(function, [&](Storage storage) {
      return mayHaveAdjoint(function, storage);
    });
    return Checker(function, activity).check();
  }
};
} // namespace
