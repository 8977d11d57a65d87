//===- TreeStore.h - The trees and fields of a runtime ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Owns the trees and fields of a runtime: names, adjoint and dual fields, and
// memory. Handles remain safe to use after a tree is destroyed; operations then
// fail.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_TREESTORE_H
#define TAI_RUNTIME_STORAGE_TREESTORE_H

#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Storage/LaunchState.h"
#include "tai/Runtime/Storage/MemoryAccount.h"
#include "tai/Support/Skips.h"
#include <unordered_map>

namespace mlir::tai::runtime {

struct FieldInfo {
  std::string name;
  TreePtr tree;
  FieldLayout layout;
  /// Names of the field's adjoint field and of its dual (tangent) field, which
  /// need not exist yet; empty for none.
  std::string adjoint, dual;
};

/// The interface that gives trees memory on a device.
class TreeMirrors {
public:
  virtual ~TreeMirrors() = default;
  /// Fails if the device cannot hold a sparse tree with these levels.
  virtual Status check(const std::string &name, int64_t bytes,
                       const std::vector<SparseInfo> &levels) const = 0;
  /// Makes the memory of a tree on the device; null if there is no device.
  virtual std::shared_ptr<Mirror> make(Tree &tree, SparseOnDevice *&levels) = 0;
};

class TreeStore {
public:
  TreeStore(MemoryAccount &memory, LaunchState &state, const ListMaker &lists)
      : memory(memory), state(state), lists(lists) {}
  ~TreeStore();
  TreeStore(const TreeStore &) = delete;
  TreeStore &operator=(const TreeStore &) = delete;

  void setMirrors(TreeMirrors *made) { mirrors = made; }

  /// Adds a tree of `bytes` bytes. `sparse` describes its sparse levels,
  /// parents before children.
  Status addTree(std::string name, int64_t bytes, TreePtr &tree,
                 std::vector<SparseInfo> sparse = {});
  /// With `isClosing`, new launches can no longer use the tree; without it,
  /// they can again.
  void setClosing(Tree &tree, bool isClosing);
  /// Frees the memory of the tree of this name, and removes its fields.
  Status destroyTree(const std::string &name);
  TreePtr findTree(const std::string &name) const;
  const std::unordered_map<std::string, TreePtr> &trees() const {
    return treesByName;
  }
  /// One field of the tree, always the same: a tape that uses the activity of
  /// the tree's cells holds this field. Null if the tree has no field.
  /// Thread-safe.
  FieldPtr firstOf(const Tree &tree) const;

  Status addField(FieldInfo info, FieldPtr &field);
  /// Sets or replaces the adjoint field of a field.
  Status setAdjoint(Field &field, const FieldPtr &adjoint);
  FieldPtr findField(const std::string &name) const;
  const std::vector<FieldPtr> &fields() const { return fieldList; }
  /// Describes a field for messages: "field 'x'", or, for a gradient, a
  /// description by the field that it belongs to. Thread-safe.
  std::string describe(const Field &field) const;
  /// True if the field is the adjoint or tangent of another field.
  bool isPartner(const Field &field) const;

  /// Adds the memory allocated for trees and gradients, and the part in use.
  void countMemory(SkipAmounts &amounts) const;

private:
  void freeTree(Tree &tree);
  Status checkPartners(const Field &added) const;
  void linkPartners(const FieldPtr &added);
  /// Enter a field in, or remove it from, `primalsByPartner` under the names of
  /// its adjoint and tangent.
  void notePartnerNames(Field &field);
  void forgetPartnerNames(const Field &field);

  MemoryAccount &memory;
  LaunchState &state;
  const ListMaker lists;
  TreeMirrors *mirrors = nullptr;
  uint64_t treesMade = 0;
  std::unordered_map<std::string, TreePtr> treesByName;
  std::unordered_map<std::string, FieldPtr> fieldsByName;
  /// Fields by the names of their adjoints and tangents. An entry is made when
  /// the field is added, since its adjoint or tangent is possibly added later.
  std::unordered_multimap<std::string, Field *> primalsByPartner;
  std::vector<FieldPtr> fieldList;
  /// Guards changes of `fieldList`, and reads of it that may run at the same
  /// time.
  mutable std::mutex fieldsMutex;
};

/// The bytes of the active elements of a field.
int64_t bytesInUse(const Field &field);

/// The skips and their counters, as a text table.
std::string skipTable(SkipSet skips, const SkipAmounts &amounts);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_TREESTORE_H
