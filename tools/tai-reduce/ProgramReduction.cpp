//===- ProgramReduction.cpp - Smaller programs that still fail ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Upstream's reductions erase ranges of ops in a region, and keep ops that are
// used by other ops. The edits here take a program of tai apart: kernels with
// their launches, loops with their trips, layouts with their levels and places.
//
// Each edit is tried on a copy of the module. The copy replaces the module if
// it verifies and the test says that it still fails, until no edit is left.
//
//===----------------------------------------------------------------------===//

#include "ProgramReduction.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/AttrTypeSubElements.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/IR/Verifier.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "mlir/Pass/Pass.h"
#include "mlir/Reducer/Tester.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The type of functions that apply candidate number `number` of an edit to the
/// module. False if there are fewer candidates.
using Edit = bool (*)(ModuleOp module, size_t number);

/// Replaces the results of an op by zeroes and erases it. False if a result has
/// a type without a zero.
bool eraseWithZeros(Operation *op) {
  OpBuilder builder(op);
  for (Value result : op->getResults()) {
    if (result.use_empty())
      continue;
    // An operand with the type of the result makes a smaller program than a
    // constant.
    Value same;
    for (Value operand : op->getOperands())
      if (operand.getType() == result.getType())
        same = operand;
    if (same) {
      result.replaceAllUsesWith(same);
      continue;
    }
    TypedAttr zero = builder.getZeroAttr(result.getType());
    if (!zero)
      return false;
    result.replaceAllUsesWith(
        arith::ConstantOp::create(builder, op->getLoc(), zero));
  }
  op->erase();
  return true;
}

/// Drops a kernel, function, field or tree, with all ops that name it.
bool dropSymbol(ModuleOp module, size_t number) {
  SmallVector<Operation *> symbols;
  for (Operation &op : *module.getBody())
    if (isa<SymbolOpInterface>(op))
      symbols.push_back(&op);
  if (number >= symbols.size())
    return false;
  Operation *symbol = symbols[number];
  StringAttr name = cast<SymbolOpInterface>(symbol).getNameAttr();
  SmallVector<Operation *> users;
  if (auto uses = SymbolTable::getSymbolUses(name, module))
    for (const SymbolTable::SymbolUse &use : *uses)
      if (!is_contained(users, use.getUser()) &&
          !symbol->isAncestor(use.getUser()))
        users.push_back(use.getUser());
  symbol->erase();
  for (Operation *user : users) {
    if (isa<LaunchOp, FieldAccessOpInterface>(user)) {
      eraseWithZeros(user);
      continue;
    }
    // Fields and kernels name the symbols that hold their derivatives.
    for (StringRef attribute : {"adjoint", "dual", "tangent", "stored_form"})
      if (user->getAttr(attribute) == FlatSymbolRefAttr::get(name))
        user->removeAttr(attribute);
  }
  return true;
}

/// Lists the ops in the bodies of functions, the last op first: users of an op
/// come before the op.
SmallVector<Operation *> collectBodies(ModuleOp module) {
  SmallVector<Operation *> ops;
  module.walk([&](Operation *op) {
    if (op != module && op->getParentOp() != module &&
        !op->hasTrait<OpTrait::IsTerminator>() &&
        op->getParentOfType<FunctionOpInterface>())
      ops.push_back(op);
  });
  std::reverse(ops.begin(), ops.end());
  return ops;
}

/// Drops an op from the body of a function; ops with regions have the first
/// numbers.
bool dropOp(ModuleOp module, size_t number) {
  SmallVector<Operation *> ops;
  SmallVector<Operation *> all = collectBodies(module);
  for (bool holdsRegions : {true, false})
    for (Operation *op : all)
      if ((op->getNumRegions() != 0) == holdsRegions)
        ops.push_back(op);
  if (number >= ops.size())
    return false;
  Operation *op = ops[number];
  // A constant in use stays: it would only be replaced by another constant.
  if (!op->hasTrait<OpTrait::ConstantLike>() || op->use_empty())
    eraseWithZeros(op);
  return true;
}

