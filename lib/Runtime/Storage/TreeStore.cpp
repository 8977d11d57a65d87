//===- TreeStore.cpp - The trees and fields of a runtime ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/TreeStore.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <sys/mman.h>
#include <unistd.h>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Trees
//===----------------------------------------------------------------------===//

/// Writes to each page of a range of memory, which makes the system provide the
/// pages.
static void commitPages(char *begin, int64_t bytes) {
  int64_t page = sysconf(_SC_PAGESIZE);
  for (int64_t at = 0; at < bytes; at += page)
    *static_cast<volatile char *>(begin + at) = 0;
}

/// The most bytes of address space that trees with sparse levels may reserve;
/// the system gives out less than 47 bits of addresses.
static constexpr int64_t largestReservation = int64_t(1) << 45;

Status TreeStore::addTree(std::string name, int64_t bytes, TreePtr &tree,
                          std::vector<SparseInfo> sparse) {
  if (treesByName.count(name))
    return Status::failure(StatusCode::Usage,
                           "a tree '" + name + "' exists already");
  if (bytes < 0)
    return Status::failure(StatusCode::Usage,
                           "tree '" + name + "' has a negative size");
  if (!sparse.empty() && mirrors) {
    Status status = mirrors->check(name, bytes, sparse);
    if (!status)
      return status;
  }
  if (!sparse.empty() && bytes > largestReservation)
    return Status::failure(StatusCode::Memory,
                           "tree '" + name + "' spans " + formatBytes(bytes) +
                               " with all cells active, and " +
                               formatBytes(largestReservation) +
                               " is the most that can be addressed");
  // Only dense trees are checked against the memory limit: the memory that a
  // sparse tree needs is not known until cells become active.
  int64_t needed = sparse.empty() ? bytes : 0;
  if (needed > memory.left())
    return Status::failure(
        StatusCode::Memory,
        "out of memory: tree '" + name + "' needs " + formatBytes(bytes) +
            ", " + formatBytes(memory.reserved()) + " of " +
            formatBytes(memory.limit()) + " are taken by " +
            std::to_string(treesByName.size()) + " other trees");
  size_t page = static_cast<size_t>(sysconf(_SC_PAGESIZE));
  // Trees start at different offsets in their pages: loops over several arrays
  // that share the low bits of their addresses stall on false dependences.
  // The address of the Tree object is stored in front of the base.
  size_t stagger = 64 + (treesMade % 8) * 320;
  size_t mapped = (static_cast<size_t>(bytes) + stagger + page) / page * page;
  void *mapping = mmap(nullptr, mapped, PROT_READ | PROT_WRITE,
                       MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapping == MAP_FAILED)
    return Status::failure(StatusCode::Memory,
                           "out of memory: the system refuses " +
                               formatBytes(bytes) + " for tree '" + name +
                               "' (" + formatBytes(memory.reserved()) +
                               " are taken by other trees)");
  if (sparse.empty() && bytes >= (int64_t(8) << 20))
    (void)madvise(mapping, mapped, MADV_HUGEPAGE);
  if (sparse.empty() && !lists.skips.has(Skip::UntouchedMemory))
    commitPages(static_cast<char *>(mapping), static_cast<int64_t>(mapped));
  ++treesMade;
  tree = std::make_shared<Tree>();
  tree->treeName = name;
  tree->cells.base = static_cast<char *>(mapping) + stagger;
  tree->cells.allActiveBytes = &memory.activeCells;
  tree->cells.lists = &lists;
  tree->size = bytes;
  tree->memory = std::shared_ptr<void>(
      mapping, [mapped](void *start) { munmap(start, mapped); });
  tree->charged = needed;
  reinterpret_cast<Tree **>(tree->cells.base)[-1] = tree.get();
  for (SparseInfo &info : sparse) {
    SparseNode *parent =
        info.parent < 0 ? nullptr : tree->nodes[info.parent].get();
    tree->nodes.push_back(
        std::make_unique<SparseNode>(tree->cells, std::move(info), parent));
  }
  if (mirrors) {
    SparseOnDevice *levels = nullptr;
    tree->mirrored = mirrors->make(*tree, levels);
    for (const std::unique_ptr<SparseNode> &node : tree->nodes)
      node->setOnDevice(levels);
  }
  memory.reserve(needed);
  treesByName.emplace(std::move(name), tree);
  return Status::success();
}

void TreeStore::freeTree(Tree &tree) {
  for (const std::unique_ptr<SparseNode> &node : tree.nodes)
    node->setOnDevice(nullptr);
  tree.mirrored.reset();
  tree.memory.reset();
  memory.release(tree.charged);
  memory.activeCells -= tree.activeCellBytes();
  tree.cells.base = nullptr;
}

