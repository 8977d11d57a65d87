//===- SweepSeeds.cpp - Starts of reverse sweeps --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "SweepSeeds.h"
#include "tai/Runtime/Storage/Scalars.h"
#include <algorithm>

using namespace mlir::tai::runtime;

static Status goneLoss(const Field &loss) {
  return Status::failure(StatusCode::Usage, "the tree of the loss '" +
                                                loss.name() +
                                                "' has been destroyed");
}

static bool isSum(const Field &field) {
  return field.rank() == 0 && field.numComponents() == 1;
}

bool SweepSeeds::has(const Field &field) const {
  return std::any_of(losses.begin(), losses.end(), [&](const Loss &loss) {
    return loss.field.get() == &field;
  });
}

std::string SweepSeeds::names() const {
  std::string names;
  for (const Loss &loss : losses)
    names += (names.empty() ? "'" : ", '") + loss.field->name() + "'";
  return names;
}

Status SweepSeeds::add(FieldPtr loss, TapeHolds &holds) {
  if (!isFloat(loss->scalar()))
    return Status::failure(StatusCode::Usage,
                           "the loss '" + loss->name() +
                               "' is not a field of floating-point numbers");
  if (!loss->adjoint())
    return Status::failure(StatusCode::Usage, "the loss '" + loss->name() +
                                                  "' has no adjoint field");
  if (!loss->valid() || !loss->adjoint()->valid())
    return goneLoss(*loss);
  if (has(*loss))
    return Status::failure(StatusCode::Usage,
                           "the loss '" + loss->name() + "' is given twice");
  // The reverse sweep sets the adjoint of the loss, which this thread must be
  // allowed to do, and then adds to it.
  FieldPtr adjoint = loss->sharedAdjoint();
  Status status = services.checkHold(*loss, HoldKind::Write);
  if (status)
    status = holds.add(loss, HoldKind::Add);
  if (status)
    status = holds.add(adjoint, holds.gradientKind());
  if (!status)
    return status;
  clearSum(*loss);
  losses.push_back({std::move(loss), {}});
  return Status::success();
}

void SweepSeeds::clearSum(Field &loss) const {
  // A loss that is a sum is set to zero, since kernels only add to it.
  const char zeros[8] = {};
  if (isSum(loss))
    services.perform({HostWrite::What::Fill, &loss, zeros});
}

void SweepSeeds::clearSums() const {
  for (const Loss &loss : losses)
    if (loss.field->valid())
      clearSum(*loss.field);
}

Status SweepSeeds::set(const Field &field, const void *array) {
  for (Loss &loss : losses) {
    if (loss.field.get() != &field)
      continue;
    if (!field.adjoint())
      return goneLoss(field);
    auto *bytes = static_cast<const char *>(array);
    loss.seed.assign(bytes, bytes + field.adjoint()->hostBytes());
    return Status::success();
  }
  return Status::failure(StatusCode::Usage, "field '" + field.name() +
                                                "' is not a loss of this "
                                                "tape");
}

Status SweepSeeds::store() const {
  for (const Loss &loss : losses) {
    Field *adjoint = loss.field->adjoint();
    if (!adjoint || !adjoint->valid() || !loss.field->valid())
      return goneLoss(*loss.field);
    if (!loss.seed.empty()) {
      services.perform({HostWrite::What::Array, adjoint, loss.seed.data()});
      continue;
    }
    if (!isSum(*loss.field))
      return Status::failure(StatusCode::Usage,
                             "the loss '" + loss.field->name() +
                                 "' is more than one number, so the tape needs "
                                 "a seed for it");
    char one[8];
    storeF64(adjoint->scalar(), one, 1.0);
    services.perform({HostWrite::What::Fill, adjoint, one});
  }
  return Status::success();
}

std::vector<Field *> SweepSeeds::liveFields(bool cleared,
                                            const TapeHolds &holds) const {
  auto mayBeNonzero = [&](const FieldPtr &adjoint) {
    if (adjoint->isDirtiedByOther() && !holds.has(adjoint))
      return false;
    return cleared ? adjoint->tree().isExported() : adjoint->dirty();
  };
  std::vector<Field *> live;
  for (const FieldPtr &field : services.fields())
    if (field->adjoint() &&
        (has(*field) || mayBeNonzero(field->sharedAdjoint())))
      live.push_back(field.get());
  return live;
}
