//===- Ownership.cpp - Which functions belong to tai ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/Ownership.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/IR/Builders.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "mlir/Interfaces/FunctionInterfaces.h"

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kPassthrough = "passthrough";
static constexpr StringLiteral kLowered = "tai.lowered";

bool tai::isTaiOp(Operation *op) {
  // The name of the op's dialect is compared, because the dialect need not be
  // loaded.
  StringRef dialect = op->getName().getDialectNamespace();
  return dialect == "tai" || dialect == "tai_rt" || dialect == "tai_check";
}

Operation *tai::findTaiOp(Operation *op) {
  Operation *found = nullptr;
  op->walk<WalkOrder::PreOrder>([&](Operation *nested) {
    if (isTaiOp(nested)) {
      found = nested;
      return WalkResult::interrupt();
    }
    return nested != op && nested->hasTrait<OpTrait::SymbolTable>()
               ? WalkResult::skip()
               : WalkResult::advance();
  });
  return found;
}

/// Returns the name of an entry of `passthrough`, which is a name or a pair of
/// name and value.
static StringRef getEntryName(Attribute entry) {
  if (auto pair = dyn_cast<ArrayAttr>(entry); pair && !pair.empty())
    entry = pair[0];
  auto name = dyn_cast<StringAttr>(entry);
  return name ? name.getValue() : StringRef();
}

bool tai::isTaiCode(Operation *op) {
  if (isTaiOp(op))
    return true;
  if (op->hasTrait<OpTrait::SymbolTable>() && !isa<ModuleOp>(op))
    return llvm::any_of(op->getRegion(0).getOps(),
                        [](Operation &inner) { return isTaiCode(&inner); });
  if (!isa<FunctionOpInterface>(op))
    return false;
  auto entries = op->getAttrOfType<ArrayAttr>(kPassthrough);
  return (entries &&
          llvm::any_of(entries,
                       [](Attribute entry) {
                         return getEntryName(entry).starts_with("tai.");
                       })) ||
         findTaiOp(op);
}

bool tai::belongsToTai(Operation *op) {
  auto isOurs = [](NamedAttribute attribute) {
    return attribute.getName().strref().starts_with("tai.");
  };
  return isTaiCode(op) || (isa<FunctionOpInterface>(op) &&
                           llvm::any_of(op->getDiscardableAttrs(), isOurs));
}

void tai::forEachNamed(
    Operation *op, SymbolTable &symbols,
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

llvm::SetVector<Operation *> tai::collectLowered(ModuleOp module) {
  SymbolTable symbols(module);
  llvm::SetVector<Operation *> lowered;
  for (Operation &op : *module.getBody())
    if (isTaiCode(&op))
      lowered.insert(&op);
  // The search is repeated until no further callers are found.
  for (bool grown = true; grown;) {
    grown = false;
    for (auto function : module.getOps<func::FuncOp>()) {
      if (lowered.contains(function))
        continue;
      bool calls = false;
      forEachNamed(function, symbols, [&](Operation *named, Operation *user) {
        calls |= lowered.contains(named) && isa<func::FuncOp>(named) &&
                 isa<CallOpInterface>(user);
      });
      grown |= calls && lowered.insert(function);
    }
  }
  return lowered;
}

void tai::addCallees(ModuleOp module, llvm::SetVector<Operation *> &ops) {
  SymbolTable symbols(module);
  for (size_t i = 0; i < ops.size(); ++i)
    forEachNamed(ops[i], symbols, [&](Operation *named, Operation *) {
      if (isa<FunctionOpInterface>(named))
        ops.insert(named);
    });
}

void tai::markLowered(Operation *function) {
  Builder builder(function->getContext());
  StringAttr mark = builder.getStringAttr(kLowered);
  SmallVector<Attribute> entries;
  if (auto others = function->getAttrOfType<ArrayAttr>(kPassthrough))
    llvm::append_range(entries, others);
  if (llvm::is_contained(entries, mark))
    return;
  entries.push_back(mark);
  function->setAttr(kPassthrough, builder.getArrayAttr(entries));
}

void tai::unmarkLowered(Operation *function) {
  auto entries = function->getAttrOfType<ArrayAttr>(kPassthrough);
  if (!entries)
    return;
  Builder builder(function->getContext());
  SmallVector<Attribute> kept(entries.getValue());
  llvm::erase(kept, builder.getStringAttr(kLowered));
  if (kept.empty())
    function->removeAttr(kPassthrough);
  else
    function->setAttr(kPassthrough, builder.getArrayAttr(kept));
}

void tai::walkOwned(Operation *root,
                    llvm::function_ref<void(Operation *)> action) {
  Operation *function = root;
  if (!isa<FunctionOpInterface>(root))
    function = root->getParentOfType<FunctionOpInterface>();
  // If `root` is inside of a function, modules nested there are not entered.
  if (function && !root->hasTrait<OpTrait::SymbolTable>()) {
    if (belongsToTai(function))
      action(root);
    return;
  }
  SmallVector<Operation *> owned;
  root->walk<WalkOrder::PreOrder>([&](FunctionOpInterface nested) {
    if (belongsToTai(nested))
      owned.push_back(nested);
    return WalkResult::skip();
  });
  llvm::for_each(owned, action);
}
