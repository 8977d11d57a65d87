//===- Isolate.cpp - Restricts lowering to tai's ops ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A module that comes from another compiler contains functions that have
// nothing to do with tai, and general passes (inlining, CSE, conversions to
// LLVM) rewrite whatever they find. So the ops to lower are moved to a separate
// module while the passes run. If a module contains only such ops, the passes
// run on it directly.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Pass/PassRegistry.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Pipelines/Pipelines.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// Functions that lowered code calls and that contain no ops of tai: they are
/// inlined into their callers.
struct Helpers {
  llvm::SetVector<Operation *> functions;
  /// Functions that are referenced but not called, and so stay in place.
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

/// Runs a pipeline on the part of a module that belongs to tai.
struct Isolate : PassWrapper<Isolate, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(Isolate)

  Isolate() : passes(ModuleOp::getOperationName()) {}
  Isolate(const Isolate &other) : PassWrapper(other), passes(other.passes) {
    pipeline = other.pipeline.getValue();
    keep = other.keep.getValue();
    names = other.names;
  }
  Isolate(llvm::function_ref<void(OpPassManager &)> populate, IsolateMode mode,
          ArrayRef<std::string> selected)
      : Isolate() {
    populate(passes);
    keep = mode == IsolateMode::Keep;
    names = selected;
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
  llvm::SetVector<Operation *> collectOwn();
  LogicalResult checkForeign(const llvm::SetVector<Operation *> &own);
  LogicalResult runOnAll(const llvm::SetVector<Operation *> &own);
  LogicalResult runOn(const llvm::SetVector<Operation *> &own);

  OpPassManager passes;
  Option<std::string> pipeline{*this, "pipeline",
                               llvm::cl::desc("The passes to run")};
  Option<bool> keep{*this, "keep",
                    llvm::cl::desc("The passes keep the signatures of "
                                   "functions: callers stay as they are"),
                    llvm::cl::init(false)};
  ListOption<std::string> names{
      *this, "function",
      llvm::cl::desc("Names of functions that count as those of tai")};
};

/// Makes private functions public that nothing else in the part keeps alive:
/// functions requested by name, called from the rest of the module, or waiting
/// for their callers.
class KeptFunctions {
public:
  KeptFunctions(ModuleOp module, const llvm::SetVector<Operation *> &own) {
    for (Operation *op : own) {
      auto function = dyn_cast<func::FuncOp>(op);
      if (!function || !function.isPrivate() || function.isExternal())
        continue;
      std::optional<SymbolTable::UseRange> uses =
          SymbolTable::getSymbolUses(function, module);
      bool isCalledByOwn =
          uses && !uses->empty() &&
          llvm::all_of(*uses, [&](SymbolTable::SymbolUse use) {
            Operation *root = use.getUser();
            while (root->getParentOp() && root->getParentOp() != module)
              root = root->getParentOp();
            return own.contains(root);
          });
      if (isCalledByOwn && isTaiCode(function))
        continue;
      function.setPublic();
      kept.push_back({function.getSymNameAttr(), getDerivatives(function)});
    }
  }

  /// Makes the functions private again, and the derivatives that were made of
  /// them.
  void restore(ModuleOp part) {
    SymbolTable symbols(part);
    for (auto &[name, before] : kept) {
      auto function = symbols.lookup<func::FuncOp>(name);
      if (!function)
        continue;
      function.setPrivate();
      for (StringAttr derivative : getDerivatives(function))
        if (auto made = symbols.lookup<func::FuncOp>(derivative);
            made && !llvm::is_contained(before, derivative))
          made.setPrivate();
    }
  }

private:
  static SmallVector<StringAttr> getDerivatives(func::FuncOp function) {
    SmallVector<StringAttr> names;
    for (StringRef attribute : {"tai.adjoint", "tai.tangent", "tai.split"})
      if (Attribute value = function->getAttr(attribute))
        value.walk(
            [&](FlatSymbolRefAttr name) { names.push_back(name.getAttr()); });
    return names;
  }

  /// The name of each function, and its derivatives before.
  SmallVector<std::pair<StringAttr, SmallVector<StringAttr>>> kept;
};
} // namespace

llvm::SetVector<Operation *> Isolate::collectOwn() {
  ModuleOp module = getOperation();
  llvm::SetVector<Operation *> own;
  if (!keep) {
    own = collectLowered(module);
  } else {
    for (Operation &op : *module.getBody())
      if (belongsToTai(&op))
        own.insert(&op);
    SymbolTable symbols(module);
    for (const std::string &name : names)
      if (Operation *function = symbols.lookup(name))
        own.insert(function);
  }
  own.remove_if(
      [](Operation *op) { return !isTaiOp(op) && !isa<func::FuncOp>(op); });
  return own;
}

