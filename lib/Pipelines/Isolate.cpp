//===- Isolate.cpp - Restricts lowering to tai's ops ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A module that comes from another compiler holds functions that have nothing
// to do with tai, and general passes (inlining, CSE, conversions to LLVM)
// rewrite whatever they find. So the ops to lower are moved to a separate
// module while the passes run. If a module holds nothing else, the passes run
// on it directly.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Pass/PassRegistry.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Pipelines/Pipelines.h"

using namespace mlir;
using namespace mlir::tai;

/// The op of tai that stands in `op`, or null. Modules are worlds of their own.
static Operation *findTaiOp(Operation *op) {
  Operation *found = nullptr;
  op->walk<WalkOrder::PreOrder>([&](Operation *nested) {
    if (nested != op && nested->hasTrait<OpTrait::SymbolTable>())
      return WalkResult::skip();
    if (!isa_and_present<TaiDialect, TaiRTDialect, CheckDialect>(
            nested->getDialect()))
      return WalkResult::advance();
    found = nested;
    return WalkResult::interrupt();
  });
  return found;
}

/// Calls `action` with each symbol that `op` names in its module, and the op
/// that names it.
static void
forEachNamed(Operation *op, SymbolTable &symbols,
             llvm::function_ref<void(Operation *, Operation *)> action) {
  op->walk<WalkOrder::PreOrder>([&](Operation *user) {
    if (user != op && user->hasTrait<OpTrait::SymbolTable>())
      return WalkResult::skip();
    user->getAttrDictionary().walk([&](SymbolRefAttr name) {
      if (Operation *named = symbols.lookup(name.getRootReference()))
        action(named, user);
    });
    return WalkResult::advance();
  });
}

llvm::SetVector<Operation *> tai::collectOwn(ModuleOp module, StringRef entry) {
  SymbolTable symbols(module);
  llvm::SetVector<Operation *> own;
  for (Operation &op : *module.getBody())
    if (isa_and_present<TaiDialect, TaiRTDialect, CheckDialect>(
            op.getDialect()) ||
        (isa<func::FuncOp>(op) && findTaiOp(&op)))
      own.insert(&op);
  if (!entry.empty())
    if (Operation *function = symbols.lookup(entry))
      own.insert(function);
  // A caller of a function that is lowered must be lowered with it: the callee
  // has another signature afterwards. Calls of calls, until nothing is new.
  for (bool grown = true; grown;) {
    grown = false;
    for (auto function : module.getOps<func::FuncOp>()) {
      if (own.contains(function))
        continue;
      bool calls = false;
      forEachNamed(function, symbols, [&](Operation *named, Operation *user) {
        calls |= own.contains(named) && isa<func::FuncOp>(named) &&
                 isa<CallOpInterface>(user);
      });
      grown |= calls && own.insert(function);
    }
  }
  return own;
}

namespace {
/// The functions that lowered code calls, and that hold nothing of tai
/// themselves: they go into their callers.
struct Helpers {
  llvm::SetVector<Operation *> functions;
  /// Functions that are only named: they stay in place.
  llvm::SetVector<Operation *> named;

  Helpers(ModuleOp module, const llvm::SetVector<Operation *> &own) {
    SymbolTable symbols(module);
    SmallVector<Operation *> pending(own.begin(), own.end());
    while (!pending.empty())
      forEachNamed(pending.pop_back_val(), symbols,
                   [&](Operation *callee, Operation *user) {
                     if (own.contains(callee))
                       return;
                     if (!isa<func::FuncOp>(callee)) {
                       if (!isa<ModuleOp>(callee))
                         named.insert(callee);
                     } else if (functions.insert(callee)) {
                       pending.push_back(callee);
                     }
                   });
  }
};

/// Runs a pipeline on the part of a module that is tai's.
struct Isolate : PassWrapper<Isolate, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(Isolate)

  Isolate() : passes(ModuleOp::getOperationName()) {}
  Isolate(const Isolate &other) : PassWrapper(other), passes(other.passes) {
    pipeline = other.pipeline.getValue();
  }
  explicit Isolate(llvm::function_ref<void(OpPassManager &)> populate)
      : Isolate() {
    populate(passes);
    std::string text;
    llvm::raw_string_ostream stream(text);
    llvm::interleave(
        passes, [&](Pass &pass) { pass.printAsTextualPipeline(stream); },
        [&] { stream << ","; });
    pipeline = text;
  }

  StringRef getArgument() const final { return "tai-isolate"; }
  StringRef getDescription() const final {
    return "Run passes on the functions that hold ops of tai, and leave the "
           "rest of the module as it is";
  }
  LogicalResult
  initializeOptions(StringRef options,
                    function_ref<LogicalResult(const Twine &)> onError) final {
    if (failed(Pass::initializeOptions(options, onError)))
      return failure();
    passes = OpPassManager(ModuleOp::getOperationName());
    std::string message;
    llvm::raw_string_ostream stream(message);
    if (failed(parsePassPipeline(pipeline, passes, stream)))
      return onError("cannot read the pipeline: " + message);
    return success();
  }
  void getDependentDialects(DialectRegistry &registry) const final {
    passes.getDependentDialects(registry);
    registry.insert<TaiDialect>();
  }

  void runOnOperation() final;

private:
  LogicalResult checkForeign(const llvm::SetVector<Operation *> &own);
  LogicalResult runOn(const llvm::SetVector<Operation *> &own);

  OpPassManager passes;
  Option<std::string> pipeline{*this, "pipeline",
                               llvm::cl::desc("The passes to run")};
};
} // namespace