TreeStore::~TreeStore() {
  for (auto &entry : treesByName)
    freeTree(*entry.second);
}

void TreeStore::setClosing(Tree &tree, bool isClosing) {
  tree.isClosing.store(isClosing, std::memory_order_release);
  // A change of storage is noted, so that kernels check their trees again.
  if (isClosing)
    state.storageChanged();
}

Status TreeStore::destroyTree(const std::string &name) {
  auto found = treesByName.find(name);
  if (found == treesByName.end())
    return Status::failure(StatusCode::Usage,
                           "there is no tree '" + name + "'");
  Tree *tree = found->second.get();
  {
    std::lock_guard<std::mutex> changing(fieldsMutex);
    auto isGone = [&](const FieldPtr &field) {
      if (&field->tree() != tree)
        return false;
      // If the adjoint of the field lies in another tree, the adjoint has no
      // primal field any more.
      if (field->adjointField)
        field->adjointField->ofPrimal = false;
      forgetPartnerNames(*field);
      fieldsByName.erase(field->name());
      return true;
    };
    fieldList.erase(std::remove_if(fieldList.begin(), fieldList.end(), isGone),
                    fieldList.end());
  }
  for (const FieldPtr &field : fieldList) {
    bool losesAdjoint =
        field->adjointField && &field->adjointField->tree() == tree;
    bool losesDual = field->dualField && &field->dualField->tree() == tree;
    if (!losesAdjoint && !losesDual)
      continue;
    // A later field with the name of a destroyed partner is not that partner.
    forgetPartnerNames(*field);
    if (losesAdjoint) {
      field->adjointField.reset();
      field->adjointName.clear();
    }
    if (losesDual) {
      field->dualField.reset();
      field->dualName.clear();
    }
    notePartnerNames(*field);
  }
  freeTree(*tree);
  treesByName.erase(found);
  state.storageChanged();
  return Status::success();
}

TreePtr TreeStore::findTree(const std::string &name) const {
  auto found = treesByName.find(name);
  return found == treesByName.end() ? nullptr : found->second;
}

//===----------------------------------------------------------------------===//
// Fields
//===----------------------------------------------------------------------===//

static Status badField(const std::string &name, const std::string &why) {
  return Status::failure(StatusCode::Usage, "field '" + name + "' " + why);
}

Status TreeStore::addField(FieldInfo info, FieldPtr &result) {
  if (fieldsByName.count(info.name))
    return badField(info.name, "exists already");
  if (!info.tree || !info.tree->base())
    return badField(info.name, "has no tree");
  auto field = std::make_shared<Field>();
  FieldLayout &layout = field->fieldLayout;
  layout = std::move(info.layout);
  int64_t scalar = byteSize(layout.scalar);
  if (layout.componentStride == 0)
    layout.componentStride = scalar;
  for (int64_t extent : layout.elementShape) {
    if (extent < 1)
      return badField(info.name, "has elements without components");
    field->components *= extent;
  }
  // The layout comes from the compiler. It is checked here once, so that host
  // accesses cannot leave the tree.
  int64_t last = layout.placeOffset;
  bool inside = layout.placeOffset >= 0 && layout.componentStride >= scalar;
  for (const std::vector<LayoutLevel> &levels : layout.indices) {
    int64_t extent = 1;
    for (const LayoutLevel &level : levels) {
      if (level.extent < 1 || level.divisor < 1 || level.stride < 0)
        return badField(info.name, "has a level without extent");
      if (__builtin_mul_overflow(extent, level.extent, &extent))
        return badField(info.name, "has more elements than can be counted");
      int64_t span;
      inside &=
          !__builtin_mul_overflow(level.extent - 1, level.stride, &span) &&
          !__builtin_add_overflow(last, span, &last);
    }
    field->shapeOf.push_back(extent);
    if (__builtin_mul_overflow(field->elements, extent, &field->elements))
      return badField(info.name, "has more elements than can be counted");
  }
  if (!layout.offset.empty() && layout.offset.size() != layout.indices.size())
    return badField(info.name, "has offsets for another number of indices");
  int64_t elementBytes =
      (field->components - 1) * layout.componentStride + scalar;
  if (!inside || last + elementBytes > info.tree->bytes())
    return badField(info.name,
                    "does not fit into tree '" + info.tree->name() + "' of " +
                        std::to_string(info.tree->bytes()) + " bytes");
  if (layout.componentStride == scalar)
    field->elementStep =
        findEvenStep(layout, field->shapeOf, field->components * scalar);
  field->isContiguous = field->elementStep == field->components * scalar;
  field->fieldName = info.name;
  field->owner = std::move(info.tree);
  field->adjointName = std::move(info.adjoint);
  field->dualName = std::move(info.dual);
  Status status = checkPartners(*field);
  if (!status)
    return status;
  fieldsByName.emplace(info.name, field);
  {
    std::lock_guard<std::mutex> lock(fieldsMutex);
    fieldList.push_back(field);
  }
  notePartnerNames(*field);
  linkPartners(field);
  result = field;
  return Status::success();
}

