//===- EliminateLocals.cpp - Mutable locals to SSA values -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Store-to-load forwarding in one walk in program order, which tracks the
// current value of every variable. An op with regions that writes variables of
// the enclosing scope is rebuilt with their values as additional results (and,
// for loops, as carried values). Upstream's mem2reg does not cross regions.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Transforms/Passes.h"
#include "llvm/ADT/SetVector.h"

namespace mlir::tai {
#define GEN_PASS_DEF_ELIMINATELOCALS
#include "tai/Transforms/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// Local variables in the order in which they are made, so that results of new
/// ops come in a fixed order.
using Locals = llvm::SetVector<Value>;

/// True if the pass can follow a local variable into the regions of `op`.
static bool canCross(Operation *op) {
  return isa<scf::IfOp, scf::ForOp, scf::WhileOp>(op);
}

/// Checks every use of a local variable before anything changes.
static LogicalResult checkUses(AllocaOp alloca) {
  for (Operation *user : alloca->getUsers()) {
    if (!isa<LocalLoadOp, LocalStoreOp>(user))
      return user->emitError("uses a local variable in a way that cannot be "
                             "turned into values");
    for (Operation *parent = user->getParentOp();
         parent != alloca->getParentOp(); parent = parent->getParentOp()) {
      if (canCross(parent))
        continue;
      InFlightDiagnostic diag = user->emitError()
                                << "a local variable cannot be used across '"
                                << parent->getName() << "'";
      diag.attachNote(alloca.getLoc()) << "the variable is made here";
      if (isa<ParallelForOp, scf::ParallelOp>(parent))
        diag.attachNote(parent->getLoc())
            << "the iterations of this loop may run at the same time; sum into "
               "a field with 'tai.atomic add', or make the variable inside the "
               "loop";
      return diag;
    }
  }
  return success();
}

namespace {
class Eliminator {
public:
  explicit Eliminator(MLIRContext *context) : builder(context) {}

  /// Replaces the local variables `allocas`, which are inside of `root`, by SSA
  /// values.
  void run(Operation *root, ArrayRef<AllocaOp> allocas) {
    for (AllocaOp alloca : allocas)
      for (Operation *user : alloca->getUsers())
        if (isa<LocalStoreOp>(user))
          for (Operation *parent = user->getParentOp();
               parent != alloca->getParentOp(); parent = parent->getParentOp())
            written[parent].insert(alloca.getLocal());
    for (Region &region : root->getRegions())
      for (Block &block : region)
        visit(block);
    for (Operation *op : llvm::reverse(dead))
      op->erase();
  }

private:
  Value getZero(Value local) {
    Type type = cast<LocalType>(local.getType()).getElementType();
    return arith::ConstantOp::create(builder, local.getLoc(),
                                     builder.getZeroAttr(type));
  }

  SmallVector<Value> getAll(const Locals &locals) {
    return llvm::map_to_vector(locals, [&](Value v) { return current[v]; });
  }

  void setAll(const Locals &locals, ValueRange values) {
    for (auto [local, value] : llvm::zip(locals, values))
      current[local] = value;
  }

  void visit(Block &block) {
    for (Operation &op : llvm::make_early_inc_range(block))
      visit(&op);
  }

  void visit(Operation *op) {
    if (auto alloca = dyn_cast<AllocaOp>(op)) {
      builder.setInsertionPoint(op);
      current[alloca.getLocal()] = getZero(alloca.getLocal());
      dead.push_back(op);
    } else if (auto load = dyn_cast<LocalLoadOp>(op)) {
      load.getValue().replaceAllUsesWith(current[load.getLocal()]);
      dead.push_back(op);
    } else if (auto store = dyn_cast<LocalStoreOp>(op)) {
      current[store.getLocal()] = store.getValue();
      dead.push_back(op);
    } else if (auto it = written.find(op); it != written.end()) {
      Locals locals = it->second;
      llvm::TypeSwitch<Operation *>(op)
          .Case<scf::IfOp, scf::ForOp, scf::WhileOp>(
              [&](auto op) { extend(op, locals); });
    } else {
      for (Region &region : op->getRegions())
        for (Block &nested : region)
          visit(nested);
    }
  }

