//===- TapeStored.cpp - Adjoints that load what launches have stored ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An adjoint has a form that loads values which its kernel has stored, where
// that saves computing them once more. A launch is reversed by it if nothing
// that the tape has seen since has changed the slabs which it stored to: then
// the fields still hold them. Else the form runs that computes them from what
// the tape keeps for it anyway, so that no value is saved for the sake of this.
//
//===----------------------------------------------------------------------===//

#include "TapeMemory.h"
#include "tai/Runtime/Tape/Tape.h"
#include <algorithm>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// What stands where it was stored
//===----------------------------------------------------------------------===//

void Track::markStored(int64_t slab, uint32_t stamp, std::vector<bool> &lost) {
  // Of two records that store there, only the later one is looked after.
  loseStored(slab, lost, stamp);
  anyStored = true;
  if (slab < 0) {
    storedAnywhere = stamp;
    return;
  }
  if (storedAt.empty())
    storedAt.resize(static_cast<size_t>(slabs.count()));
  storedAt[slab] = stamp;
}

void Track::loseStored(int64_t slab, std::vector<bool> &lost, uint32_t keeps) {
  if (!anyStored)
    return;
  auto lose = [&](uint32_t &stamp) {
    if (stamp == 0 || stamp == keeps)
      return;
    if (lost.size() <= stamp)
      lost.resize(stamp + 1);
    lost[stamp] = true;
    stamp = 0;
  };
  lose(storedAnywhere);
  if (slab >= 0) {
    if (!storedAt.empty())
      lose(storedAt[slab]);
    return;
  }
  std::for_each(storedAt.begin(), storedAt.end(), lose);
  anyStored = keeps != 0;
}

bool TapeMemory::isStored(const Field &field) const {
  const Track *track = findTrack(field);
  return track && track->anyStored;
}

//===----------------------------------------------------------------------===//
// Which form runs
//===----------------------------------------------------------------------===//

bool Tape::readsStoredAt(size_t index) const {
  const Record &record = records[index];
  // A host function may do to fields what the tape does not see, now or when it
  // is called again. Tangents of what is stored need not be stored.
  return record.kernel && record.kernel->loadsStored && callbacks.empty() &&
         !lostStored && !runtime.isForward() &&
         memory->holdsStored(static_cast<uint32_t>(index));
}

/// The adjoint, in the form that the record wants.
Status Tape::findAdjoint(size_t index, Kernel *&adjoint) {
  Kernel &kernel = *records[index].kernel;
  bool takes = storesAgain[index];
  // Found once; what makes them takes a lock.
  if (readsStoredAt(index)) {
    adjoint = kernel.storedForms[takes].known.load(std::memory_order_acquire);
    if (adjoint)
      return Status::success();
    Status status = kernel.resolveStoredAdjoint(adjoint, takes);
    if (!status || adjoint)
      return status;
  }
  adjoint = kernel.adjointForms[takes].known.load(std::memory_order_acquire);
  return adjoint ? Status::success() : kernel.resolveAdjoint(adjoint, takes);
}

Status Tape::Pending::resolve() const {
  Kernel *adjoint = nullptr;
  if (stored) {
    Status status = kernel->resolveStoredAdjoint(adjoint, takes);
    if (!status || adjoint)
      return status;
  }
  return kernel->resolveAdjoint(adjoint, takes);
}

void Tape::explainStored(size_t index) {
  const Kernel &kernel = *records[index].kernel;
  if (!kernel.loadsStored)
    return;
  if (!readsStoredAt(index)) {
    explanation += "; computes again what it stored";
    return;
  }
  explanation += "; loads what it stored";
  std::vector<const Field *> named;
  for (const Access &access : kernel.adjointPlan->stored) {
    if (std::find(named.begin(), named.end(), access.field.get()) !=
        named.end())
      continue;
    explanation += (named.empty() ? " in @" : ", @") + access.field->name();
    named.push_back(access.field.get());
  }
}
