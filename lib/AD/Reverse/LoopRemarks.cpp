//===- LoopRemarks.cpp - Remarks about reversed loops ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "LoopRemarks.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/Remarks.h"
#include "tai/AD/Reverse/LoopTrajectory.h"
#include "llvm/Support/FormatVariadic.h"

using namespace mlir;
using namespace mlir::tai;

static std::string printType(Type type) {
  std::string text;
  llvm::raw_string_ostream(text) << type;
  return text;
}

/// Returns the name of a value in the program, or its index among carried
/// values.
static std::string getName(Value value, unsigned index) {
  if (auto name = value.getLoc()->findInstanceOf<NameLoc>())
    return name.getName().str();
  return "#" + std::to_string(index);
}

void mlir::tai::remarkReversedLoop(const ReversedLoop &summary) {
  auto options = [&](StringRef name) {
    return remark::RemarkOpts::name(name)
        .category("tai-loops")
        .function(summary.function);
  };
  std::string memory = "none";
  if (summary.bytesPerIteration != 0) {
    memory =
        std::to_string(summary.bytesPerIteration) + " bytes for each iteration";
    if (summary.chunkedFrom != 0)
      memory += llvm::formatv(
          "; chunks of about sqrt(n) iterations, each run once more, where "
          "all take more than {0} bytes",
          summary.chunkedFrom);
  }
  remark::analysis(summary.loop->getLoc(), options("reversed"))
      << remark::add("the {0} loop runs backwards",
                     isa<scf::ForOp>(summary.loop) ? "for" : "while")
      << remark::metric("Iterations", summary.trips)
      << remark::metric("History", memory);
  for (auto [i, entry] : llvm::enumerate(summary.carried)) {
    Type type = entry.value.getType();
    bool isRecorded = entry.kind == "trajectory";
    auto says = [&, i = i, &entry = entry](auto &&note) {
      int64_t bytes = LoopTrajectory::getBytes(type);
      note << remark::metric("Value", getName(entry.value, i))
           << remark::metric("Type", printType(type))
           << remark::metric("Class", entry.kind.str())
           << remark::metric("BytesPerIteration", isRecorded ? bytes : 0)
           << remark::metric("BytesPerChunk", entry.isKeptByChunks ? bytes : 0);
    };
    // Recording a value is reported as a missed optimisation: it costs memory,
    // which a change of the program may avoid.
    if (isRecorded)
      says(remark::missed(entry.value.getLoc(), options("carried")));
    else
      says(remark::passed(entry.value.getLoc(), options("carried")));
  }
}
