//===- Overwrites.cpp - Overwritten elements ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Overwrites.h"
#include "../TapeServices.h"
#include <algorithm>
#include <unordered_map>

using namespace mlir::tai::runtime;

namespace {
/// The elements of a field that the records so far have used, as positions
/// along the first dimension that an access fixes.
struct Used {
  const Field *field;
  int64_t dimension = -1;
  std::vector<char> positions;
  bool anywhere = false;
  bool any = false;
  /// Elements whose first access is a store by a record: elements of whole
  /// slabs (parts of a field with fixed leading indices), or boxes of elements.
  std::vector<char> stored;
  OwedZeros boxes;

  /// Returns the index of an access along the dimension, or null if the index
  /// is not fixed in a launch.
  const FixedIndex *find(const Access &access) const {
    for (const FixedIndex &fixed : access.fixed)
      if (fixed.dimension == dimension)
        return &fixed;
    return nullptr;
  }
  /// Returns the position of an access along the dimension, or -1 if the index
  /// is not fixed or out of range.
  int64_t locate(const Access &access, const uint64_t *args) const {
    const FixedIndex *fixed = find(access);
    if (!fixed)
      return -1;
    int64_t position =
        fixed->evaluate(args) - access.field->firstIndex(dimension);
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
  /// Notes elements that an access stores, to be zeroed after the sweep.
  void owe(const Access &access, bool isSlab, int64_t position,
           const uint64_t *args) {
    if (isSlab && position >= 0) {
      if (stored.empty())
        stored.resize(positions.size());
      stored[position] = true;
      return;
    }
    OwedZeros::Box elements;
    for (const StoredBox &box : *access.boxes)
      if (findElements(box, *access.field, args, elements))
        boxes.add(elements, dimension);
  }
  std::shared_ptr<const OwedZeros> take(const Field &field);
};

std::shared_ptr<const OwedZeros> Used::take(const Field &field) {
  for (size_t at = 0; at < stored.size(); ++at) {
    if (!stored[at])
      continue;
    OwedZeros::Box slab;
    slab.lower.resize(field.shape().size());
    slab.upper = field.shape();
    slab.lower[dimension] = static_cast<int64_t>(at);
    while (at + 1 < stored.size() && stored[at + 1])
      ++at;
    slab.upper[dimension] = static_cast<int64_t>(at + 1);
    boxes.boxes.push_back(std::move(slab));
  }
  return boxes.boxes.empty() ? nullptr
                             : std::make_shared<OwedZeros>(std::move(boxes));
}

/// Facts about a kernel that its first launch finds for its later launches.
struct Repeated {
  enum class Effect {
    /// The access stores nothing.
    None,
    StoresElements,
    /// Each launch of the kernel stores all elements of the field at the fixed
    /// index of the access.
    StoresSlab
  };
  struct Use {
    size_t used;
    const Access *access;
    Effect effect;
    /// True if the accessed elements depend on launch arguments.
    bool varies;

