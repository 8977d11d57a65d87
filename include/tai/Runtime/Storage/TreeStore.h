//===- TreeStore.h - The trees and fields of a runtime ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Names, adjoint and dual fields, and memory. Handles remain safe to use after
// a tree is destroyed; operations then fail.
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
  /// Names of the adjoint and the dual, which need not exist yet; empty for
  /// none.
  std::string adjoint, dual;
};

/// The interface that gives trees memory on a device.
class TreeMirrors {
public:
  virtual ~TreeMirrors() = default;
  /// Fails if a sparse tree cannot be on the device.
  virtual Status check(const std::string &name, int64_t bytes,
                       const std::vector<SparseInfo> &levels) const = 0;
  /// Null if there is no device.
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

  /// `sparse` describes the sparse levels, parents before children.
  Status addTree(std::string name, int64_t bytes, TreePtr &tree,
                 std::vector<SparseInfo> sparse = {});
  /// With `isClosing`, new launches cannot use the tree; otherwise they can
  /// again.
  void setClosing(Tree &tree, bool isClosing);
  /// Frees the storage and removes the fields.
  Status destroyTree(const std::string &name);
  TreePtr findTree(const std::string &name) const;
  const std::unordered_map<std::string, TreePtr> &trees() const {
    return treesByName;
  }
  /// Some field of the tree, used to hold the activity of its cells; null if
  /// there is none. Thread-safe.
  FieldPtr firstOf(const Tree &tree) const;

  Status addField(FieldInfo info, FieldPtr &field);
  /// Replaces the adjoint of a field.
  Status setAdjoint(Field &field, const FieldPtr &adjoint);
  FieldPtr findField(const std::string &name) const;
  const std::vector<FieldPtr> &fields() const { return fieldList; }
  /// "field 'x'", or a description as a gradient, for messages. Thread-safe.
  std::string describe(const Field &field) const;
  /// True for adjoints and tangents of other fields.
  bool isPartner(const Field &field) const;

  /// Adds the memory allocated for trees and gradients, and the part in use.
  void countMemory(SkipAmounts &amounts) const;

private:
  void freeTree(Tree &tree);
  Status checkPartners(const Field &added) const;
  void linkPartners(const FieldPtr &added);
  /// Enters a field under the names of its adjoint and tangent, or removes it.
  void notePartnerNames(Field &field);
  void forgetPartnerNames(const Field &field);

  MemoryAccount &memory;
  LaunchState &state;
  const ListMaker lists;
  TreeMirrors *mirrors = nullptr;
  uint64_t treesMade = 0;
  std::unordered_map<std::string, TreePtr> treesByName;
  std::unordered_map<std::string, FieldPtr> fieldsByName;
  /// The fields that name another field as their adjoint or tangent, by that
  /// name: the named field may be added later.
  std::unordered_multimap<std::string, Field *> primalsByPartner;
  std::vector<FieldPtr> fieldList;
  /// Guards changes of the list, and reads that may be concurrent with them.
  mutable std::mutex fieldsMutex;
};

/// Bytes of the active elements of a field.
int64_t bytesInUse(const Field &field);

/// The skips and their counters, as a text table.
std::string skipTable(SkipSet skips, const SkipAmounts &amounts);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_TREESTORE_H
