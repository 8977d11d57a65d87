//===- HostFunction.cpp - Host programs become functions ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A `func.func` that runs on the host becomes `i32 @name(ptr frame)`, with
// calls of the runtime for launches, tapes and checks. A failed launch makes
// the runtime skip those that follow, so the code needs no early exits.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/Conversion/Passes.h"
#include "tai/Conversion/TaiToHost/Lowering.h"
#include "tai/Dialect/Check/IR/Check.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

static LogicalResult lowerLaunch(LaunchOp op, Value frame,
                                 RuntimeCalls &runtime) {
  OpBuilder builder(op);
  Location loc = op.getLoc();
  int64_t numArgs = 0, numResults = 0;
  for (Type type : op.getOperandTypes()) {
    if (isa<MemRefType>(type))
      return op.emitOpError("passes an array, which host programs have not");
    numArgs += getNumSlots(type);
  }
  for (Type type : op.getResultTypes())
    numResults += getNumSlots(type);

  Value args = numArgs ? emitStackSlots(builder, loc, numArgs)
                       : runtime.null(builder, loc);
  int64_t next = 0;
  for (Value operand : op.getOperands()) {
    SmallVector<Value> components{operand};
    if (isa<VectorType>(operand.getType())) {
      auto parts = operand.getDefiningOp<vector::FromElementsOp>();
      if (!parts)
        return op.emitOpError("passes ")
               << operand.getType()
               << "; expects its components, as tai-scalarize makes them";
      components.assign(parts.getElements().begin(), parts.getElements().end());
    }
    for (Value component : components)
      emitSlotStore(builder, loc, component,
                    emitSlot(builder, loc, args, next++));
  }
  Value results = numResults ? emitStackSlots(builder, loc, numResults)
                             : runtime.null(builder, loc);
  Value name = runtime.string(builder, loc, op.getKernel());
  runtime.tai_rt_host_launch(builder, loc, frame, name, args,
                             runtime.i64(builder, loc, numArgs), results,
                             runtime.i64(builder, loc, numResults));
  next = 0;
  for (Value result : op.getResults()) {
    auto vector = dyn_cast<VectorType>(result.getType());
    if (!vector) {
      result.replaceAllUsesWith(
          emitSlotLoad(builder, loc, result.getType(),
                       emitSlot(builder, loc, results, next++)));
      continue;
    }
    SmallVector<Value> components;
    for (int64_t i = 0; i != vector.getNumElements(); ++i)
      components.push_back(
          emitSlotLoad(builder, loc, vector.getElementType(),
                       emitSlot(builder, loc, results, next++)));
    for (Operation *user : llvm::make_early_inc_range(result.getUsers())) {
      if (!isa<vector::ToElementsOp>(user))
        return user->emitOpError("uses ")
               << vector << "; expects scalars, as tai-scalarize makes them";
      user->replaceAllUsesWith(components);
      user->erase();
    }
  }
  op.erase();
  return success();
}

/// Lowers a tape to a call of tape_begin, the launches and a call of tape_end.
static void lowerTape(TapeOp op, Value frame, RuntimeCalls &runtime) {
  OpBuilder builder(op);
  Location loc = op.getLoc();
  Value loss = runtime.string(builder, loc, op.getLoss());
  runtime.tai_rt_host_tape_begin(builder, loc, frame, loss);
  if (CheckpointAttr checkpoint = op.getCheckpointAttr())
    runtime.tai_rt_host_tape_checkpoint(
        builder, loc, frame,
        runtime.i32(builder, loc, static_cast<int32_t>(checkpoint.getKind())),
        runtime.i64(builder, loc, checkpoint.getSnapshots()),
        runtime.i64(builder, loc, checkpoint.getBudget()));
  Block &body = op.getBody().front();
  body.getTerminator()->erase();
  op->getBlock()->getOperations().splice(op->getIterator(),
                                         body.getOperations());
  runtime.tai_rt_host_tape_end(builder, loc, frame);
  op.erase();
}

