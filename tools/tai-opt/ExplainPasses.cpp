//===- ExplainPasses.cpp - Reports what passes did to kernels -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Counts the ops of each function before and after each pass.
//
//===----------------------------------------------------------------------===//

#include "ExplainPasses.h"
#include "mlir/IR/OperationSupport.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Pass/PassManager.h"
#include "tai/ExecutionEngine/Reports/Explain.h"
#include "llvm/ADT/MapVector.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/Support/raw_ostream.h"
#include <map>

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The numbers of ops of a function by name, and a fingerprint of the function.
struct Contents {
  std::map<std::string, int> counts;
  int total = 0;
  OperationFingerPrint print;
};

/// A map whose keys are names, and which is visited in the order of insertion.
template <typename T>
using ByName = llvm::MapVector<std::string, T, std::map<std::string, unsigned>>;

/// The ops of each function when a pass begins, to compare with at its end.
struct Step {
  ByName<Contents> before;
  /// For each location, a function with ops there, to which remarks at this
  /// location are assigned.
  DenseMap<Location, std::string> holders;
  std::unique_ptr<RemarkScope> remarks;
  bool ranOthers = false;
};

class PassExplainer : public PassInstrumentation {
public:
  ~PassExplainer() override {
    for (auto &[name, lines] : report) {
      llvm::errs() << name << '\n';
      for (const std::string &line : lines)
        llvm::errs() << "  " << line << '\n';
      if (lines.empty())
        llvm::errs() << "  no pass changed it\n";
    }
  }

  void runBeforePass(Pass *pass, Operation *op) override {
    if (isGroup(pass))
      return;
    if (!steps.empty())
      steps.back().ranOthers = true;
    Step step;
    forEachFunction(op, [&](StringRef name, FunctionOpInterface function) {
      function->walk([&](Operation *inner) {
        step.holders.try_emplace(inner->getLoc(), name.str());
      });
      step.before.insert({name.str(), count(function)});
      report.insert({name.str(), {}});
    });
    step.remarks = std::make_unique<RemarkScope>();
    steps.push_back(std::move(step));
  }

  void runAfterPass(Pass *pass, Operation *op) override { end(pass, op, ""); }
  void runAfterPassFailed(Pass *pass, Operation *op) override {
    end(pass, op, "fails");
  }

private:
  /// True if the pass does nothing but run other passes.
  static bool isGroup(Pass *pass) { return pass->getArgument().empty(); }

  static void forEachFunction(
      Operation *root,
      llvm::function_ref<void(StringRef, FunctionOpInterface)> use) {
    root->walk<WalkOrder::PreOrder>([&](FunctionOpInterface function) {
      if (!function.isExternal())
        use(("@" + function.getName()).str(), function);
      return WalkResult::skip();
    });
  }

  static Contents count(Operation *function) {
    Contents contents{{}, 0, OperationFingerPrint(function)};
    function->walk([&](Operation *op) {
      ++contents.counts[op->getName().getStringRef().str()];
      ++contents.total;
    });
    return contents;
  }

  /// The difference in words, such as "scf.if 2 -> 1, arith.select 0 -> 1".
  static std::string compare(const Contents &before, const Contents &after) {
    std::map<std::string, std::pair<int, int>> both;
    for (auto &[name, number] : before.counts)
      both[name].first = number;
    for (auto &[name, number] : after.counts)
      both[name].second = number;
    std::string text;
    llvm::raw_string_ostream os(text);
    for (auto &[name, numbers] : both)
      if (numbers.first != numbers.second)
        os << (text.empty() ? "" : ", ") << name << ' ' << numbers.first
           << " -> " << numbers.second;
    return text.empty() ? "changed, with ops as before" : text;
  }

  void end(Pass *pass, Operation *op, StringRef outcome) {
    if (isGroup(pass))
      return;
    Step step = std::move(steps.back());
    steps.pop_back();
    auto add = [&](StringRef function, const Twine &text) {
      report[function.str()].push_back(
          (pass->getArgument() + ": " + text).str());
    };
    for (const KeptRemark &remark : step.remarks->getRemarks()) {
      auto holder = step.holders.find(remark.location);
      std::string text = remark.name;
      for (auto &[key, value] : remark.args)
        text += ", " + (key == "Remark" ? "" : key + " ") + value;
      add(holder == step.holders.end() ? "module" : StringRef(holder->second),
          text);
    }
    // Remark scopes must end in the reverse order of their beginnings.
    step.remarks.reset();
    llvm::StringSet<> left;
    forEachFunction(op, [&](StringRef name, FunctionOpInterface function) {
      left.insert(name);
      auto *known = step.before.find(name.str());
      if (step.ranOthers)
        return;
      if (known == step.before.end()) {
        add(name, "made, of " + Twine(count(function).total) + " ops");
        return;
      }
      Contents after = count(function);
      if (after.print != known->second.print)
        add(name, compare(known->second, after));
    });
    for (auto &[name, contents] : step.before) {
      if (!outcome.empty())
        add(name, outcome);
      else if (!step.ranOthers && !left.contains(name))
        add(name, "removed");
    }
  }

  SmallVector<Step> steps;
  ByName<SmallVector<std::string>> report;
};
} // namespace

void tai::explainPasses(PassManager &manager) {
  MLIRContext *context = manager.getContext();
  context->disableMultithreading();
  RemarkScope::prepare(context);
  manager.addInstrumentation(std::make_unique<PassExplainer>());
}
