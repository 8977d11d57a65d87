//===- TapeValues.cpp - Derivatives that a tape would lose ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The gradient of a taped program passes through fields. If the host passed a
// number that a kernel returns, or that it reads from a field, to another
// launch, the number would take part in the computation but not in the
// gradient. Stores of the host would also not be undone in the reverse sweep.
//
//===----------------------------------------------------------------------===//

#include "TapeValues.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "mlir/Interfaces/LoopLikeInterface.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class TapeValues {
public:
  TapeValues(Operation *tape, SymbolTableCollection &symbols)
      : tape(tape), symbols(symbols) {}

  LogicalResult verify();

private:
  void collect();
  void addEdges(RegionBranchOpInterface branch);
  void follow();
  void markAll(ValueRange values) {
    for (Value value : values)
      if (active.insert(value).second)
        worklist.push_back(value);
  }
  LogicalResult verifyUses();
  LogicalResult verifyStores();
  FunctionOpInterface lookupCallee(Operation *op) {
    auto call = dyn_cast<CallOpInterface>(op);
    auto name = call ? dyn_cast<SymbolRefAttr>(call.getCallableForCallee())
                     : SymbolRefAttr();
    return name ? symbols.lookupNearestSymbolFrom<FunctionOpInterface>(op, name)
                : FunctionOpInterface();
  }
  FieldOp lookupField(Operation *op) {
    FlatSymbolRefAttr name = getNamedField(op);
    return name ? symbols.lookupNearestSymbolFrom<FieldOp>(op, name)
                : FieldOp();
  }
  const DenseSet<Attribute> &getNames(FlatSymbolRefAttr kernel);

  Operation *tape;
  SymbolTableCollection &symbols;
  /// The tape op, and the functions that are called in the region of the tape.
  llvm::SetVector<Operation *> scopes;
  DenseMap<OpOperand *, SmallVector<Value, 2>> targets;
  DenseMap<Operation *, SmallVector<Operation *>> callers;
  DenseMap<Attribute, DenseSet<Attribute>> namesOf;
  DenseSet<Value> active;
  SmallVector<Value> worklist;
};
} // namespace

static bool isFloatLike(Type type) {
  return isa<FloatType>(getElementTypeOrSelf(type));
}

/// Returns all symbols that a kernel, or a function that it calls, refers to.
const DenseSet<Attribute> &TapeValues::getNames(FlatSymbolRefAttr kernel) {
  auto [it, isNew] = namesOf.try_emplace(kernel);
  if (!isNew)
    return it->second;
  DenseSet<Attribute> names;
  llvm::SetVector<Operation *> pending;
  pending.insert(symbols.lookupNearestSymbolFrom(tape, kernel));
  for (size_t i = 0; i < pending.size(); ++i) {
    if (!pending[i])
      continue;
    for (Region &region : pending[i]->getRegions())
      region.walk([&](Operation *op) {
        if (FunctionOpInterface callee = lookupCallee(op))
          pending.insert(callee);
        op->getAttrDictionary().walk(
            [&](FlatSymbolRefAttr name) { names.insert(name); });
      });
  }
  return namesOf[kernel] = std::move(names);
}

void TapeValues::addEdges(RegionBranchOpInterface branch) {
  auto add = [&](OperandRange operands, ValueRange inputs) {
    if (operands.empty())
      return;
    for (auto [i, input] : llvm::enumerate(inputs))
      targets[operands.getBase() + i].push_back(input);
  };
  SmallVector<RegionSuccessor> successors;
  branch.getSuccessorRegions(RegionBranchPoint::parent(), successors);
  for (RegionSuccessor &successor : successors)
    add(branch.getEntrySuccessorOperands(successor),
        successor.getSuccessorInputs());
  for (Region &region : branch->getRegions())
    for (Block &block : region) {
      auto end =
          block.empty()
              ? RegionBranchTerminatorOpInterface()
              : dyn_cast<RegionBranchTerminatorOpInterface>(block.back());
      if (!end)
        continue;
      successors.clear();
      branch.getSuccessorRegions(RegionBranchPoint(end), successors);
      for (RegionSuccessor &successor : successors)
        add(end.getSuccessorOperands(successor),
            successor.getSuccessorInputs());
    }
}

void TapeValues::collect() {
  scopes.insert(tape);
  for (size_t i = 0; i < scopes.size(); ++i)
    for (Region &region : scopes[i]->getRegions())
      region.walk([&](Operation *op) {
        if (FunctionOpInterface callee = lookupCallee(op);
            callee && !callee.isExternal()) {
          scopes.insert(callee);
          callers[callee].push_back(op);
        } else if (auto branch = dyn_cast<RegionBranchOpInterface>(op)) {
          addEdges(branch);
        } else if (auto load = dyn_cast<LoadOp>(op)) {
          FieldOp field = lookupField(op);
          if (field && field.getAdjointAttr())
            markAll(load->getResults());
        } else if (auto launch = dyn_cast<LaunchOp>(op)) {
          // A kernel that refers to no field with an adjoint returns constants.
          bool isActive =
              llvm::any_of(getNames(launch.getKernelAttr()), [&](Attribute n) {
                auto field = symbols.lookupNearestSymbolFrom<FieldOp>(
                    tape, cast<FlatSymbolRefAttr>(n));
                return field && field.getAdjointAttr();
              });
          for (Value result : launch.getResults())
            if (isActive && isFloatLike(result.getType()))
              markAll(result);
        }
      });
}