/// Verifies the code of the module that the pipeline leaves unchanged.
LogicalResult Isolate::checkForeign(const llvm::SetVector<Operation *> &own) {
  ModuleOp module = getOperation();
  SymbolTable symbols(module);
  for (Operation &op : *module.getBody()) {
    if (own.contains(&op))
      continue;
    if (op.hasTrait<OpTrait::SymbolTable>()) {
      Operation *found = nullptr;
      op.walk([&](Operation *nested) {
        if (isTaiOp(nested))
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

/// Runs the passes on the module itself, which contains nothing but code of
/// tai.
LogicalResult Isolate::runOnAll(const llvm::SetVector<Operation *> &own) {
  ModuleOp module = getOperation();
  if (!keep)
    return runPipeline(passes, module);
  KeptFunctions kept(module, own);
  LogicalResult result = runPipeline(passes, module);
  kept.restore(module);
  return result;
}

LogicalResult Isolate::runOn(const llvm::SetVector<Operation *> &own) {
  ModuleOp module = getOperation();
  Helpers helpers(module, own);
  std::optional<KeptFunctions> kept;
  if (keep)
    kept.emplace(module, own);
  OpBuilder builder = OpBuilder::atBlockEnd(module.getBody());
  auto part = ModuleOp::create(builder, module.getLoc());
  // The enclosing module has the data layout. MLIR crashes on a second data
  // layout that contains the size of index.
  for (NamedAttribute attribute : module->getAttrs())
    if (!isa<DataLayoutSpecInterface>(attribute.getValue()))
      part->setAttr(attribute.getName(), attribute.getValue());
  part->removeAttr(SymbolTable::getSymbolAttrName());

  // For each op that is moved: the next op that stays, before which it is put
  // back.
  DenseMap<StringAttr, Operation *> places;
  Operation *place = nullptr;
  SmallVector<StringAttr> moved;
  DenseSet<StringAttr> copied;
  auto getName = [](Operation &op) {
    return op.getAttrOfType<StringAttr>(SymbolTable::getSymbolAttrName());
  };
  auto stays = [&](Operation &op) {
    if (!place)
      place = &op;
    for (StringAttr name : moved)
      places[name] = &op;
    moved.clear();
  };

  // Helper functions keep their order relative to the lowered functions.
  Block *body = part.getBody();
  for (Operation &op : llvm::make_early_inc_range(*module.getBody())) {
    if (&op == part)
      break;
    if (own.contains(&op)) {
      moved.push_back(getName(op));
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
        copied.insert(function.getSymNameAttr());
        stays(op);
      } else {
        moved.push_back(getName(op));
        op.moveBefore(body, body->end());
      }
    } else if (helpers.named.contains(&op)) {
      // The passes must find the op by its name, so it is copied into the
      // module on which they run.
      stays(op);
      copied.insert(getName(op));
      Operation *copy = builder.clone(op);
      copy->moveBefore(body, body->end());
      if (auto function = dyn_cast<LLVM::LLVMFuncOp>(copy);
          function && !function.isExternal()) {
        function.getBody().dropAllReferences();
        function.getBody().getBlocks().clear();
        function.setLinkage(LLVM::Linkage::External);
      }
    } else {
      stays(op);
    }
  }
  stays(*part);
  if (failed(runPipeline(passes, part)))
    return failure();
  if (kept)
    kept->restore(part);
  SymbolTable symbols(module);
  for (Operation &op : llvm::make_early_inc_range(*part.getBody())) {
    StringAttr name = getName(op);
    Operation *known = name ? symbols.lookup(name) : nullptr;
    if (!known) {
      if (Operation *known = name ? places.lookup(name) : nullptr)
        place = known;
      op.moveBefore(place);
      continue;
    }
    if (keep && !copied.contains(name))
      return op.emitError("cannot make '@")
                 .append(name.getValue(), "': the name is taken")
                 .attachNote(known->getLoc())
             << "by this";
    // An op of the same name is no conflict if both modules only declare it, or
    // if it was copied so that passes find it by name.
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
  if (keep && failed(checkNested(module)))
    return signalPassFailure();
  llvm::SetVector<Operation *> own = collectOwn();
  Helpers helpers(module, own);
  bool isAll = llvm::all_of(*module.getBody(), [&](Operation &op) {
    if (own.contains(&op))
      return true;
    auto function = dyn_cast<func::FuncOp>(op);
    return function && function.isPrivate() &&
           helpers.functions.contains(function);
  });
  LogicalResult result = success();
  // The passes report requested names for which there is no function.
  bool isEmpty = own.empty() && names.empty();
  if (isAll && !isEmpty)
    result = runOnAll(own);
  else if (keep || succeeded(result = checkForeign(own)))
    result = isEmpty ? success() : runOn(own);
  if (failed(result))
    signalPassFailure();
}

void tai::addIsolated(OpPassManager &pm,
                      llvm::function_ref<void(OpPassManager &)> populate,
                      IsolateMode mode, ArrayRef<std::string> names) {
  pm.addPass(std::make_unique<Isolate>(populate, mode, names));
}

void tai::registerIsolate() { PassRegistration<Isolate>(); }
