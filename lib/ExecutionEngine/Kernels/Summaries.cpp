//===- Summaries.cpp - Access summaries for the runtime -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Kernels/Summaries.h"
#include "tai/Analysis/KernelAccesses.h"

using namespace mlir;
using namespace mlir::tai;

/// Adds to each write in the kernel's summary the boxes of elements that the
/// write stores to.
static void addStoredBoxes(ModuleOp module, KernelOp kernel,
                           std::vector<runtime::Access> &summary) {
  std::vector<NamedAccess> accesses;
  accesses.reserve(summary.size());
  for (const runtime::Access &line : summary)
    accesses.push_back({line.field->name(), line.kind, line.fixed});
  for (auto [line, boxes] :
       llvm::zip(summary, findStoredBoxes(module, kernel, accesses)))
    if (!boxes.empty() && !line.field->sparseNode())
      line.boxes = std::make_shared<const std::vector<runtime::StoredBox>>(
          std::move(boxes));
}

std::vector<runtime::Access> mlir::tai::summarize(const runtime::Runtime &rt,
                                                  ModuleOp module,
                                                  KernelOp kernel) {
  std::vector<runtime::Access> summary;
  for (Operation &op : *module.getBody()) {
    // A user-written adjoint in the module is not part of the kernel.
    if (isa<KernelOp>(op) && &op != kernel)
      continue;
    for (NamedAccess &access : listAccesses(&op)) {
      runtime::FieldPtr field = rt.store().findField(access.field);
      if (!field)
        continue;
      runtime::Access line{field, access.kind, std::move(access.fixed)};
      if (!llvm::is_contained(summary, line))
        summary.push_back(std::move(line));
    }
    // Deactivating a cell sets all levels and fields below it to zero, not only
    // the named field.
    op.walk([&](DeactivateOp deactivate) {
      runtime::FieldPtr named =
          rt.store().findField(deactivate.getField().str());
      for (const runtime::FieldPtr &field : rt.store().fields()) {
        if (!named || &field->tree() != &named->tree() ||
            !field->sparseNode() || field->isAdjoint())
          continue;
        runtime::Access line{field, runtime::AccessKind::Write, {}};
        if (!llvm::is_contained(summary, line))
          summary.push_back(std::move(line));
      }
    });
  }
  addStoredBoxes(module, kernel, summary);
  return summary;
}