/// True for an op through which no derivative passes, because its result does
/// not depend continuously on its operands.
static bool isCut(Operation *op) {
  StringRef name = op->getName().getStringRef();
  return isa<StopGradientOp>(op) || name == "arith.cmpf" ||
         name == "arith.cmpi" || name == "arith.fptosi" ||
         name == "arith.fptoui";
}

void TapeValues::follow() {
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    for (OpOperand &use : value.getUses()) {
      Operation *user = use.getOwner();
      if (auto it = targets.find(&use); it != targets.end())
        markAll(it->second);
      else if (FunctionOpInterface callee = lookupCallee(user);
               callee && !callee.isExternal() &&
               use.getOperandNumber() < callee.getNumArguments())
        markAll(callee.getArgument(use.getOperandNumber()));
      else if (auto it = callers.find(user->getParentOp());
               it != callers.end() && user->hasTrait<OpTrait::ReturnLike>())
        for (Operation *call : it->second)
          markAll(call->getResult(use.getOperandNumber()));
      else if (!isa<LaunchOp>(user) && user->getNumRegions() == 0 &&
               !isCut(user))
        markAll(user->getResults());
    }
  }
}

LogicalResult TapeValues::verifyUses() {
  for (Operation *scope : scopes)
    for (Region &region : scope->getRegions()) {
      WalkResult result = region.walk([&](Operation *op) {
        bool isLaunch = isa<LaunchOp>(op);
        bool isStore = isa<StoreOp, AtomicOp>(op);
        auto effects = dyn_cast<MemoryEffectOpInterface>(op);
        bool isOther = op->getNumRegions() == 0 && effects &&
                       effects.hasEffect<MemoryEffects::Write>() &&
                       !op->hasTrait<OnlyReports>();
        if (!isLaunch && !isStore && !isOther)
          return WalkResult::advance();
        for (Value operand : op->getOperands()) {
          if (!active.contains(operand) || operand.getType().isIndex())
            continue;
          InFlightDiagnostic diag =
              op->emitOpError(isLaunch ? "gets" : "stores")
              << " a number that a taped launch made, through the host: the "
                 "tape would lose its derivative";
          if (Operation *maker = operand.getDefiningOp())
            diag.attachNote(maker->getLoc()) << "made here";
          diag.attachNote()
              << "pass it in a field, from kernel to kernel; or say that it is "
                 "a constant, by 'tai.stop_gradient'";
          return WalkResult::interrupt();
        }
        return WalkResult::advance();
      });
      if (result.wasInterrupted())
        return failure();
    }
  return success();
}

/// True if some loop inside of `tape` contains both ops.
static bool shareLoop(Operation *lhs, Operation *rhs, Operation *tape) {
  for (Operation *loop = lhs->getParentOp(); loop && loop != tape;
       loop = loop->getParentOp())
    if (isa<LoopLikeOpInterface>(loop) && loop->isProperAncestor(rhs))
      return true;
  return false;
}

/// Rejects stores of the host to a field after a launch of the tape has
/// accessed it. An earlier store is allowed, because it could as well be made
/// before the tape.
LogicalResult TapeValues::verifyStores() {
  for (Operation *scope : scopes)
    for (Region &region : scope->getRegions()) {
      SmallVector<LaunchOp> launches;
      region.walk([&](LaunchOp launch) { launches.push_back(launch); });
      WalkResult result = region.walk([&](Operation *op) {
        auto access = dyn_cast<FieldAccessOpInterface>(op);
        if (!access || !access.isElementAccess() || !access.writesField())
          return WalkResult::advance();
        FlatSymbolRefAttr name = access.getFieldAttr();
        bool isLate = scope != tape;
        for (LaunchOp launch : launches) {
          if (!getNames(launch.getKernelAttr()).contains(name))
            continue;
          // An op can run after another op if it comes later in their common
          // block, or if both are in a loop.
          Operation *common =
              region.findAncestorOpInRegion(*launch.getOperation());
          Operation *own = region.findAncestorOpInRegion(*op);
          isLate |= shareLoop(op, launch, tape) ||
                    (common == own ? true : common->isBeforeInBlock(own));
        }
        if (!isLate)
          return WalkResult::advance();
        op->emitOpError("changes '@")
                .append(name.getValue(),
                        "' between launches of a tape, which does not record "
                        "what the host stores")
                .attachNote(tape->getLoc())
            << "store it before the tape, or in a kernel that is launched here";
        return WalkResult::interrupt();
      });
      if (result.wasInterrupted())
        return failure();
    }
  return success();
}

LogicalResult TapeValues::verify() {
  collect();
  follow();
  if (failed(verifyUses()))
    return failure();
  return verifyStores();
}

LogicalResult mlir::tai::verifyTapeValues(Operation *tape,
                                          SymbolTableCollection &symbols) {
  return TapeValues(tape, symbols).verify();
}
