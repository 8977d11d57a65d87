//===- Explain.cpp - Explanations of gradients ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Describes the loops of a kernel, the remarks of the passes on the kernel in
// program order, and the fields that its adjoint reads and accumulates into.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Reports/Explain.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Analysis/LoopBox.h"
#include "tai/Analysis/Reductions/Accumulation.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/Support/Places.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/Support/MathExtras.h"
#include "llvm/Support/Path.h"

using namespace mlir;
using namespace mlir::tai;

StringRef KeptRemark::get(StringRef key) const {
  for (const auto &[name, value] : args)
    if (name == key)
      return value;
  return "";
}

static thread_local RemarkScope *currentScope = nullptr;

namespace mlir::tai {
/// Receives the remarks of all threads, and passes each to the RemarkScope of
/// its thread.
class RemarkKeeper : public remark::detail::MLIRRemarkStreamerBase {
public:
  void streamOptimizationRemark(const remark::detail::Remark &remark) override {
    if (!currentScope)
      return;
    KeptRemark kept{remark.getCategoryName().str(),
                    remark.getRemarkName().str(),
                    remark.getLocation(),
                    {}};
    for (const auto &arg : remark.getArgs())
      kept.args.push_back({arg.key, arg.val});
    currentScope->remarks.push_back(std::move(kept));
  }
};
} // namespace mlir::tai

RemarkScope::RemarkScope() : outer(currentScope) { currentScope = this; }
RemarkScope::~RemarkScope() { currentScope = outer; }

void RemarkScope::prepare(MLIRContext *context) {
  remark::RemarkCategories categories;
  // Each category of remarks is named, because in this version of MLIR `all`
  // alone enables none.
  categories.passed = categories.missed = categories.analysis = "tai-.*";
  // The result is ignored: this call cannot fail, since no file is written.
  (void)remark::enableOptimizationRemarks(
      *context, std::make_unique<RemarkKeeper>(),
      std::make_unique<remark::RemarkEmittingPolicyAll>(), categories);
}

//===----------------------------------------------------------------------===//
// Text
//===----------------------------------------------------------------------===//

static std::string formatPlace(Location location) {
  FileLineColLoc place = findFileLocation(location);
  if (!place)
    return "an unknown place";
  return llvm::formatv("{0}:{1}",
                       llvm::sys::path::filename(place.getFilename()),
                       place.getLine());
}

static unsigned getLine(const KeptRemark &remark) {
  FileLineColLoc place = findFileLocation(remark.location);
  return place ? place.getLine() : 0;
}

static void describeCarried(llvm::raw_ostream &os, const KeptRemark &remark) {
  StringRef kind = remark.get("Class");
  os << "    " << remark.get("Value") << ": " << remark.get("Type") << ", "
     << kind;
  if (kind == "linear")
    os << ": no history, its adjoint needs no value of it";
  else if (kind == "closed form")
    os << ": computed from the number of the iteration";
  else if (kind == "invertible")
    os << ": carried backwards";
  else if (kind == "trajectory")
    os << ": " << remark.get("BytesPerIteration")
       << " bytes of history for each iteration";
  if (remark.get("BytesPerChunk") != "0")
    os << (kind == "trajectory" ? " of a chunk, " : "; ")
       << remark.get("BytesPerChunk") << " bytes for each chunk";
  os << '\n';
}

static void describeFields(llvm::raw_ostream &os, StringRef what,
                           const llvm::SetVector<StringRef> &names) {
  if (!names.empty())
    os << "  " << what << ": " << llvm::join(names, ", ") << '\n';
}

static void describeMemory(llvm::raw_ostream &os, ModuleOp module,
                           KernelOp adjoint) {
  llvm::DenseSet<StringRef> adjoints;
  for (FieldOp field : module.getOps<FieldOp>())
    if (FlatSymbolRefAttr symbol = field.getAdjointAttr())
      adjoints.insert(symbol.getValue());
  llvm::SetVector<StringRef> reads, gradients, sums, writes;
  adjoint.walk([&](Operation *op) {
    if (auto load = dyn_cast<LoadOp>(op))
      (adjoints.contains(load.getField()) ? gradients : reads)
          .insert(load.getField());
    else if (auto atomic = dyn_cast<AtomicOp>(op))
      sums.insert(atomic.getField());
    else if (auto store = dyn_cast<StoreOp>(op))
      writes.insert(store.getField());
  });
  describeFields(os, "the gradient reads the values of", reads);
  describeFields(os, "reads the gradients", gradients);
  describeFields(os, "adds to", sums);
  describeFields(os, "stores to", writes);
  if (ArrayAttr names = adjoint.getReadsBeforeAttr()) {
    llvm::SetVector<StringRef> fields;
    for (auto field : names.getAsRange<FlatSymbolRefAttr>())
      fields.insert(field.getValue());
    describeFields(os, "the tape saves, before each launch", fields);
  }
  if (adjoint.getReexecutes())
    os << "  the kernel is run again, before its gradient, on what was saved\n";
}

/// The number of threads below which a GPU is mostly idle.
static constexpr int64_t kFewThreads = 8192;