/// Replaces `op` by the ops of a block, and its results by the block's results.
void inlineBlock(Operation *op, Block &block, ValueRange arguments) {
  for (auto [argument, value] : llvm::zip(block.getArguments(), arguments))
    argument.replaceAllUsesWith(value);
  Operation *end = block.getTerminator();
  SmallVector<Value> results(end->getOperands());
  end->erase();
  op->getBlock()->getOperations().splice(op->getIterator(),
                                         block.getOperations());
  if (results.size() == op->getNumResults())
    op->replaceAllUsesWith(results);
  eraseWithZeros(op);
}

/// Replaces a loop or a branch by its body; induction variables get their
/// values in the first iteration.
bool inlineBody(ModuleOp module, size_t number) {
  SmallVector<std::pair<Operation *, unsigned>> bodies;
  for (Operation *op : collectBodies(module)) {
    if (isa<scf::IfOp>(op)) {
      for (auto [i, region] : llvm::enumerate(op->getRegions()))
        if (!region.empty())
          bodies.push_back({op, i});
    } else if (isa<scf::ForOp, ParallelForOp>(op)) {
      bodies.push_back({op, 0});
    }
  }
  if (number >= bodies.size())
    return false;
  auto [op, region] = bodies[number];
  OpBuilder builder(op);
  SmallVector<Value> arguments;
  if (auto loop = dyn_cast<scf::ForOp>(op)) {
    arguments.push_back(loop.getLowerBound());
    llvm::append_range(arguments, loop.getInits());
  } else if (auto loop = dyn_cast<ParallelForOp>(op)) {
    arguments.assign(loop.getLowerBounds().begin(),
                     loop.getLowerBounds().end());
    while (arguments.size() < loop.getInductionVars().size())
      arguments.push_back(
          arith::ConstantIndexOp::create(builder, op->getLoc(), 0));
  }
  inlineBlock(op, op->getRegion(region).front(), arguments);
  return true;
}

/// Reduces a loop to one trip along one dimension.
bool cutTrips(ModuleOp module, size_t number) {
  SmallVector<OpOperand *> bounds;
  for (Operation *op : collectBodies(module)) {
    if (auto loop = dyn_cast<scf::ForOp>(op))
      bounds.push_back(&loop.getUpperBoundMutable());
    else if (auto loop = dyn_cast<ParallelForOp>(op))
      for (OpOperand &bound : loop.getUpperBoundsMutable())
        bounds.push_back(&bound);
  }
  if (number >= bounds.size())
    return false;
  OpOperand *bound = bounds[number];
  Operation *op = bound->getOwner();
  Value lower;
  if (auto loop = dyn_cast<scf::ForOp>(op))
    lower = loop.getLowerBound();
  else
    lower =
        cast<ParallelForOp>(op)
            .getLowerBounds()[bound->getOperandNumber() -
                              cast<ParallelForOp>(op).getLowerBounds().size()];
  APInt first, end;
  OpBuilder builder(op);
  if (matchPattern(lower, m_ConstantInt(&first))) {
    // One trip already.
    if (matchPattern(bound->get(), m_ConstantInt(&end)) && end == first + 1)
      return true;
    bound->set(arith::ConstantOp::create(
        builder, op->getLoc(),
        builder.getIntegerAttr(lower.getType(), first + 1)));
    return true;
  }
  Value one = arith::ConstantOp::create(
      builder, op->getLoc(), builder.getIntegerAttr(lower.getType(), 1));
  bound->set(arith::AddIOp::create(builder, op->getLoc(), lower, one));
  return true;
}

/// The levels and records of the layouts of a module, in a fixed order.
SmallVector<std::pair<TreeOp, Type>> collectLevels(ModuleOp module) {
  SmallVector<std::pair<TreeOp, Type>> levels;
  for (TreeOp tree : module.getOps<TreeOp>())
    tree.getLayout().walk([&](Type type) {
      if (isa<SNodeTypeInterface, PlacesType>(type))
        levels.push_back({tree, type});
    });
  return levels;
}