/// Code that is left alone must be valid as it is.
LogicalResult Isolate::checkForeign(const llvm::SetVector<Operation *> &own) {
  ModuleOp module = getOperation();
  SymbolTable symbols(module);
  for (Operation &op : *module.getBody()) {
    if (own.contains(&op))
      continue;
    if (op.hasTrait<OpTrait::SymbolTable>()) {
      Operation *found = nullptr;
      op.walk([&](Operation *nested) {
        if (isa_and_present<TaiDialect, TaiRTDialect, CheckDialect>(
                nested->getDialect()))
          found = nested;
      });
      if (found)
        return found
                   ->emitOpError("stands in a nested module, which is not "
                                 "lowered here")
                   .attachNote(op.getLoc())
               << "run the pipeline on this module too: "
                  "builtin.module(builtin.module(...))";
    } else if (Operation *found = findTaiOp(&op)) {
      return found->emitOpError("stands in '")
             << op.getName()
             << "'; expects a 'tai.kernel' or a 'func.func' around it";
    }
    Operation *changed = nullptr, *user = nullptr;
    forEachNamed(&op, symbols, [&](Operation *named, Operation *by) {
      if (own.contains(named) && isa<func::FuncOp, KernelOp>(named)) {
        changed = named;
        user = by;
      }
    });
    if (changed) {
      InFlightDiagnostic diag =
          user->emitOpError("names '@")
          << SymbolTable::getSymbolName(changed).getValue()
          << "', which becomes a function that only the runtime can call";
      diag.attachNote(changed->getLoc())
          << "lowered here, because it holds ops of tai or calls what does";
      return diag;
    }
  }
  return success();
}

LogicalResult Isolate::runOn(const llvm::SetVector<Operation *> &own) {
  ModuleOp module = getOperation();
  Helpers helpers(module, own);
  OpBuilder builder = OpBuilder::atBlockEnd(module.getBody());
  auto part = ModuleOp::create(builder, module.getLoc());
  // The layout of data is that of the module around. MLIR crashes on a second
  // one with the size of an index in it.
  for (NamedAttribute attribute : module->getAttrs())
    if (!isa<DataLayoutSpecInterface>(attribute.getValue()))
      part->setAttr(attribute.getName(), attribute.getValue());
  part->removeAttr(SymbolTable::getSymbolAttrName());

  // Helpers keep their places before, between and behind the lowered functions.
  Block *body = part.getBody();
  for (Operation &op : llvm::make_early_inc_range(*module.getBody())) {
    if (&op == part)
      break;
    if (own.contains(&op)) {
      op.moveBefore(body, body->end());
    } else if (helpers.functions.contains(&op)) {
      auto function = cast<func::FuncOp>(op);
      std::optional<SymbolTable::UseRange> uses =
          SymbolTable::getSymbolUses(function, module);
      bool isShared =
          !function.isPrivate() || function.isExternal() || !uses ||
          llvm::any_of(*uses, [&](SymbolTable::SymbolUse use) {
            Operation *root = use.getUser();
            while (root->getParentOp() && root->getParentOp() != module &&
                   root->getParentOp() != part)
              root = root->getParentOp();
            return root->getParentOp() == module && !own.contains(root) &&
                   !helpers.functions.contains(root);
          });
      if (isShared) {
        auto copy = cast<func::FuncOp>(builder.clone(op));
        copy->moveBefore(body, body->end());
        copy.setPrivate();
      } else {
        op.moveBefore(body, body->end());
      }
    } else if (helpers.named.contains(&op)) {
      // To be found by name where the passes run.
      Operation *copy = builder.clone(op);
      copy->moveBefore(body, body->end());
      if (auto function = dyn_cast<LLVM::LLVMFuncOp>(copy);
          function && !function.isExternal()) {
        function.getBody().dropAllReferences();
        function.getBody().getBlocks().clear();
        function.setLinkage(LLVM::Linkage::External);
      }
    }
  }
  if (failed(runPipeline(passes, part)))
    return failure();
  SymbolTable symbols(module);
  for (Operation &op : llvm::make_early_inc_range(*part.getBody())) {
    auto name = op.getAttrOfType<StringAttr>(SymbolTable::getSymbolAttrName());
    Operation *known = name ? symbols.lookup(name) : nullptr;
    if (!known) {
      op.moveBefore(part);
      continue;
    }
    // Declared on both sides, or taken along to be found by its name.
    auto declared = dyn_cast<LLVM::LLVMFuncOp>(op);
    if (known->getName() == op.getName() &&
        (!declared || declared.isExternal()))
      continue;
    return known->emitError("cannot stand beside what tai calls by the name '@")
               .append(name.getValue(), "'")
               .attachNote(op.getLoc())
           << "called here, as '" << op.getName() << "'";
  }
  for (NamedAttribute attribute : part->getAttrs())
    module->setAttr(attribute.getName(), attribute.getValue());
  part.erase();
  return success();
}

void Isolate::runOnOperation() {
  ModuleOp module = getOperation();
  llvm::SetVector<Operation *> own = collectOwn(module, {});
  Helpers helpers(module, own);
  bool isAll = llvm::all_of(*module.getBody(), [&](Operation &op) {
    if (own.contains(&op))
      return true;
    auto function = dyn_cast<func::FuncOp>(op);
    return function && function.isPrivate() &&
           helpers.functions.contains(function);
  });
  LogicalResult result = success();
  if (isAll)
    result = runPipeline(passes, module);
  else if (succeeded(result = checkForeign(own)) && !own.empty())
    result = runOn(own);
  if (failed(result))
    signalPassFailure();
}

void tai::addIsolated(OpPassManager &pm,
                      llvm::function_ref<void(OpPassManager &)> populate) {
  pm.addPass(std::make_unique<Isolate>(populate));
}

void tai::registerIsolate() { PassRegistration<Isolate>(); }