/// Emits a check that |actual - expected| <= tolerance * max(1, |expected|),
/// written so that it fails for NaN.
static void lowerCheckClose(CheckCloseOp op, Value frame,
                            RuntimeCalls &runtime) {
  OpBuilder builder(op);
  Location loc = op.getLoc();
  Type f64 = builder.getF64Type();
  auto toDouble = [&](Value value) -> Value {
    if (value.getType() == f64)
      return value;
    return arith::ExtFOp::create(builder, loc, f64, value);
  };
  auto constant = [&](double value) -> Value {
    return arith::ConstantOp::create(builder, loc,
                                     builder.getF64FloatAttr(value));
  };
  double tolerance = op.getTolerance().convertToDouble();
  Value actual = toDouble(op.getActual()),
        expected = toDouble(op.getExpected());
  Value difference = math::AbsFOp::create(
      builder, loc, arith::SubFOp::create(builder, loc, actual, expected));
  Value scale = arith::MaximumFOp::create(
      builder, loc, constant(1), math::AbsFOp::create(builder, loc, expected));
  Value allowed =
      arith::MulFOp::create(builder, loc, constant(tolerance), scale);
  // The predicate is unordered or greater, so that a NaN on either side is a
  // failure.
  Value wrong = arith::CmpFOp::create(builder, loc, arith::CmpFPredicate::UGT,
                                      difference, allowed);
  auto branch = scf::IfOp::create(builder, loc, wrong);
  OpBuilder inside = branch.getThenBodyBuilder();
  Value shown =
      arith::ConstantOp::create(inside, loc, inside.getF64FloatAttr(tolerance));
  emitFail(runtime, inside, loc, frame, TAI_FAIL_CHECK,
           "check failed: got {}, expected {} within {}",
           {actual, expected, shown}, {});
  op.erase();
}

/// Moves the launches into a function, which the runtime calls as often as the
/// finite differences require.
static LogicalResult lowerCheckGradient(CheckGradientOp op, StringRef name,
                                        Value frame, ModuleLowering &lowering) {
  OpBuilder builder(op);
  Location loc = op.getLoc();
  RuntimeCalls &runtime = lowering.runtime;
  Type pointer = runtime.getPointerType(), i32 = builder.getI32Type();
  auto region = createFunction(lowering.module, loc, name, i32,
                               {pointer, pointer}, /*isInternal=*/true);
  Block *entry = &region.getBody().front();
  Block &body = op.getBody().front();
  body.getTerminator()->erase();
  entry->getOperations().splice(entry->end(), body.getOperations());
  Closure closure(region, frame, op);
  if (failed(closure.capture(region.getBody())))
    return failure();
  OpBuilder inside = OpBuilder::atBlockEnd(entry);
  Value status = runtime.tai_rt_failed(inside, loc, region.getArgument(0));
  LLVM::ReturnOp::create(inside, loc, status);

  int64_t count = op.getWrt().size();
  Value names = emitStackSlots(builder, loc, count);
  for (auto [i, field] : llvm::enumerate(op.getWrt()))
    emitSlotStore(
        builder, loc,
        runtime.string(builder, loc, cast<FlatSymbolRefAttr>(field).getValue()),
        emitSlot(builder, loc, names, i));
  Value loss = runtime.string(builder, loc, op.getLoss());
  Value tolerance =
      arith::ConstantOp::create(builder, loc, op.getToleranceAttr());
  Value address = LLVM::AddressOfOp::create(builder, loc, region);
  Value where = runtime.string(builder, loc, describePlace(loc));
  runtime.tai_rt_host_check_gradient(
      builder, loc, frame, loss, names, runtime.i64(builder, loc, count),
      tolerance, address, closure.emit(runtime), where);
  op.erase();
  return success();
}