static bool isSerialLoop(Operation *op) {
  return isa<scf::ForOp, scf::WhileOp>(op);
}

/// Prints the estimate of the cost model for a loop on one core, on which the
/// number of threads of a launch depends.
static void describeCost(llvm::raw_ostream &os, ParallelForOp loop,
                         std::optional<int64_t> iterations) {
  double each = estimateIteration(loop, /*isIndependent=*/true);
  os << llvm::formatv("    estimated at {0:f1} ns for an iteration", each);
  if (iterations)
    os << llvm::formatv(", {0:f1} us in all", each * *iterations * 1e-3);
  os << ", on one core\n";
}

static void describeParallelLoop(llvm::raw_ostream &os, ParallelForOp loop,
                                 bool onDevice) {
  os << "  parallel loop at " << formatPlace(loop.getLoc()) << ": ";
  std::optional<int64_t> iterations;
  if (std::optional<LoopBox> box = getConstantBox(loop)) {
    iterations = 1;
    for (auto [lower, upper] : llvm::zip(box->lower, box->upper))
      iterations = llvm::SaturatingMultiply<uint64_t>(
          *iterations, std::max<int64_t>(upper - lower, 0));
    os << *iterations << (*iterations == 1 ? " iteration" : " iterations");
  } else if (loop.isStructFor()) {
    os << "the active cells of " << *loop.getField();
  } else {
    os << "a number of iterations that is known at run time";
  }
  bool isLong = loop.getBody()
                    .walk([](Operation *op) {
                      return isSerialLoop(op) ? WalkResult::interrupt()
                                              : WalkResult::advance();
                    })
                    .wasInterrupted();
  if (loop.getInOrder() || loop.getSerialize())
    os << "; one thread runs them";
  else if (onDevice && iterations && *iterations == 1 && isLong)
    os << "; one thread runs it, on a GPU many times slower than a core of the "
          "CPU: use arch=ti.cpu, or launch a kernel with a parallel loop for "
          "each step of its serial loop";
  else if (onDevice && iterations && *iterations < kFewThreads && isLong)
    os << "; so few threads, each with a serial loop, leave most of a GPU "
          "idle: the CPU may be faster";
  os << '\n';
  if (!onDevice)
    describeCost(os, loop, iterations);
}

/// Describes the loops that threads share, and the serial loops around these.
static void describeLoops(llvm::raw_ostream &os, KernelOp kernel,
                          bool onDevice) {
  kernel.walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (auto loop = dyn_cast<ParallelForOp>(op)) {
      describeParallelLoop(os, loop, onDevice);
      return WalkResult::skip();
    }
    if (!isSerialLoop(op) || op->walk([](ParallelForOp) {
                                 return WalkResult::interrupt();
                               }).wasInterrupted())
      return WalkResult::advance();
    os << "  serial loop at " << formatPlace(op->getLoc())
       << ": one thread runs it";
    if (onDevice)
      os << ", on a GPU many times slower than a core of the CPU; use "
            "arch=ti.cpu, or launch a kernel with a parallel loop for each of "
            "its steps";
    os << '\n';
    return WalkResult::skip();
  });
}

/// Describes how the kernel's parallel loops do their updates.
static void describeUpdates(llvm::raw_ostream &os,
                            ArrayRef<KeptRemark> remarks) {
  for (const KeptRemark &remark : remarks) {
    if (remark.category != "tai-reductions")
      continue;
    StringRef field = remark.get("Field"), digits = remark.get("Digits");
    os << "  update of " << (field.empty() ? "an array" : field) << " at "
       << formatPlace(remark.location) << ": " << remark.name;
    if (!digits.empty())
      os << ", digits " << digits << ", order " << remark.get("Order");
    if (StringRef reason = remark.get("Reason"); !reason.empty())
      os << ", because " << reason;
    os << '\n';
  }
}

/// For the additions of each loop, says whether the iterations that own an
/// element make all additions to it. The versions of a loop may have a line
/// each.
static void describeGathers(llvm::raw_ostream &os, StringRef where,
                            ArrayRef<KeptRemark> remarks) {
  llvm::StringSet<> lines;
  for (const KeptRemark &remark : remarks) {
    if (remark.category != "tai-gathers")
      continue;
    std::string line = llvm::formatv("{0} at {1}: additions to {2} are {3}",
                                     where, formatPlace(remark.location),
                                     remark.get("Field"), remark.name);
    if (StringRef reason = remark.get("Reason"); !reason.empty())
      line += (": " + reason).str();
    if (StringRef at = remark.get("Line"); !at.empty())
      line += (" (line " + at + ")").str();
    if (lines.insert(line).second)
      os << "  " << line << '\n';
  }
}

