//===- IterationDomains.h - Iteration domains of blocks ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The loops and conditions around a block bound the iterations in which it
// runs: a union of linear systems over loop indices and launch values.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_ITERATIONDOMAINS_H
#define TAI_ANALYSIS_ITERATIONDOMAINS_H

#include "tai/Analysis/Index/IndexForms.h"

namespace mlir::tai {

/// The iterations in which a block runs, as a union of systems.
struct IterationDomain {
  SmallVector<SmallVector<LinearSum>, 1> pieces;
  /// The variables that stand for the loop indices, outermost loop first.
  SmallVector<unsigned> loops;
  /// True if the domain has no extra points: each point is an iteration in
  /// which the block runs.
  bool isCertain = true;
  /// True if the domain misses no point: each iteration in which the block runs
  /// is in it.
  bool isComplete = true;

  void addRow(const LinearSum &row);
  void addFacts(const LinearForm &form);
};

class IterationDomains {
public:
  IterationDomains(KernelOp kernel, IndexForms &forms)
      : kernel(kernel), forms(forms) {}

  IterationDomain domainOf(Block *block);

private:
  using Domain = IterationDomain;

  void addLoop(Domain &domain, ParallelForOp loop);
  void addLoop(Domain &domain, BlockArgument iv, Value lower, Value upper);
  void addCondition(Domain &domain, Value condition, bool holds);
  void addComparison(Domain &domain, Value lhs, Value rhs, int64_t gap);
  void addEither(Domain &domain, function_ref<void(Domain &)> first,
                 function_ref<void(Domain &)> second);

  KernelOp kernel;
  IndexForms &forms;
  llvm::DenseMap<Block *, Domain> domains;
};

} // namespace mlir::tai

#endif // TAI_ANALYSIS_ITERATIONDOMAINS_H