LogicalResult tai::lowerHostFunction(func::FuncOp function,
                                     ModuleLowering &lowering) {
  if (function.isPrivate()) {
    // A private function is a helper, which must have been inlined into its
    // callers.
    auto uses = SymbolTable::getSymbolUses(function, lowering.module);
    if (uses && uses->empty()) {
      function.erase();
      return success();
    }
    if (uses) {
      // Among the remaining calls of the helper, a recursive call is reported
      // if there is one, rather than a call from outside.
      Operation *user = uses->begin()->getUser();
      for (SymbolTable::SymbolUse use : *uses)
        if (function->isProperAncestor(use.getUser()))
          user = use.getUser();
      InFlightDiagnostic diag = user->emitOpError("calls '")
                                << function.getSymName()
                                << "', which cannot be inlined; ";
      if (function->isProperAncestor(user))
        return diag << "helpers cannot call themselves";
      if (!function.isExternal()) {
        diag << "helpers have one block, and do not call themselves";
        diag.attachNote(function.getLoc())
            << "defined here; control flow of a helper stands in 'scf', to "
               "which 'lift-cf-to-scf' brings it";
        return diag;
      }
      diag << "it has no body here";
      diag.attachNote(function.getLoc())
          << "declared here; give it a body, or call it by 'llvm.call'";
      return diag;
    }
  }

  Location loc = function.getLoc();
  RuntimeCalls &runtime = lowering.runtime;
  std::string name = getEntryPointName(function.getSymName());
  auto type = IntegerType::get(function.getContext(), 32);
  auto host = createFunction(lowering.module, loc, name, type,
                             {runtime.getPointerType()}, /*isInternal=*/false);
  Block *entry = &host.getBody().front();
  Value frame = entry->getArgument(0);
  if (!function.getBody().hasOneBlock())
    return function.emitOpError("expects one block: control flow of a host "
                                "program stands in 'scf'");
  Block &body = function.getBody().front();
  OpBuilder builder = OpBuilder::atBlockEnd(entry);
  if (failed(replaceArguments(function, frame, builder, runtime)))
    return failure();
  entry->getOperations().splice(entry->end(), body.getOperations());
  Operation *ret = entry->getTerminator();
  replaceReturn(ret, loc, frame, builder, runtime);

  upgradeFormerChecks(host);
  // Leaf ops are lowered first, while the program is one function: addresses
  // and locals are then pointers, which the functions split off below can
  // capture.
  if (failed(lowerLeafOps(host, lowering)))
    return failure();
  SmallVector<Operation *> ops;
  host.walk([&](Operation *op) {
    if (isa<LaunchOp, TapeOp, CheckGradientOp, CheckCloseOp, RandomOp,
            ParallelForOp, func::CallOp>(op))
      ops.push_back(op);
  });
  // Inner ops are lowered first: the walk above collected the ops in
  // post-order.
  unsigned numRegions = 0;
  for (Operation *op : ops) {
    LogicalResult result =
        llvm::TypeSwitch<Operation *, LogicalResult>(op)
            .Case([&](LaunchOp launch) {
              return lowerLaunch(launch, frame, runtime);
            })
            .Case([&](TapeOp tape) {
              lowerTape(tape, frame, runtime);
              return success();
            })
            .Case([&](CheckGradientOp check) -> LogicalResult {
              std::string region =
                  (name + ".check" + llvm::Twine(numRegions++)).str();
              return lowerCheckGradient(check, region, frame, lowering);
            })
            .Case([&](CheckCloseOp check) {
              lowerCheckClose(check, frame, runtime);
              return success();
            })
            .Default([](Operation *other) {
              return other->emitOpError("cannot run on the host");
            });
    if (failed(result))
      return failure();
  }

  builder.setInsertionPointToEnd(entry);
  Value status = runtime.tai_rt_failed(builder, loc, frame);
  LLVM::ReturnOp::create(builder, loc, status);
  function.erase();
  return success();
}