/// Says for which values of a launch a loop has versions. The versions that one
/// pass makes may have a line each from a later one.
static void describeVersions(llvm::raw_ostream &os, StringRef where,
                             ArrayRef<KeptRemark> remarks) {
  llvm::StringSet<> lines;
  for (const KeptRemark &remark : remarks) {
    if (remark.category != "tai-versions")
      continue;
    StringRef reason = remark.get("Reason");
    std::string line =
        llvm::formatv("{0} at {1}: {2}versions of the loop for {3}", where,
                      formatPlace(remark.location), reason.empty() ? "" : "no ",
                      remark.get("Values"));
    if (!reason.empty())
      line += (", because " + reason).str();
    if (lines.insert(line).second)
      os << "  " << line << '\n';
  }
}

/// "3 rows before and 1 row behind those of the rank".
static std::string formatHalos(const KeptRemark &remark) {
  SmallVector<std::string> sides;
  for (auto [key, side] : {std::pair("Before", "before"), {"After", "behind"}})
    if (StringRef rows = remark.get(key); rows != "0")
      sides.push_back(llvm::formatv("{0} {1} {2}", rows,
                                    rows == "1" ? "row" : "rows", side));
  return llvm::join(sides, " and ") + " those of the rank";
}

/// Describes how the ranks of a mesh communicate.
static void describeExchanges(llvm::raw_ostream &os, StringRef where,
                              ArrayRef<KeptRemark> remarks) {
  llvm::StringSet<> lines;
  for (const KeptRemark &remark : remarks) {
    if (remark.category != "tai-exchanges")
      continue;
    StringRef field = remark.get("Field"), name = remark.name;
    std::string line =
        llvm::formatv("{0} at {1}: ", where, formatPlace(remark.location));
    if (name == "fetch")
      line += llvm::formatv("fetches {0} of {1}", formatHalos(remark), field);
    else if (name == "collect")
      line += llvm::formatv("adds {0} of {1} to the rows of their owners",
                            formatHalos(remark), field);
    else if (name == "gather")
      line += llvm::formatv("gathers all rows of {0}, because {1}", field,
                            remark.get("Reason"));
    else
      line += llvm::formatv("all-reduces {0} ({1})", field, name);
    if (StringRef at = remark.get("Line"); !at.empty())
      line += (" (line " + at + ")").str();
    if (lines.insert(line).second)
      os << "  " << line << '\n';
  }
}

std::string mlir::tai::explainGathers(StringRef where,
                                      ArrayRef<KeptRemark> remarks) {
  std::string text;
  llvm::raw_string_ostream os(text);
  describeVersions(os, where, remarks);
  describeGathers(os, where, remarks);
  return text;
}

std::string mlir::tai::explainKernel(ModuleOp module, StringRef name,
                                     bool onDevice,
                                     ArrayRef<KeptRemark> remarks,
                                     ArrayRef<KeptRemark> lowering,
                                     ArrayRef<KeptRemark> gradient) {
  std::string text;
  llvm::raw_string_ostream os(text);
  os << "kernel '" << name << "'\n";
  auto kernel = module.lookupSymbol<KernelOp>(name);
  if (kernel)
    describeLoops(os, kernel, onDevice);
  describeUpdates(os, lowering);
  describeVersions(os, "kernel", lowering);
  describeVersions(os, "gradient", gradient);
  describeGathers(os, "kernel", lowering);
  describeGathers(os, "gradient", gradient);
  describeExchanges(os, "kernel", lowering);
  describeExchanges(os, "gradient", gradient);
  KernelOp adjoint;
  if (kernel && kernel.getAdjointAttr())
    adjoint = module.lookupSymbol<KernelOp>(kernel.getAdjointAttr());
  if (!adjoint) {
    os << "  has no gradient\n";
    return text;
  }
  // Each remark on a loop is followed by remarks on the values that the loop
  // carries.
  struct Entry {
    const KeptRemark *remark;
    ArrayRef<KeptRemark> carried;
  };
  SmallVector<Entry> entries;
  for (size_t i = 0; i != remarks.size(); ++i) {
    if (remarks[i].name == "carried")
      continue;
    size_t end = i + 1;
    while (end != remarks.size() && remarks[end].name == "carried")
      ++end;
    entries.push_back({&remarks[i], remarks.slice(i + 1, end - i - 1)});
  }
  // Remarks on the same line keep their order.
  llvm::sort(entries, [](const Entry &lhs, const Entry &rhs) {
    return std::pair(getLine(*lhs.remark), lhs.remark) <
           std::pair(getLine(*rhs.remark), rhs.remark);
  });
  for (const Entry &entry : entries) {
    const KeptRemark &remark = *entry.remark;
    if (remark.category == "tai-loops") {
      StringRef iterations = remark.get("Iterations");
      os << "  loop at " << formatPlace(remark.location) << ": ";
      if (llvm::all_of(iterations, llvm::isDigit))
        os << iterations << " iterations";
      else
        os << "iterations " << iterations;
      os << "; history: " << remark.get("History") << '\n';
      for (const KeptRemark &carried : entry.carried)
        describeCarried(os, carried);
    } else if (remark.category == "tai-branches") {
      os << "  branch at " << formatPlace(remark.location) << ": "
         << remark.name;
      if (StringRef reason = remark.get("Reason"); !reason.empty())
        os << ", because " << reason;
      os << '\n';
    }
  }
  describeMemory(os, module, adjoint);
  return text;
}
