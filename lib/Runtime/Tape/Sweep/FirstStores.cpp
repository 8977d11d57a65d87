//===- FirstStores.cpp - Adjoints that a sweep need not clear -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "FirstStores.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include <algorithm>

using namespace mlir::tai;
using namespace mlir::tai::runtime;
using Decision = TapePlan::Decision;

namespace {
/// Adjoint fields, in the order in which they were added.
class AdjointSet {
public:
  bool has(const Field *field) const {
    return std::find(fields.begin(), fields.end(), field) != fields.end();
  }
  void add(const Field *field) {
    if (field && !has(field))
      fields.push_back(field);
  }
  /// Adds the adjoint fields that the adjoint of a kernel may access.
  void addUses(const Kernel &kernel, const Kernel *adjoint);

private:
  std::vector<const Field *> fields;
};
} // namespace

void AdjointSet::addUses(const Kernel &kernel, const Kernel *adjoint) {
  const KernelTables &tables = kernel.tables();
  for (const std::vector<Field *> *of :
       {&tables.adjointTargets, &tables.adjointSources, &tables.overwritten})
    for (const Field *field : *of)
      add(field->adjoint());
  // A kernel may also use gradients as its values.
  for (const Access &access : kernel.summary())
    if (access.field->isAdjoint())
      add(access.field.get());
  if (adjoint)
    for (const Field *field : adjoint->tables().changedAdjoints)
      add(field);
}

/// True if the memory of the field may hold old numbers at the beginning of a
/// sweep of this thread, whose first launch stores it.
bool FirstStores::mayStore(const Field &adjoint) const {
  return adjoint.dirtiedBy() == 0 && !adjoint.sparseNode() &&
         !adjoint.tree().wasLent() && !adjoint.tree().mirror() &&
         adjoint.holds.holder.load(std::memory_order_acquire) == threadNumber();
}

void FirstStores::choose() {
  AdjointSet used;
  std::vector<const Kernel *> known;
  for (uint32_t index : plan.replayed()) {
    const TapeRecording::Record &record = recording[index];
    if (record.kind == TapeRecording::Kind::Write) {
      used.add(recording.write(record).field->adjoint());
      continue;
    }
    // Later launches of a kernel use no other fields than its first one.
    const Kernel *kernel = record.kernel;
    if (std::find(known.begin(), known.end(), kernel) != known.end())
      continue;
    known.push_back(kernel);
    // An adjoint that was written by hand may use any field.
    Kernel *adjoint = nullptr;
    if (!kernel->adjoint().canZero() ||
        (plan[index] == Decision::Replay && !forms.find(index, adjoint)))
      return;
    const std::vector<std::string> &names =
        adjoint ? adjoint->storesFirst() : std::vector<std::string>();
    for (size_t number = 0; number < names.size(); ++number)
      for (const Field *field : kernel->tables().adjointTargets) {
        const FieldPtr &target = field->sharedAdjoint();
        if (target && target->name() == names[number] &&
            !used.has(target.get()) && mayStore(*target)) {
          stores.push_back({index, uint64_t(1) << number, target, false});
          break;
        }
      }
    used.addUses(*kernel, adjoint);
    if (known.size() == recording.kernels().size())
      return;
  }
}

void FirstStores::begin(bool mayChoose) {
  stores.clear();
  stored.clear();
  storedBytes = 0;
  if (mayChoose && services.skips(Skip::UnreadZeros))
    choose();
  for (const Store &store : stores)
    store.field->setStoredFirst(true);
  Gradients &gradients = services.owner().gradients();
  if (!gradients.areOwed())
    return;
  for (const FieldPtr &field : services.fields()) {
    if (!field->isAdjoint() || !Gradients::isWaiting(*field) ||
        std::any_of(stores.begin(), stores.end(),
                    [&](const Store &store) { return store.field == field; }))
      continue;
    field->settleZeros();
    field->setStoredFirst(false);
  }
  gradients.forgetSettled();
}

uint64_t FirstStores::take(uint32_t index) {
  uint64_t bits = 0;
  for (Store &store : stores) {
    if (store.index != index)
      continue;
    store.isLaunched = true;
    bits |= store.bit;
    if (!store.field->owesZeros())
      continue;
    store.field->oweZeros(nullptr);
    stored.push_back(store.field->name());
    storedBytes += store.field->hostBytes();
  }
  return bits;
}

void FirstStores::settle(uint32_t index) {
  for (const Store &store : stores)
    if (store.index == index && !store.isLaunched)
      store.field->settleZeros();
}

void FirstStores::end(bool hasFailed) {
  if (stores.empty())
    return;
  for (const Store &store : stores) {
    if (!store.isLaunched) {
      store.field->settleZeros();
    } else if (hasFailed && store.field->valid()) {
      const char zeros[8] = {};
      services.perform({HostWrite::What::Fill, store.field.get(), zeros});
    }
  }
  services.count(SkipCount::FieldsStoredFirst,
                 static_cast<int64_t>(stored.size()));
  services.count(SkipCount::BytesStoredFirst, storedBytes);
  services.owner().gradients().forgetSettled();
  stores.clear();
}