/// Replaces the type of a level by another one in the layout of a tree.
void replaceLevel(TreeOp tree, Type level, Type other) {
  AttrTypeReplacer replacer;
  replacer.addReplacement([&](Type type) -> std::optional<Type> {
    if (type == level)
      return other;
    return std::nullopt;
  });
  if (Type layout = replacer.replace(tree.getLayout()))
    tree.setLayoutAttr(TypeAttr::get(layout));
}

/// Takes a level with one child out of a layout.
bool dropLevel(ModuleOp module, size_t number) {
  auto levels = collectLevels(module);
  if (number >= levels.size())
    return false;
  auto [tree, type] = levels[number];
  auto level = dyn_cast<SNodeTypeInterface>(type);
  if (level && level.getChildren().size() == 1)
    replaceLevel(tree, type, level.getChildren().front());
  return true;
}

/// Makes a sparse level dense.
bool makeDense(ModuleOp module, size_t number) {
  auto levels = collectLevels(module);
  if (number >= levels.size())
    return false;
  auto [tree, type] = levels[number];
  auto level = dyn_cast<SNodeTypeInterface>(type);
  if (level && !isa<DenseType>(type))
    replaceLevel(tree, type,
                 DenseType::get(module.getContext(), level.getAxes(),
                                level.getShape(), level.getChildren()));
  return true;
}

/// The level with these extents; null for a kind of level that the tool does
/// not support.
Type resize(Type level, ArrayRef<int64_t> shape) {
  return llvm::TypeSwitch<Type, Type>(level)
      .Case<DenseType, PointerType, BitmaskedType, HashType>([&](auto own) {
        return decltype(own)::get(own.getContext(), own.getAxes(), shape,
                                  own.getChildren());
      })
      .Default(Type());
}

/// Leaves at most two cells along each axis of a level.
bool shrinkLevel(ModuleOp module, size_t number) {
  auto levels = collectLevels(module);
  if (number >= levels.size())
    return false;
  auto level = dyn_cast<SNodeTypeInterface>(levels[number].second);
  if (!level)
    return true;
  SmallVector<int64_t> shape;
  for (int64_t extent : level.getShape())
    shape.push_back(std::min<int64_t>(extent, 2));
  if (Type smaller = resize(level, shape))
    replaceLevel(levels[number].first, level, smaller);
  return true;
}

/// Returns the list without the element at `index`.
template <typename T> SmallVector<T> without(ArrayRef<T> list, size_t index) {
  SmallVector<T> rest(list);
  rest.erase(rest.begin() + index);
  return rest;
}

/// Drops a child of a root, or a place of a record.
bool dropChild(ModuleOp module, size_t number) {
  struct Child {
    TreeOp tree;
    Type parent;
    size_t index;
  };
  SmallVector<Child> children;
  for (TreeOp tree : module.getOps<TreeOp>())
    tree.getLayout().walk([&](Type type) {
      size_t count = 0;
      if (auto places = dyn_cast<PlacesType>(type))
        count = places.getTypes().size();
      else if (auto root = dyn_cast<RootType>(type))
        count = root.getChildren().size();
      for (size_t i = 0; count > 1 && i != count; ++i)
        children.push_back({tree, type, i});
    });
  if (number >= children.size())
    return false;
  Child child = children[number];
  MLIRContext *context = module.getContext();
  if (auto places = dyn_cast<PlacesType>(child.parent))
    replaceLevel(child.tree, places,
                 PlacesType::get(context,
                                 without(places.getNames(), child.index),
                                 without(places.getTypes(), child.index)));
  else
    child.tree.setLayoutAttr(TypeAttr::get(RootType::get(
        context,
        without(cast<RootType>(child.parent).getChildren(), child.index))));
  return true;
}

