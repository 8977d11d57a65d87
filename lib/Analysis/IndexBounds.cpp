//===- IndexBounds.cpp - Indices and the loops around them ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/IndexBounds.h"
#include "tai/Support/BoundsMode.h"

using namespace mlir;
using namespace mlir::tai;

/// The maximum number of loops: a nest of n loops has 2^n corners to check.
static constexpr size_t kMaxLoops = 3;

bool tai::checksIndices(Operation *op) {
  auto kernel = dyn_cast<KernelOp>(op);
  if (!kernel)
    kernel = op->getParentOfType<KernelOp>();
  return kernel && kernel.getChecksIndices();
}

void IndexBounds::checkPiece(const IterationDomain &domain, LinearSystem system,
                             BoundsAnswer &answer, bool &isExact) {
  // First it is decided whether the system has a solution for any launch at
  // all. The known ranges of launch values help to decide this, but do not
  // become part of the checks at launch time.
  LinearSystem all = system;
  SmallVector<unsigned> used = system.getVariables();
  for (unsigned number : used) {
    NumberRange range = forms.getRange(number);
    LinearSum self = LinearSum::variable(number);
    if (range.low != INT64_MIN)
      all.require(self.plus(LinearSum::of(range.low), -1));
    if (range.high != INT64_MAX)
      all.require(LinearSum::of(range.high).plus(self, -1));
  }
  bool ignored = true;
  for (unsigned number : llvm::reverse(used))
    if (!all.isContradictory() && !all.isUnknown())
      all = all.eliminate(number, LinearSystem::Shadow::Real, ignored);
  if (all.isContradictory())
    return;
  isExact &= !all.isUnknown();
  answer.isInRange = false;
  if (!domain.isCertain)
    return;

  eliminateLoops(domain, std::move(system), {}, answer, isExact);
}

/// Eliminates the loop indices from `system`, and adds the conditions on a
/// launch that remain as a violation: an iteration solves the system if they
/// hold. `violation` has the loop indices that are already determined.
void IndexBounds::eliminateLoops(const IterationDomain &domain,
                                 LinearSystem system, Violation violation,
                                 BoundsAnswer &answer, bool &isExact) {
  // Inner loops are eliminated first, and for the report it is noted how each
  // loop index follows from the indices of the loops around it.
  SmallVector<Violation::Step> known = std::move(violation.iteration);
  violation.iteration.clear();
  SmallVector<unsigned> used = system.getVariables(), order;
  for (unsigned number : used)
    if (forms.getKind(number) == IndexForms::Kind::Quotient)
      order.push_back(number);
  for (unsigned number : llvm::reverse(domain.loops))
    if (llvm::is_contained(used, number))
      order.push_back(number);
  for (unsigned number : order) {
    violation.iteration.push_back({number, system});
    system = system.eliminate(number, LinearSystem::Shadow::Dark, isExact);
    if (system.isContradictory() || system.isUnknown())
      break;
  }
  std::reverse(violation.iteration.begin(), violation.iteration.end());
  violation.iteration.insert(violation.iteration.begin(), known.begin(),
                             known.end());
  if (system.isUnknown()) {
    isExact = false;
    return;
  }
  if (system.isContradictory())
    return;
  for (const LinearSum &row : system.getRows()) {
    for (auto [variable, factor] : row.terms)
      if (!forms.getLaunchValue(variable)) {
        isExact = false;
        return;
      }
    if (forms.rangeOfSum(row).low < 0)
      violation.launch.require(row);
  }
  answer.violations.push_back(std::move(violation));
}

//===----------------------------------------------------------------------===//
// Products of loop indices and arguments
//===----------------------------------------------------------------------===//

// Where n is known only at the launch, x[i * n + j] is no linear sum, but it is
// one for each launch, and so has its largest and its smallest value in a
// corner of a box of iterations, where each loop is in its first or in its last
// iteration. There, the index is a sum of launch values and of their products,
// which the launch computes. All conditions around the access are checked for a
// corner, so that its iteration does run; iterations other than corners are not
// checked.

/// A corner of a box of iterations: for each loop of the box, the sum that
/// replaces its index.
using Corner = llvm::SmallDenseMap<unsigned, LinearSum, 4>;

/// Collects in `loops` the loops whose indices occur in products in `sum`.
static void collectLoopsOfProducts(const IndexForms &forms,
                                   const LinearSum &sum, bool isInProduct,
                                   SmallVectorImpl<unsigned> &loops) {
  for (auto [variable, factor] : sum.terms) {
    IndexForms::Kind kind = forms.getKind(variable);
    if (kind == IndexForms::Kind::Product)
      collectLoopsOfProducts(forms, forms.getFactors(variable)[1], true, loops);
    else if (kind == IndexForms::Kind::Loop && isInProduct &&
             !llvm::is_contained(loops, variable))
      loops.push_back(variable);
  }
}

