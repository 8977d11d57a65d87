//===- TapeLoss.cpp - Where reverse sweeps start --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Losses and their seeds, and what is worth a warning about their gradients.
//
//===----------------------------------------------------------------------===//

#include "../Host/HostWrite.h"
#include "../Storage/Scalars.h"
#include "TapeMemory.h"
#include "tai/Runtime/Tape/Tape.h"
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

Status Tape::addLoss(FieldPtr loss) {
  if (!isFloat(loss->scalar()))
    return Status::failure(StatusCode::Usage,
                           "the loss '" + loss->name() +
                               "' is not a field of floating-point numbers");
  if (!loss->adjoint())
    return Status::failure(StatusCode::Usage, "the loss '" + loss->name() +
                                                  "' has no adjoint field");
  if (!loss->valid() || !loss->adjoint()->valid())
    return goneLoss(*loss);
  if (isLoss(*loss))
    return Status::failure(StatusCode::Usage,
                           "the loss '" + loss->name() + "' is given twice");
  // It is set to zero, and then added to.
  FieldPtr adjoint = loss->adjointField;
  Status status = runtime.checkHold(*loss, HoldKind::Write);
  if (status)
    status = touch(loss, HoldKind::Add);
  if (status)
    status = touch(adjoint, clears ? HoldKind::Write : HoldKind::Add);
  if (!status)
    return status;
  clearSum(*loss);
  losses.push_back({std::move(loss), {}});
  return Status::success();
}

void Tape::clearSum(Field &loss) {
  // Losses are summed up, so a tape starts from an empty one.
  const char zeros[8] = {};
  if (isSum(loss))
    runtime.perform({HostWrite::What::Fill, &loss, zeros});
}

Status Tape::setSeed(const Field &field, const void *array) {
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

bool Tape::isLoss(const Field &field) const {
  return std::any_of(losses.begin(), losses.end(), [&](const Loss &loss) {
    return loss.field.get() == &field;
  });
}

Status Tape::seed() {
  for (const Loss &loss : losses) {
    Field *adjoint = loss.field->adjoint();
    if (!adjoint || !adjoint->valid() || !loss.field->valid())
      return goneLoss(*loss.field);
    if (!loss.seed.empty()) {
      runtime.perform({HostWrite::What::Array, adjoint, loss.seed.data()});
      continue;
    }
    if (!isSum(*loss.field))
      return Status::failure(StatusCode::Usage,
                             "the loss '" + loss.field->name() +
                                 "' is more than one number, so the tape needs "
                                 "a seed for it");
    char one[8];
    storeF64(adjoint->scalar(), one, 1.0);
    runtime.perform({HostWrite::What::Fill, adjoint, one});
  }
  return Status::success();
}

void Tape::checkEffect() {
  if (records.empty()) {
    notes.push_back("the tape has recorded no launch: there is nothing to "
                    "differentiate");
    return;
  }
  if (losses.empty() || reverseCallbacks)
    return;
  bool any =
      std::any_of(decisions.begin(), decisions.end(), [](Decision decision) {
        return decision == Decision::Replay;
      });
  if (any)
    return;
  std::string names;
  for (const Loss &loss : losses)
    names += (names.empty() ? "'" : ", '") + loss.field->name() + "'";
  notes.push_back("the loss " + names +
                  " does not depend on any field that has a gradient");
}
