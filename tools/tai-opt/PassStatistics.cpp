//===- PassStatistics.cpp - Counts the changes of passes ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Counts ops and attributes by name before and after each pass.
//
//===----------------------------------------------------------------------===//

#include "PassStatistics.h"
#include "mlir/IR/OperationSupport.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Pass/PassManager.h"
#include "tai/ExecutionEngine/Reports/Explain.h"
#include "llvm/ADT/DenseMap.h"
#include "llvm/Support/raw_ostream.h"

using namespace mlir;
using namespace mlir::tai;

namespace mlir::tai {
/// Counts the changes that the passes of one manager make, for `statistics`.
class PassCounter : public PassInstrumentation {
public:
  explicit PassCounter(PassStatistics &statistics) : statistics(statistics) {}

  void runBeforePass(Pass *pass, Operation *op) override {
    // A pass without a name does nothing but run other passes.
    if (pass->getArgument().empty())
      return;
    auto step = std::make_unique<Step>(op);
    std::lock_guard<std::mutex> lock(statistics.mutex);
    steps[{pass, op}] = std::move(step);
  }

  void runAfterPass(Pass *pass, Operation *op) override { end(pass, op); }
  void runAfterPassFailed(Pass *pass, Operation *op) override { end(pass, op); }

private:
  /// The contents of an op when a pass begins. Remarks reach the innermost step
  /// of a thread.
  struct Step {
    explicit Step(Operation *op) : print(op) { count(op, counts, ops, 1); }

    OperationFingerPrint print;
    std::map<std::string, int> counts;
    unsigned ops = 0;
    RemarkScope remarks;
  };

  static void count(Operation *root, std::map<std::string, int> &counts,
                    unsigned &ops, int sign) {
    root->walk([&](Operation *op) {
      ++ops;
      std::string kind = op->getName().getStringRef().str();
      counts[kind] += sign;
      for (NamedAttribute attribute : op->getDiscardableAttrs())
        counts["'" + attribute.getName().str() + "'"] += sign;
      if (std::optional<RegisteredOperationName> known =
              op->getRegisteredInfo())
        for (StringAttr name : known->getAttributeNames())
          if (op->getAttr(name))
            counts[kind + " '" + name.str() + "'"] += sign;
    });
  }

  void end(Pass *pass, Operation *op) {
    if (pass->getArgument().empty())
      return;
    std::unique_ptr<Step> step;
    {
      std::lock_guard<std::mutex> lock(statistics.mutex);
      step = std::move(steps[{pass, op}]);
      steps.erase({pass, op});
    }
    unsigned seen = step->ops, left = 0;
    for (auto &[name, number] : step->counts)
      number = -number;
    count(op, step->counts, left, 1);
    bool changed = OperationFingerPrint(op) != step->print;
    std::lock_guard<std::mutex> lock(statistics.mutex);
    PassStatistics::Row &row = statistics.rows[pass->getArgument().str()];
    ++row.runs;
    row.changed += changed;
    row.ops += seen;
    for (auto &[name, number] : step->counts) {
      // Attributes that come and go with ops are not counted besides these.
      auto [kind, attribute] = StringRef(name).split(" '");
      if (attribute.empty() || step->counts[kind.str()] == 0)
        row.changes[name] += number;
    }
    for (const KeptRemark &remark : step->remarks.getRemarks())
      ++row.remarks[remark.name];
  }

  PassStatistics &statistics;
  llvm::DenseMap<std::pair<Pass *, Operation *>, std::unique_ptr<Step>> steps;
};
} // namespace mlir::tai

void PassStatistics::observe(PassManager &manager) {
  RemarkScope::prepare(manager.getContext());
  manager.addInstrumentation(std::make_unique<PassCounter>(*this));
}

void PassStatistics::print(llvm::raw_ostream &os) const {
  std::lock_guard<std::mutex> lock(mutex);
  os << "passes: runs, those that changed something, and ops before; the "
        "numbers of ops, of 'attributes' and of remarks\n";
  for (const auto &[name, row] : rows) {
    os << "  " << name << ": " << row.runs << " run"
       << (row.runs == 1 ? "" : "s") << ", " << row.changed << " changed, "
       << row.ops << " ops";
    StringRef separator = "; ";
    for (const auto &[what, number] : row.changes) {
      if (!number)
        continue;
      os << separator << what << ' ' << (number > 0 ? "+" : "") << number;
      separator = ", ";
    }
    if (row.changed && separator == "; ")
      os << "; as many ops as before";
    separator = "; ";
    for (const auto &[what, number] : row.remarks) {
      os << separator << "remark " << what << ' ' << number;
      separator = ", ";
    }
    os << '\n';
  }
}
