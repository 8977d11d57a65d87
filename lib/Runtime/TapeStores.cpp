//===- TapeStores.cpp - Elements that are stored again --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Which launches store elements that an earlier one has used, as far as
// summaries tell. A kernel may have hundreds of accesses at constant indices
// (the columns of a matrix of weights), which are the same in all its launches:
// they are looked at once.
//
//===----------------------------------------------------------------------===//

#include "HostWrite.h"
#include "tai/Runtime/Runtime.h"
#include "tai/Runtime/Tape.h"

using namespace mlir::tai::runtime;

namespace {
/// The elements of a field that the records so far have used: positions along
/// the first dimension in which a launch fixes its index.
struct Used {
  int64_t dimension;
  std::vector<char> positions;
  bool anywhere = false;
  bool any = false;

  /// The position of an access, or -1 if it is not known.
  int64_t locate(const Access &access, const uint64_t *args) const {
    if (!access.fixed || access.fixed->dimension != dimension)
      return -1;
    int64_t position =
        access.fixed->evaluate(args) - access.field->firstIndex(dimension);
    bool inRange = position >= 0 && position < int64_t(positions.size());
    return inRange ? position : -1;
  }
  bool has(int64_t position) const {
    return anywhere || (position < 0 ? any : positions[position] != 0);
  }
  void add(int64_t position) {
    any = true;
    if (position < 0)
      anywhere = true;
    else
      positions[position] = true;
  }
};

/// What launches of a kernel but the first need to look at.
struct Repeated {
  struct Use {
    size_t used;
    const Access *access;
    bool stores;
  };
  /// The accesses whose places depend on arguments.
  std::vector<Use> uses;
  /// It stores elements that its first launch has stored.
  bool storesAgain = false;
};
} // namespace

void Tape::findRepeatedStores() {
  storesAgain.assign(records.size(), false);
  uint64_t mark = ++runtime.stamps;
  std::vector<Used> used;
  auto lookup = [&](const Access &access) -> size_t {
    Field &field = *access.field;
    if (field.seenMark != mark) {
      field.seenMark = mark;
      field.seenIndex = used.size();
      Used entry;
      entry.dimension = access.fixed ? access.fixed->dimension : -1;
      if (access.fixed)
        entry.positions.resize(field.shape()[entry.dimension]);
      used.push_back(std::move(entry));
    }
    return field.seenIndex;
  };
  std::unordered_map<const Kernel *, Repeated> known;
  std::vector<std::pair<size_t, int64_t>> uses;
  for (size_t i = 0; i < records.size(); ++i) {
    const Kernel *kernel = records[i].kernel;
    if (!kernel)
      continue;
    const uint64_t *args = slots.data() + records[i].payload;
    uses.clear();
    bool again = kernel->alwaysTakes;
    auto look = [&](size_t index, const Access &access, bool stores) {
      int64_t position = used[index].locate(access, args);
      again |= stores && (takesAll || used[index].has(position));
      uses.emplace_back(index, position);
    };
    auto [entry, isFirst] = known.try_emplace(kernel);
    Repeated &repeated = entry->second;
    if (isFirst) {
      for (const Access &access : kernel->summary()) {
        if (!access.field->adjoint())
          continue;
        size_t index = lookup(access);
        bool stores = access.kind == AccessKind::Write;
        look(index, access, stores);
        bool varies = access.fixed && !access.fixed->terms.empty() &&
                      access.fixed->dimension == used[index].dimension;
        if (varies)
          repeated.uses.push_back({index, &access, stores});
        else
          repeated.storesAgain |= stores;
      }
    } else {
      again |= repeated.storesAgain;
      for (const Repeated::Use &use : repeated.uses)
        look(use.used, *use.access, use.stores);
    }
    storesAgain[i] = again;
    for (auto [index, position] : uses)
      used[index].add(position);
  }
}
