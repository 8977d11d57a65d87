//===- LinearSystem.cpp - Systems of linear inequalities ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/LinearSystem.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/Support/MathExtras.h"
#include <numeric>

using namespace mlir;
using namespace mlir::tai;

/// Systems of loop nests have about a dozen rows. Eliminating a variable at
/// worst squares the number of rows.
static constexpr size_t kMaxRows = 64;

//===----------------------------------------------------------------------===//
// Sums
//===----------------------------------------------------------------------===//

int64_t LinearSum::getFactor(unsigned variable) const {
  for (auto [number, factor] : terms)
    if (number == variable)
      return factor;
  return 0;
}

void LinearSum::add(const LinearSum &other, int64_t scale) {
  *this = plus(other, scale);
}

LinearSum LinearSum::plus(const LinearSum &other, int64_t scale) const {
  LinearSum sum;
  sum.hasOverflow = hasOverflow || other.hasOverflow;
  auto combine = [&](int64_t a, int64_t b) {
    int64_t product = 0, result = 0;
    sum.hasOverflow |= llvm::MulOverflow(b, scale, product) != 0;
    sum.hasOverflow |= llvm::AddOverflow(a, product, result) != 0;
    return result;
  };
  const auto *a = terms.begin();
  const auto *b = other.terms.begin();
  while (a != terms.end() || b != other.terms.end()) {
    bool takesA =
        b == other.terms.end() || (a != terms.end() && a->first <= b->first);
    bool takesB =
        a == terms.end() || (b != other.terms.end() && b->first <= a->first);
    unsigned number = takesA ? a->first : b->first;
    int64_t factor =
        combine(takesA ? (a++)->second : 0, takesB ? (b++)->second : 0);
    if (factor != 0)
      sum.terms.emplace_back(number, factor);
  }
  sum.constant = combine(constant, other.constant);
  return sum;
}

//===----------------------------------------------------------------------===//
// Systems
//===----------------------------------------------------------------------===//

void LinearSystem::require(LinearSum sum) {
  if (sum.hasOverflow) {
    unknown = true;
    return;
  }
  if (sum.terms.empty()) {
    contradictory |= sum.constant < 0;
    return;
  }
  int64_t divisor = 0;
  for (auto &term : sum.terms)
    divisor = std::gcd(divisor, term.second);
  if (divisor > 1) {
    for (auto &term : sum.terms)
      term.second /= divisor;
    sum.constant = llvm::divideFloorSigned(sum.constant, divisor);
  }
  for (LinearSum &row : rows) {
    if (row.terms == sum.terms) {
      row.constant = std::min(row.constant, sum.constant);
      return;
    }
    // Opposite rows a + c >= 0 and -a + d >= 0 imply c + d >= 0: if that is
    // false, the system is contradictory.
    LinearSum both = row.plus(sum);
    contradictory |=
        !both.hasOverflow && both.terms.empty() && both.constant < 0;
  }
  rows.push_back(std::move(sum));
  unknown |= rows.size() > kMaxRows;
}

SmallVector<unsigned> LinearSystem::getVariables() const {
  SmallVector<unsigned> variables;
  for (const LinearSum &row : rows)
    for (auto &term : row.terms)
      variables.push_back(term.first);
  llvm::sort(variables);
  variables.erase(llvm::unique(variables), variables.end());
  return variables;
}

LinearSystem LinearSystem::eliminate(unsigned variable, Shadow shadow,
                                     bool &isExact) const {
  LinearSystem result;
  result.unknown = unknown;
  result.contradictory = contradictory;
  SmallVector<const LinearSum *> lower, upper;
  for (const LinearSum &row : rows) {
    int64_t factor = row.getFactor(variable);
    if (factor == 0)
      result.require(row);
    else
      (factor > 0 ? lower : upper).push_back(&row);
  }
  for (const LinearSum *low : lower)
    for (const LinearSum *high : upper) {
      if (result.unknown || result.contradictory)
        return result;
      int64_t a = low->getFactor(variable), b = -high->getFactor(variable);
      LinearSum sum = LinearSum().plus(*low, b).plus(*high, a);
      if (a != 1 && b != 1) {
        isExact = false;
        if (shadow == Shadow::Dark)
          sum.add(LinearSum::of(a - 1), -(b - 1));
      }
      result.require(std::move(sum));
    }
  return result;
}
