//===- SimplifyHugeBodies.cpp - Canonicalises huge bodies -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Each rewrite puts the enclosing ops back on the worklist, and a loop is dead
// if nothing in its body has an effect: so the whole body is visited again
// after each rewrite in it. Rewriting one body at a time, restricted to its own
// region, avoids visiting the loops around it.
//
// CSE looks for a write between two equal reads by walking from one to the
// other, for each pair. Here one walk over the body drops known reads at each
// write instead.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/OperationSupport.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "mlir/Transforms/GreedyPatternRewriteDriver.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Transforms/Passes.h"
#include "tai/Transforms/Utils/Canonicalization.h"
#include "llvm/ADT/STLExtras.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SIMPLIFYHUGEBODIES
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;

/// The canonicalization patterns of all loaded dialects and registered ops.
static FrozenRewritePatternSet getCanonicalization(MLIRContext *context) {
  RewritePatternSet patterns(context);
  for (Dialect *dialect : context->getLoadedDialects())
    dialect->getCanonicalizationPatterns(patterns);
  for (RegisteredOperationName op : context->getRegisteredOperations())
    op.getCanonicalizationPatterns(patterns, context);
  return FrozenRewritePatternSet(std::move(patterns), tai::getBrokenPatterns());
}

/// Returns the ops of a block and of its nested regions, the last op first,
/// because the rewriter takes ops from the end of the list.
static SmallVector<Operation *> collect(Block &block) {
  SmallVector<Operation *> ops;
  block.walk<WalkOrder::PreOrder>([&](Operation *op) { ops.push_back(op); });
  std::reverse(ops.begin(), ops.end());
  return ops;
}

namespace {
/// Compares ops by kind, attributes and operands.
struct SameOp : public llvm::DenseMapInfo<Operation *> {
  static unsigned getHashValue(const Operation *op) {
    return OperationEquivalence::computeHash(
        const_cast<Operation *>(op), OperationEquivalence::directHashValue,
        OperationEquivalence::ignoreHashValue,
        OperationEquivalence::IgnoreLocations);
  }
  static bool isEqual(const Operation *lhs, const Operation *rhs) {
    if (lhs == rhs)
      return true;
    for (const Operation *op : {lhs, rhs})
      if (op == getTombstoneKey() || op == getEmptyKey())
        return false;
    return OperationEquivalence::isEquivalentTo(
        const_cast<Operation *>(lhs), const_cast<Operation *>(rhs),
        OperationEquivalence::IgnoreLocations);
  }
};
} // namespace

/// Merges equal ops of a block into one.
static void mergeEqual(Block &block) {
  DenseSet<Operation *, SameOp> values, reads;
  for (Operation &op : llvm::make_early_inc_range(block)) {
    std::optional<SmallVector<MemoryEffects::EffectInstance>> effects =
        getEffectsRecursively(&op);
    if (!effects || llvm::any_of(*effects, [](auto &effect) {
          return !isa<MemoryEffects::Read>(effect.getEffect());
        })) {
      reads.clear();
      continue;
    }
    if (op.getNumRegions() != 0 || op.hasTrait<OpTrait::IsTerminator>() ||
        op.getNumResults() == 0)
      continue;
    auto [known, isNew] = (effects->empty() ? values : reads).insert(&op);
    if (isNew)
      continue;
    op.replaceAllUsesWith(*known);
    op.erase();
  }
}

namespace {
struct SimplifyHugeBodies
    : tai::impl::SimplifyHugeBodiesBase<SimplifyHugeBodies> {
  using Base::Base;

  void runOnOperation() override {
    // Inner bodies first.
    SmallVector<Block *> huge;
    tai::walkOwned(getOperation(), [&](Operation *owned) {
      owned->walk([&](Operation *op) {
        if (op->hasTrait<OpTrait::IsIsolatedFromAbove>())
          return;
        for (Region &region : op->getRegions())
          if (region.hasOneBlock() &&
              llvm::hasNItemsOrMore(region.front(), minOps))
            huge.push_back(&region.front());
      });
    });
    if (huge.empty())
      return markAllAnalysesPreserved();
    FrozenRewritePatternSet patterns = getCanonicalization(&getContext());
    for (Block *block : huge) {
      GreedyRewriteConfig config;
      config.setScope(block->getParent());
      (void)applyOpPatternsGreedily(collect(*block), patterns, config);
      mergeEqual(*block);
    }
  }
};
} // namespace