static bool sameElements(const Field &a, const Field &b) {
  return a.elementShape() == b.elementShape() && a.shape() == b.shape() &&
         isFloat(a.scalar()) == isFloat(b.scalar());
}

/// Adjoints and tangents never make cells active: if they lie below a sparse
/// level, their primals activate the cells.
static bool sharesActivity(const Field &primal, const Field &partner) {
  return !partner.sparseNode() ||
         (partner.sparseNode() == primal.sparseNode() &&
          primal.layout().offset == partner.layout().offset);
}

Status TreeStore::checkPartners(const Field &added) const {
  auto check = [&](const Field &primal, const Field &partner) {
    if (!sharesActivity(primal, partner))
      return badField(primal.name(),
                      "and its adjoint or tangent '" + partner.name() +
                          "' must lie below the same sparse level, with the "
                          "same offsets: they share what is active; place both "
                          "there");
    if (sameElements(primal, partner))
      return Status::success();
    return badField(primal.name(), "and its adjoint or tangent '" +
                                       partner.name() +
                                       "' differ in shape or element type");
  };
  Status status;
  for (const std::string &name : {added.adjointName, added.dualName})
    if (FieldPtr other = findField(name); other && status)
      status = check(added, *other);
  auto [first, last] = primalsByPartner.equal_range(added.name());
  for (auto at = first; at != last && status; ++at)
    status = check(*at->second, added);
  return status;
}

void TreeStore::notePartnerNames(Field &field) {
  for (const std::string &name : {field.adjointName, field.dualName})
    if (!name.empty())
      primalsByPartner.emplace(name, &field);
}

void TreeStore::forgetPartnerNames(const Field &field) {
  for (const std::string &name : {field.adjointName, field.dualName}) {
    auto [at, last] = primalsByPartner.equal_range(name);
    while (at != last)
      at = at->second == &field ? primalsByPartner.erase(at) : std::next(at);
  }
}

void TreeStore::linkPartners(const FieldPtr &added) {
  bool linked = false;
  auto link = [&](Field &primal, const FieldPtr &partner) {
    if (primal.adjointName == partner->name()) {
      primal.adjointField = partner;
      partner->ofPrimal = true;
      linked = true;
    }
    if (primal.dualName == partner->name())
      primal.dualField = partner;
  };
  for (const std::string &name : {added->adjointName, added->dualName})
    if (FieldPtr other = findField(name))
      link(*added, other);
  auto [first, last] = primalsByPartner.equal_range(added->name());
  for (auto at = first; at != last; ++at)
    link(*at->second, added);
  if (linked)
    state.storageChanged();
}

Status TreeStore::setAdjoint(Field &field, const FieldPtr &adjoint) {
  if (!sameElements(field, *adjoint) || !sharesActivity(field, *adjoint))
    return badField(field.name(),
                    "and its adjoint '" + adjoint->name() +
                        "' differ in shape, element type or sparse levels");
  if (field.adjointField)
    field.adjointField->ofPrimal = false;
  forgetPartnerNames(field);
  field.adjointName = adjoint->name();
  notePartnerNames(field);
  field.adjointField = adjoint;
  adjoint->ofPrimal = true;
  state.storageChanged();
  return Status::success();
}

FieldPtr TreeStore::findField(const std::string &name) const {
  auto found = fieldsByName.find(name);
  return found == fieldsByName.end() ? nullptr : found->second;
}

bool TreeStore::isPartner(const Field &field) const {
  auto [first, last] = primalsByPartner.equal_range(field.name());
  return field.isAdjoint() || std::any_of(first, last, [&](const auto &entry) {
           const Field &other = *entry.second;
           return other.dual() == &field || other.adjoint() == &field;
         });
}

std::string TreeStore::describe(const Field &field) const {
  std::lock_guard<std::mutex> lock(fieldsMutex);
  if (field.isAdjoint())
    for (const FieldPtr &primal : fieldList)
      if (primal->adjoint() == &field)
        return "the gradient of field '" + primal->name() + "'";
  return "field '" + field.name() + "'";
}

FieldPtr TreeStore::firstOf(const Tree &tree) const {
  std::lock_guard<std::mutex> lock(fieldsMutex);
  auto found = std::find_if(
      fieldList.begin(), fieldList.end(),
      [&](const FieldPtr &field) { return &field->tree() == &tree; });
  return found == fieldList.end() ? nullptr : *found;
}
