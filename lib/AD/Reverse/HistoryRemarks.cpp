//===- HistoryRemarks.cpp - What is said about reversed loops -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Optimization remarks of category "tai-loops": one for each reversed loop,
// then one for each value that it carries, with how its reverse gets that
// value.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Matchers.h"
#include "mlir/IR/Remarks.h"
#include "tai/AD/LoopHistory.h"

using namespace mlir;
using namespace mlir::tai;

static std::string printType(Type type) {
  std::string text;
  llvm::raw_string_ostream(text) << type;
  return text;
}

/// The name that the program has for a value, or its number.
static std::string getName(Value value, unsigned index) {
  if (auto name = value.getLoc()->findInstanceOf<NameLoc>())
    return name.getName().str();
  return "#" + std::to_string(index);
}

StringRef LoopHistory::classify(unsigned index) const {
  if (histories.contains(index))
    return "trajectory";
  if (inverted.contains(index))
    return "invertible";
  if (closed.contains(index))
    return "closed form";
  return b.isActive(getArgument(index)) ? "linear" : "not needed";
}

void LoopHistory::report() {
  // Of a second form, all has been said of the first.
  if (!loop->getContext()->getRemarkEngine() || b.stored)
    return;
  auto options = [&](StringRef name) {
    return remark::RemarkOpts::name(name)
        .category("tai-loops")
        .function(b.primal.getName());
  };
  APInt trips;
  std::string iterations = "counted by a run of the loop";
  if (!counted)
    iterations = matchPattern(count, m_ConstantInt(&trips))
                     ? llvm::toString(trips, 10, /*Signed=*/true)
                     : "known when the loop begins";
  std::string memory = "none";
  if (!histories.empty()) {
    int64_t bytes = getBytesPerIteration();
    memory = std::to_string(bytes) + " bytes for each iteration";
    if (chunks.size)
      memory += llvm::formatv(
          "; chunks of about sqrt(n) iterations, each run once more, where "
          "all take more than {0} bytes",
          std::max(b.getHistoryLimit(), bytes));
  }
  remark::analysis(loop->getLoc(), options("reversed"))
      << remark::add("the {0} loop runs backwards",
                     isa<scf::ForOp>(loop) ? "for" : "while")
      << remark::metric("Iterations", iterations)
      << remark::metric("History", memory);
  for (unsigned i = 0; i != carried.size(); ++i) {
    Value argument = getArgument(i);
    Type type = argument.getType();
    StringRef kind = classify(i);
    auto says = [&](auto &&note) {
      note << remark::metric("Value", getName(argument, i))
           << remark::metric("Type", printType(type))
           << remark::metric("Class", kind.str())
           << remark::metric("BytesPerIteration",
                             kind == "trajectory" ? getBytes(type) : 0)
           << remark::metric("BytesPerChunk",
                             starts.contains(i) ? getBytes(type) : 0);
    };
    // That something is kept is what one may want to change.
    if (kind == "trajectory")
      says(remark::missed(argument.getLoc(), options("carried")));
    else
      says(remark::passed(argument.getLoc(), options("carried")));
  }
}