    bool stores() const { return effect != Effect::None; }
  };
  /// The kernel's accesses whose elements depend on launch arguments; during
  /// the first launch, all its accesses.
  std::vector<Use> uses;
  /// True if later launches of the kernel store elements that its first launch
  /// has stored.
  bool storesAgain = false;
};
} // namespace

bool mlir::tai::runtime::storesSlab(const Access &access) {
  if (!access.boxes || access.boxes->size() != 1)
    return false;
  const StoredBox &box = access.boxes->front();
  if (!box.loops.empty())
    return false;
  auto next = access.fixed.begin();
  for (size_t d = 0; d < box.ranges.size(); ++d) {
    auto dimension = static_cast<int64_t>(d);
    if (next != access.fixed.end() && next->dimension == dimension) {
      ++next;
      continue;
    }
    const auto &[lower, upper] = box.ranges[d];
    int64_t first = access.field->firstIndex(dimension);
    if (!lower.terms.empty() || !upper.terms.empty() ||
        lower.constant > first ||
        upper.constant < first + access.field->shape()[d])
      return false;
  }
  return true;
}

Overwrites mlir::tai::runtime::findOverwrites(const TapeRecording &recording) {
  Overwrites result;
  result.isRepeated.assign(recording.size(), false);
  std::vector<Used> used;
  std::unordered_map<const Field *, size_t> numbers;
  auto lookup = [&](const Access &access) -> size_t {
    const Field &field = *access.field;
    auto [number, isNew] = numbers.try_emplace(&field, used.size());
    if (isNew) {
      Used entry;
      entry.field = &field;
      if (!access.fixed.empty()) {
        entry.dimension = access.fixed.front().dimension;
        entry.positions.resize(field.shape()[entry.dimension]);
      }
      used.push_back(std::move(entry));
    }
    return number->second;
  };
  std::unordered_map<const Kernel *, Repeated> known;
  std::vector<int64_t> positions;
  // The reverse of a host function can add to any gradient.
  bool isUnknown = false;
  for (size_t i = 0; i < recording.size(); ++i) {
    const TapeRecording::Record &record = recording[i];
    const Kernel *kernel = record.kernel;
    if (!kernel) {
      isUnknown |= record.kind == TapeRecording::Kind::Callback &&
                   static_cast<bool>(recording.callback(record).backward);
      continue;
    }
    const uint64_t *args = recording.args(record);
    positions.clear();
    bool again = kernel->adjoint().alwaysZeroes();
    // A hand-written adjoint possibly has no zeroing variant.
    bool canZero = kernel->adjoint().canZero();
    auto look = [&](const Repeated::Use &use) {
      Used &entry = used[use.used];
      int64_t position = entry.locate(*use.access, args);
      bool isOwed = use.access->boxes && !isUnknown;
      again |= use.stores() && ((canZero && !isOwed) || entry.has(position));
      positions.push_back(position);
    };
    auto [entry, isFirst] = known.try_emplace(kernel);
    Repeated &repeated = entry->second;
    if (isFirst) {
      for (const Access &access : kernel->summary()) {
        if (!access.field->adjoint())
          continue;
        auto effect = Repeated::Effect::None;
        if (access.kind == AccessKind::Write)
          effect = access.fixed.size() == 1 && storesSlab(access)
                       ? Repeated::Effect::StoresSlab
                       : Repeated::Effect::StoresElements;
        size_t index = lookup(access);
        const FixedIndex *fixed = used[index].find(access);
        bool varies = fixed && !fixed->terms.empty();
        // Accesses that differ only in the indices of other dimensions have the
        // same effect.
        auto isAlike = [&](const Repeated::Use &use) {
          const FixedIndex *other = used[index].find(*use.access);
          return use.used == index && !use.stores() &&
                 (fixed ? other && *other == *fixed : !other);
        };
        if (effect == Repeated::Effect::None &&
            std::any_of(repeated.uses.begin(), repeated.uses.end(), isAlike))
          continue;
        repeated.uses.push_back({index, &access, effect, varies});
      }
    }
    again |= repeated.storesAgain;
    for (const Repeated::Use &use : repeated.uses)
      look(use);
    result.isRepeated[i] = again;
    for (size_t k = 0; k < positions.size(); ++k) {
      const Repeated::Use &use = repeated.uses[k];
      Used &entry = used[use.used];
      if (use.stores() && use.access->boxes && !again)
        entry.owe(*use.access, use.effect == Repeated::Effect::StoresSlab,
                  positions[k], args);
      entry.add(positions[k]);
    }
    if (isFirst) {
      auto isDone = [&](const Repeated::Use &use) {
        repeated.storesAgain |= use.stores() && !use.varies;
        return !use.varies;
      };
      repeated.uses.erase(
          std::remove_if(repeated.uses.begin(), repeated.uses.end(), isDone),
          repeated.uses.end());
    }
  }
  for (Used &entry : used)
    if (std::shared_ptr<const OwedZeros> zeros = entry.take(*entry.field))
      result.storedOnce.emplace_back(entry.field->sharedAdjoint(),
                                     std::move(zeros));
  return result;
}
