//===- IndexExpr.cpp - Index expressions ----------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/Index/IndexExpr.h"
#include "llvm/ADT/STLExtras.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Atoms
//===----------------------------------------------------------------------===//

/// Sorts the operands of commutative operations.
static IndexNode sortOperands(IndexNode node) {
  if (!node.isDivision() && node.rhs.compare(node.lhs) < 0)
    std::swap(node.lhs, node.rhs);
  return node;
}

IndexAtom::IndexAtom(IndexNode node)
    : node(std::make_shared<const IndexNode>(sortOperands(std::move(node)))) {}

bool IndexAtom::allOf(llvm::function_ref<bool(Value)> predicate) const {
  if (value)
    return predicate(value);
  return node->lhs.allOf(predicate) && node->rhs.allOf(predicate);
}

bool IndexAtom::mentions(Value wanted) const {
  return !allOf([&](Value used) { return used != wanted; });
}

template <typename T> static int compareNumbers(T a, T b) {
  return a < b ? -1 : a == b ? 0 : 1;
}

int IndexAtom::compare(const IndexAtom &other) const {
  if (value || other.value || node == other.node)
    return compareNumbers(value.getAsOpaquePointer(),
                          other.value.getAsOpaquePointer());
  if (int order = compareNumbers(node->kind, other.node->kind))
    return order;
  if (int order = node->lhs.compare(other.node->lhs))
    return order;
  return node->rhs.compare(other.node->rhs);
}

//===----------------------------------------------------------------------===//
// Sums
//===----------------------------------------------------------------------===//

static int64_t addWrapping(int64_t a, int64_t b) {
  return static_cast<int64_t>(static_cast<uint64_t>(a) +
                              static_cast<uint64_t>(b));
}

static int64_t multiplyWrapping(int64_t a, int64_t b) {
  return static_cast<int64_t>(static_cast<uint64_t>(a) *
                              static_cast<uint64_t>(b));
}

IndexExpr::IndexExpr(IndexNode node) : IndexExpr(IndexAtom(std::move(node))) {}

int IndexExpr::compare(const IndexExpr &other) const {
  if (int order = compareNumbers(terms.size(), other.terms.size()))
    return order;
  for (auto [a, b] : llvm::zip(terms, other.terms)) {
    if (int order = a.first.compare(b.first))
      return order;
    if (int order = compareNumbers(a.second, b.second))
      return order;
  }
  return compareNumbers(constant, other.constant);
}

IndexExpr &IndexExpr::add(const IndexExpr &other, int64_t scale) {
  width = std::min(width, other.width);
  constant = addWrapping(constant, multiplyWrapping(scale, other.constant));
  for (const auto &[atom, factor] : other.terms) {
    int64_t added = multiplyWrapping(scale, factor);
    auto *at = llvm::lower_bound(terms, atom, [](auto &term, auto &wanted) {
      return term.first.compare(wanted) < 0;
    });
    if (at == terms.end() || !(at->first == atom)) {
      if (added != 0)
        terms.insert(at, {atom, added});
      continue;
    }
    at->second = addWrapping(at->second, added);
    if (at->second == 0)
      terms.erase(at);
  }
  return *this;
}

unsigned IndexExpr::getSize() const {
  unsigned size = 0;
  for (const auto &[atom, factor] : terms)
    size += atom.getNode() ? atom.getNode()->size : 1;
  return size;
}

int64_t IndexExpr::getCoefficient(Value value) const {
  for (const auto &[atom, factor] : terms)
    if (atom.getValue() == value)
      return factor;
  return 0;
}

bool IndexExpr::allOf(llvm::function_ref<bool(Value)> predicate) const {
  return llvm::all_of(
      terms, [&](const auto &term) { return term.first.allOf(predicate); });
}

bool IndexExpr::mentions(Value value) const {
  return !allOf([&](Value used) { return used != value; });
}

IndexExpr IndexExpr::substitute(
    llvm::function_ref<std::optional<IndexExpr>(Value)> replace) const {
  IndexExpr result(constant);
  for (const auto &[atom, factor] : terms) {
    if (const IndexNode *node = atom.getNode()) {
      IndexExpr made(IndexNode{node->kind, node->lhs.substitute(replace),
                               node->rhs.substitute(replace)});
      result.add(made, factor);
    } else if (std::optional<IndexExpr> other = replace(atom.getValue())) {
      result.add(*other, factor);
    } else {
      result.add(IndexExpr(atom), factor);
    }
  }
  result.width = width;
  return result;
}
