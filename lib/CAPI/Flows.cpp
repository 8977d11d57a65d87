//===- Flows.cpp - Lost derivatives in the C API --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include "llvm/ADT/StringExtras.h"

using namespace mlir;
using namespace mlir::tai;

bool taiKernelEndsGradients(TaiKernel kernel, int64_t slot) {
  const runtime::KernelFlows &known = kernel->launched.flows();
  return llvm::any_of(known.flows, [&](const runtime::ValueFlow &flow) {
    const runtime::FlowPlace &from = known.places[flow.from];
    const runtime::FlowPlace &to = known.places[flow.to];
    return to.slot == slot && !to.hasGradient &&
           (from.isArray() || from.hasGradient ||
            (from.field && from.field->adjoint()));
  });
}

static runtime::ArrayRange toRange(TaiArrayRange array) {
  return {array.begin, array.end, array.step, array.element_bytes};
}

void taiTapeNoteArrayCopy(TaiTape tape, const void *address,
                          TaiArrayRange array) {
  callQuietly(tape->context, [&] {
    tape->tape->noteArrayCopy(reinterpret_cast<uint64_t>(address),
                              toRange(array));
  });
}

void taiTapeNoteArrayWrite(TaiTape tape, TaiArrayRange array) {
  callQuietly(tape->context,
              [&] { tape->tape->noteArrayWrite(toRange(array)); });
}

static std::vector<runtime::FieldPtr> getFields(const TaiField *fields,
                                                int64_t count) {
  std::vector<runtime::FieldPtr> list;
  list.reserve(static_cast<size_t>(count));
  for (int64_t i = 0; i < count; ++i)
    list.push_back(fields[i]->field);
  return list;
}

void taiContextFollowTangents(TaiContext context, const TaiField *inputs,
                              int64_t count) {
  callQuietly(*context, [&] {
    context->session.getRuntime().followTangents(getFields(inputs, count));
  });
}

const char *taiContextLostTangents(TaiContext context, const TaiField *outputs,
                                   int64_t count) {
  return callOr(
      *context, static_cast<const char *>(nullptr), [&]() -> const char * {
        context->lostTangents =
            llvm::join(context->session.getRuntime().launcher().lostTangents(
                           getFields(outputs, count)),
                       "\n");
        return context->lostTangents.c_str();
      });
}