  static SmallVector<Type> getTypes(TypeRange types, const Locals &locals) {
    SmallVector<Type> all(types);
    for (Value local : locals)
      all.push_back(cast<LocalType>(local.getType()).getElementType());
    return all;
  }

  /// Replaces `op` by `larger`, whose last results are the values of `locals`.
  void replace(Operation *op, Operation *larger, const Locals &locals) {
    op->replaceAllUsesWith(
        larger->getResults().take_front(op->getNumResults()));
    larger->setDiscardableAttrs(op->getDiscardableAttrDictionary());
    op->erase();
    setAll(locals, larger->getResults().take_back(locals.size()));
  }

  /// Visits `block` with the values `before` of the locals, and lets its
  /// terminator pass on their values at the end of the block.
  void visitAndPass(Block &block, const Locals &locals, ValueRange before) {
    setAll(locals, before);
    visit(block);
    block.getTerminator()->insertOperands(
        block.getTerminator()->getNumOperands(), getAll(locals));
  }

  void extend(scf::IfOp op, const Locals &locals) {
    builder.setInsertionPoint(op);
    auto larger = scf::IfOp::create(
        builder, op.getLoc(), getTypes(op.getResultTypes(), locals),
        op.getCondition(), /*addThenBlock=*/false, /*addElseBlock=*/false);
    SmallVector<Value> before = getAll(locals);
    for (auto [from, to] : llvm::zip(op->getRegions(), larger->getRegions())) {
      to.takeBody(from);
      if (to.empty()) {
        OpBuilder::InsertionGuard guard(builder);
        builder.createBlock(&to);
        scf::YieldOp::create(builder, op.getLoc());
      }
      visitAndPass(to.front(), locals, before);
    }
    replace(op, larger, locals);
  }

  void extend(scf::ForOp op, const Locals &locals) {
    builder.setInsertionPoint(op);
    SmallVector<Value> inits(op.getInitArgs());
    llvm::append_range(inits, getAll(locals));
    auto larger = scf::ForOp::create(
        builder, op.getLoc(), op.getLowerBound(), op.getUpperBound(),
        op.getStep(), inits, /*bodyBuilder=*/nullptr, op.getUnsignedCmp());
    larger.getRegion().takeBody(op.getRegion());
    Block *body = larger.getBody();
    visitAndPass(*body, locals, addArguments(*body, locals));
    replace(op, larger, locals);
  }

  void extend(scf::WhileOp op, const Locals &locals) {
    builder.setInsertionPoint(op);
    SmallVector<Value> inits(op.getInits());
    llvm::append_range(inits, getAll(locals));
    auto larger = scf::WhileOp::create(
        builder, op.getLoc(), getTypes(op.getResultTypes(), locals), inits);
    larger.getBefore().takeBody(op.getBefore());
    larger.getAfter().takeBody(op.getAfter());
    for (Block *block : {larger.getBeforeBody(), larger.getAfterBody()})
      visitAndPass(*block, locals, addArguments(*block, locals));
    replace(op, larger, locals);
  }

  SmallVector<Value> addArguments(Block &block, const Locals &locals) {
    return llvm::map_to_vector(locals, [&](Value local) -> Value {
      return block.addArgument(
          cast<LocalType>(local.getType()).getElementType(), local.getLoc());
    });
  }

  OpBuilder builder;
  DenseMap<Value, Value> current;
  /// For an op with regions, the local variables from outside that its regions
  /// write.
  DenseMap<Operation *, Locals> written;
  SmallVector<Operation *> dead;
};

struct EliminateLocals : tai::impl::EliminateLocalsBase<EliminateLocals> {
  using Base::Base;

  void runOnOperation() override {
    SmallVector<AllocaOp> allocas;
    bool failedAny = false;
    getOperation()->walk([&](AllocaOp alloca) {
      failedAny |= failed(checkUses(alloca));
      allocas.push_back(alloca);
    });
    if (failedAny)
      return signalPassFailure();
    if (allocas.empty())
      return markAllAnalysesPreserved();
    Eliminator(&getContext()).run(getOperation(), allocas);
  }
};
} // namespace