/// Replaces the loop indices in `sum` by those of `corner`. Products of a
/// launch value and a replaced loop index become launch values.
static LinearSum substitute(IndexForms &forms, const LinearSum &sum,
                            const Corner &corner,
                            SmallVectorImpl<LinearSum> &facts) {
  LinearSum result = LinearSum::of(sum.constant);
  result.hasOverflow = sum.hasOverflow;
  for (auto [variable, factor] : sum.terms) {
    LinearSum value = LinearSum::variable(variable);
    if (auto known = corner.find(variable); known != corner.end()) {
      value = known->second;
    } else if (forms.getKind(variable) == IndexForms::Kind::Product) {
      // Copy both factors: making a new variable may reallocate the table that
      // holds them.
      LinearSum first = forms.getFactors(variable)[0];
      LinearSum second = forms.getFactors(variable)[1];
      second = substitute(forms, second, corner, facts);
      if (forms.isOfLaunch(second))
        value = forms.multiply(first, second, facts);
    }
    result.add(value, factor);
  }
  return result;
}

/// Checks, in each corner of the loops whose indices occur in products, whether
/// the access goes out of range.
void IndexBounds::checkCorners(const IterationDomain &domain,
                               ArrayRef<LinearSum> piece,
                               const LinearSum &beyond, BoundsAnswer &answer,
                               bool &isExact) {
  answer.isInRange = isExact = false;
  SmallVector<unsigned> used, loops;
  collectLoopsOfProducts(forms, beyond, false, used);
  // Outer loops come first, because the bounds of inner loops may depend on
  // their indices.
  for (unsigned loop : domain.loops)
    if (llvm::is_contained(used, loop))
      loops.push_back(loop);
  if (!domain.isCertain || loops.size() != used.size() ||
      loops.size() > kMaxLoops)
    return;
  for (unsigned choice = 0; choice != 1u << loops.size(); ++choice) {
    Corner corner;
    SmallVector<LinearSum> facts;
    Violation violation;
    for (auto [number, loop] : llvm::enumerate(loops)) {
      // The bound of this loop is one row of the system: loop - first >= 0, or
      // last - loop >= 0.
      int64_t side = choice >> number & 1 ? -1 : 1;
      for (const LinearSum &row : piece) {
        if (row.getFactor(loop) != side)
          continue;
        LinearSum rest = row.plus(LinearSum::variable(loop), -side);
        rest = substitute(forms, LinearSum().plus(rest, -side), corner, facts);
        if (!forms.isOfLaunch(rest))
          continue;
        corner[loop] = rest;
        Violation::Step step{loop, {}};
        step.system.require(LinearSum::variable(loop).plus(rest, -1));
        violation.iteration.push_back(std::move(step));
        break;
      }
    }
    if (corner.size() != loops.size())
      continue;
    LinearSystem system;
    system.require(substitute(forms, beyond, corner, facts));
    for (const LinearSum &row : piece)
      system.require(substitute(forms, row, corner, facts));
    system.require(facts);
    if (!system.isContradictory() && !system.isUnknown())
      eliminateLoops(domain, std::move(system), std::move(violation), answer,
                     isExact);
  }
}

//===----------------------------------------------------------------------===//
// Decisions
//===----------------------------------------------------------------------===//

/// Adds violations for iterations in which the index is beyond one end of its
/// range, that is, `beyond` is not negative.
void IndexBounds::checkSide(const IterationDomain &domain,
                            const LinearSum &beyond, BoundsAnswer &answer,
                            bool &isExact) {
  // The range alone decides for most indices, which are a loop index plus a
  // small constant.
  if (forms.rangeOfSum(beyond).high < 0)
    return;
  for (const SmallVector<LinearSum> &piece : domain.pieces) {
    LinearSystem system;
    system.require(piece);
    system.require(beyond);
    if (forms.hasProduct(beyond))
      checkCorners(domain, piece, beyond, answer, isExact);
    else
      checkPiece(domain, std::move(system), answer, isExact);
  }
}

BoundsAnswer IndexBounds::check(const IndexedAccess &access, size_t number,
                                bool proves) {
  BoundsAnswer answer;
  Value index = access.indices[number]->get();
  int64_t first = access.first[number];
  const Extent &extent = access.extents[number];
  NumberRange range = forms.rangeOf(index);
  if (!extent.array && range.isWithin({first, first + extent.number - 1})) {
    answer.isInRange = answer.isDecided = true;
    return answer;
  }
  LinearForm form = forms.formOf(index);
  if (!form.isCertain && !proves)
    return answer;
  LinearForm size;
  size.sum = LinearSum::of(extent.number);
  if (extent.array)
    size = forms.makeLaunchForm({{}, extent.array, extent.number},
                                NumberRange{0, int64_t(1) << 47});
  IterationDomain domain = domains.domainOf(access.op->getBlock());
  domain.addFacts(form);
  answer.isInRange = true;
  bool isExact = true;
  // The index is out of range if first - 1 - index >= 0, or if index - (first +
  // size) >= 0.
  checkSide(domain, LinearSum::of(first - 1).plus(form.sum, -1), answer,
            isExact);
  checkSide(domain, form.sum.plus(size.sum, -1).plus(-first), answer, isExact);
  for (Violation &violation : answer.violations)
    violation.launch = forms.dropAssumptions(violation.launch, form.sum);
  answer.isInRange &= domain.isComplete;
  answer.isDecided =
      answer.isInRange || (domain.isComplete && domain.isCertain && isExact);
  return answer;
}

std::optional<LinearSum> IndexBounds::getSum(Value index) {
  LinearForm form = forms.formOf(index);
  if (!form.isCertain)
    return std::nullopt;
  return form.sum;
}
