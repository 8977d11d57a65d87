//===- LiveSlabs.cpp - Adjoints that may be non-zero ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LiveSlabs.h"
#include "Overwrites.h"
#include <algorithm>

using namespace mlir::tai::runtime;

LiveSlabs::LiveSlabs(const TapeRecording &recording) : recording(recording) {
  for (const KernelPtr &kernel : recording.kernels())
    collect(*kernel, kernelUses[kernel.get()]);
}

size_t LiveSlabs::numberOf(const Field &field) {
  auto [entry, isNew] = numbers.try_emplace(&field, sets.size());
  if (isNew)
    sets.emplace_back(field);
  return entry->second;
}

/// A kernel with more accesses to a field, for example to the columns of a
/// matrix of weights, counts as accessing all elements of the field.
static constexpr size_t mostPlaces = 16;

bool LiveSlabs::hasManyPlaces(const Kernel &kernel, const Field &field) {
  const std::vector<Access> &all = kernel.summary();
  return std::count_if(all.begin(), all.end(), [&](const Access &access) {
           return access.field.get() == &field;
         }) > static_cast<ptrdiff_t>(mostPlaces);
}

void LiveSlabs::collect(const Kernel &kernel, KernelUses &uses) {
  static const std::vector<FixedIndex> nowhere;
  std::unordered_map<const Field *, size_t> places;
  for (const Access &access : kernel.summary())
    ++places[access.field.get()];
  auto add = [](std::vector<Use> &list, const Use &use) {
    if (std::none_of(list.begin(), list.end(), [&](const Use &known) {
          return known.set == use.set && *known.fixed == *use.fixed;
        }))
      list.push_back(use);
  };
  for (const Access &access : kernel.summary()) {
    if (!access.field->adjoint())
      continue;
    // A hand-written adjoint can access elements that the kernel's summary does
    // not list.
    bool isKnown =
        kernel.adjoint().canZero() && places[access.field.get()] <= mostPlaces;
    size_t set = numberOf(*access.field);
    const std::vector<FixedIndex> &fixed = isKnown ? access.fixed : nowhere;
    Use use{set, sets[set].addShape(fixed), &fixed};
    add(access.kind == AccessKind::Read ? uses.read : uses.written, use);
    if (access.kind != AccessKind::Write)
      continue;
    add(uses.overwritten, use);
    if (isKnown && storesSlab(access))
      add(uses.ended, use);
  }
}

void LiveSlabs::add(const Field &field) {
  SlabSet &set = sets[numberOf(field)];
  set.add(set.whole());
}

void LiveSlabs::remove(const Field &field) {
  SlabSet &set = sets[numberOf(field)];
  set.remove(set.whole());
}

bool LiveSlabs::has(const Field &field) const {
  auto found = numbers.find(&field);
  return isAll || (found != numbers.end() &&
                   sets[found->second].meets(sets[found->second].whole()));
}

bool LiveSlabs::meets(const std::vector<Use> &uses,
                      const uint64_t *args) const {
  return std::any_of(uses.begin(), uses.end(), [&](const Use &use) {
    return isAll || sets[use.set].meets(locate(use, args));
  });
}

bool LiveSlabs::isWritten(const TapeRecording::Record &record) const {
  return meets(kernelUses.at(record.kernel).written, recording.args(record));
}

bool LiveSlabs::isOverwritten(const TapeRecording::Record &record) const {
  return meets(kernelUses.at(record.kernel).overwritten,
               recording.args(record));
}

void LiveSlabs::pass(const TapeRecording::Record &record, bool zeroes) {
  if (isAll)
    return;
  const KernelUses &uses = kernelUses.at(record.kernel);
  const uint64_t *args = recording.args(record);
  if (zeroes)
    end(uses, args);
  add(uses.read, args);
}

bool LiveSlabs::isRead(const TapeRecording::Record &record) const {
  return meets(kernelUses.at(record.kernel).read, recording.args(record));
}

void LiveSlabs::passForward(const TapeRecording::Record &record, bool isRead) {
  if (isAll)
    return;
  const KernelUses &uses = kernelUses.at(record.kernel);
  const uint64_t *args = recording.args(record);
  end(uses, args);
  if (isRead)
    add(uses.written, args);
}

void LiveSlabs::add(const std::vector<Use> &uses, const uint64_t *args) {
  for (const Use &use : uses)
    sets[use.set].add(locate(use, args));
}

void LiveSlabs::end(const KernelUses &uses, const uint64_t *args) {
  for (const Use &use : uses.ended) {
    SlabSet::Slab slab = locate(use, args);
    // If an index is out of range, locate() returns the whole field, so nothing
    // is removed.
    if (!slab.isWhole() || use.fixed->empty())
      sets[use.set].remove(slab);
  }
}