/// Drops an argument that its function does not use.
bool dropArgument(ModuleOp module, size_t number) {
  SmallVector<std::pair<FunctionOpInterface, unsigned>> arguments;
  for (auto function : module.getOps<FunctionOpInterface>())
    for (unsigned i = 0, end = function.getNumArguments(); i != end; ++i)
      arguments.push_back({function, i});
  if (number >= arguments.size())
    return false;
  auto [function, index] = arguments[number];
  if (function.isExternal() || !function.getArgument(index).use_empty())
    return true;
  // If a caller still passes the argument, the module does not verify, and the
  // edit is rejected.
  (void)function.eraseArgument(index);
  return true;
}

/// Removes an attribute that the verifier can do without.
bool dropAttribute(ModuleOp module, size_t number) {
  SmallVector<std::pair<Operation *, StringAttr>> attributes;
  module.walk([&](Operation *op) {
    if (op != module)
      for (NamedAttribute attribute : op->getDiscardableAttrs())
        attributes.push_back({op, attribute.getName()});
  });
  if (number >= attributes.size())
    return false;
  attributes[number].first->removeDiscardableAttr(attributes[number].second);
  return true;
}

struct ProgramReduction
    : PassWrapper<ProgramReduction, OperationPass<ModuleOp>> {
  MLIR_DEFINE_EXPLICIT_INTERNAL_INLINE_TYPE_ID(ProgramReduction)

  ProgramReduction() = default;
  ProgramReduction(const ProgramReduction &other) : PassWrapper(other) {}

  StringRef getArgument() const final { return "tai-reduction"; }
  StringRef getDescription() const final {
    return "Drop kernels, fields, ops, loop trips and levels of layouts while "
           "a test fails";
  }
  void getDependentDialects(DialectRegistry &registry) const override {
    registry.insert<arith::ArithDialect, TaiDialect>();
  }

  void runOnOperation() override {
    Tester tester(test, {});
    if (tester.isInteresting(getOperation()).first !=
        Tester::Interestingness::True) {
      getOperation()->emitError("the test does not find what it looks for in "
                                "the input");
      return signalPassFailure();
    }
    std::string text;
    llvm::raw_string_ostream os(text);
    getOperation().print(os);
    seen.insert(text);
    // The edits of the reduction; those that remove most come first.
    constexpr Edit edits[] = {dropSymbol,   dropOp,       inlineBody,
                              cutTrips,     dropOp,       dropLevel,
                              makeDense,    dropChild,    shrinkLevel,
                              dropArgument, dropAttribute};
    for (bool changed = true; changed;) {
      changed = false;
      for (Edit edit : edits)
        changed |= tryAll(edit, tester);
    }
  }

private:
  /// Applies all candidates of an edit that keep the program interesting.
  bool tryAll(Edit edit, const Tester &tester) {
    bool changed = false;
    for (size_t number = 0;;) {
      OwningOpRef<ModuleOp> copy = getOperation().clone();
      if (!edit(*copy, number))
        return changed;
      if (isInteresting(*copy, tester)) {
        getOperation()->getRegion(0).takeBody(copy->getBodyRegion());
        getOperation()->setAttrs(copy->getOperation()->getAttrDictionary());
        changed = true;
        continue;
      }
      ++number;
    }
  }

  /// True if the program is new, verifies, and still fails the test.
  bool isInteresting(ModuleOp copy, const Tester &tester) {
    ScopedDiagnosticHandler silence(&getContext(),
                                    [](Diagnostic &) { return success(); });
    if (failed(verify(copy)))
      return false;
    std::string text;
    llvm::raw_string_ostream os(text);
    copy.print(os);
    return seen.insert(text).second &&
           tester.isInteresting(copy).first == Tester::Interestingness::True;
  }

  llvm::StringSet<> seen;

  Option<std::string> test{*this, "test",
                           llvm::cl::desc("The script that ends with 1 if the "
                                          "program is still of interest")};
};
} // namespace

void tai::registerProgramReduction() { PassRegistration<ProgramReduction>(); }
