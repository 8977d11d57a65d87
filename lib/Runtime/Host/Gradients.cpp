//===- Gradients.cpp - Clearing of gradients ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Host/Gradients.h"
#include "tai/Runtime/Mirror/OwedZeros.h"
#include "tai/Runtime/Threads/Section.h"
#include <algorithm>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Owed zeros
//===----------------------------------------------------------------------===//

void Gradients::update() {
  owesAny.store(!owing.empty(), std::memory_order_release);
}

void Gradients::owe(const FieldPtr &adjoint,
                    std::shared_ptr<const OwedZeros> zeros) {
  if (!adjoint->valid() || !adjoint->dirty())
    return;
  adjoint->settleZeros();
  // In forward mode, zeros are stored now in the adjoint and its tangent. They
  // are stored now in exported memory, too, because other libraries may read it
  // at any time.
  bool forward = recordings.isForward();
  Field *dual = forward ? adjoint->dual() : nullptr;
  if (dual && dual->valid())
    zeros->store(*dual);
  if (forward || adjoint->tree().isExported()) {
    zeros->store(*adjoint);
    return;
  }
  std::lock_guard<std::mutex> lock(mutex);
  adjoint->oweZeros(std::move(zeros));
  owing.push_back(adjoint);
  update();
}

void Gradients::forgetSettled() {
  std::lock_guard<std::mutex> lock(mutex);
  owing.erase(
      std::remove_if(owing.begin(), owing.end(),
                     [](const FieldPtr &field) { return !field->owesZeros(); }),
      owing.end());
  update();
}

void Gradients::settle(const Uses &uses) {
  settleIf([&](const FieldPtr &field) {
    return !field->isDirtiedByOther() || (uses && uses(field));
  });
}

void Gradients::settleForSweep(const Uses &uses) {
  settleIf([&](const FieldPtr &field) {
    return !isWaiting(*field) && (!field->isDirtiedByOther() || uses(field));
  });
}

void Gradients::settleIf(const Uses &selected) {
  if (!areOwed())
    return;
  std::vector<FieldPtr> settled;
  {
    std::lock_guard<std::mutex> lock(mutex);
    for (const FieldPtr &field : owing)
      if (selected(field))
        settled.push_back(field);
  }
  for (const FieldPtr &field : settled)
    field->settleZeros();
  forgetSettled();
}

void Gradients::forget(const Tree &tree) {
  std::lock_guard<std::mutex> lock(mutex);
  owing.erase(std::remove_if(owing.begin(), owing.end(),
                             [&](const FieldPtr &field) {
                               return &field->tree() == &tree;
                             }),
              owing.end());
  update();
}

//===----------------------------------------------------------------------===//
// Clearing
//===----------------------------------------------------------------------===//

/// True if the fields share cells in which the element of the second field
/// directly follows the element of the first.
static bool endsBeside(const Field &first, const Field &second) {
  int64_t bytes = first.numComponents() * byteSize(first.scalar());
  return &first.tree() == &second.tree() &&
         first.layout().placeOffset + bytes == second.layout().placeOffset &&
         first.shape() == second.shape();
}

void Gradients::clearTangents() {
  for (const FieldPtr &field : store.fields()) {
    Field *tangent = field->dual();
    if (!tangent || !tangent->valid() || tangent->isDirtiedByOther())
      continue;
    copies.clear(*tangent);
    tangent->markClean();
  }
}

bool Gradients::clearLater(const FieldPtr &field, const Recorder *tape) {
  if (!tape || !field->isStoredFirst() || !skips.has(Skip::UnreadZeros) ||
      recordings.isForward() || field->tree().mirror() ||
      field->tree().wasLent() || field->isDirtiedByOther())
    return false;
  auto zeros = std::make_shared<OwedZeros>();
  zeros->boxes.push_back(
      {std::vector<int64_t>(field->shape().size()), field->shape()});
  field->oweZeros(std::move(zeros));
  field->markClean();
  std::lock_guard<std::mutex> lock(mutex);
  if (std::find(owing.begin(), owing.end(), field) == owing.end())
    owing.push_back(field);
  update();
  return true;
}

Status Gradients::clear(const Recorder *tape) {
  constexpr auto canStop = FieldCopies::Interrupts::Stop;
  bool forward = recordings.isForward();
  const Field *cleared = nullptr;
  for (const FieldPtr &field : store.fields()) {
    // Call dirtiedBy() only once: another thread may be about to write to a
    // field that is still zero.
    uint64_t writer = field->dirtiedBy();
    if (tape && field->isAdjoint() && writer != 0 && writer != threadNumber() &&
        !tape->uses(field))
      continue;
    if (forward && field->isAdjoint() && field->dual() &&
        !copies.clear(*field->dual(), canStop))
      return failAsInterrupted();
    if (!field->isAdjoint())
      continue;
    int64_t bytes = bytesInUse(*field);
    // On a device, a fill with gaps takes longer than a contiguous fill: a
    // field that is zero already is cleared together with the field in front of
    // it.
    bool isAlong =
        cleared && cleared->tree().mirror() && endsBeside(*cleared, *field);
    bool isDirty = writer != 0 || field->tree().isExported();
    if (!isDirty && skips.has(Skip::CleanGradients) && !isAlong) {
      counters.bump(SkipCount::FieldsNotCleared);
      counters.bump(SkipCount::BytesNotCleared, bytes);
      continue;
    }
    if (isDirty && clearLater(field, tape))
      continue;
    if (!copies.clear(*field, canStop))
      return failAsInterrupted();
    cleared = field.get();
    field->markClean();
    counters.bump(SkipCount::FieldsCleared);
    counters.bump(SkipCount::BytesCleared, bytes);
  }
  if (areOwed())
    forgetSettled();
  return Status::success();
}
