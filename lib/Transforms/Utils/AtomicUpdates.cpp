//===- AtomicUpdates.cpp - Read-modify-write of memory --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Transforms/Utils/AtomicUpdates.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult tai::checkOrderIsFixed(ParallelForOp loop) {
  // A loop that a warp runs together is skipped, because its additions are put
  // in order when the loop is lowered.
  if (!loop.getOrder() || loop.getSerialize() || loop.getInWarp())
    return success();
  WalkResult result = loop.walk([&](LLVM::AtomicRMWOp update) {
    bool isSum = update.getBinOp() == LLVM::AtomicBinOp::fadd ||
                 update.getBinOp() == LLVM::AtomicBinOp::fsub;
    // Updates of memory that an iteration allocates are skipped, since no other
    // iteration shares this memory.
    Value memory = update.getPtr();
    while (auto element = memory.getDefiningOp<LLVM::GEPOp>())
      memory = element.getBase();
    if (!isSum || isDoneByLoop(update) || !loop.isDefinedOutsideOfLoop(memory))
      return WalkResult::advance();
    update->emitError("the order of these additions is not fixed, as that of "
                      "the loop is; expects tai-relax-atomics to run before, "
                      "and no pass in between to drop '")
        << kAccumulateAttrName << "'";
    return WalkResult::interrupt();
  });
  return failure(result.wasInterrupted());
}

Value tai::emitCombination(OpBuilder &builder, Location loc, AtomicKind kind,
                           Value a, Value b) {
  bool isFloat = isa<FloatType>(getElementTypeOrSelf(a));
  switch (kind) {
  case AtomicKind::Add:
    if (isFloat)
      return arith::AddFOp::create(builder, loc, a, b);
    return arith::AddIOp::create(builder, loc, a, b);
  case AtomicKind::Sub:
    if (isFloat)
      return arith::SubFOp::create(builder, loc, a, b);
    return arith::SubIOp::create(builder, loc, a, b);
  case AtomicKind::Mul:
    if (isFloat)
      return arith::MulFOp::create(builder, loc, a, b);
    return arith::MulIOp::create(builder, loc, a, b);
  case AtomicKind::Min:
    if (isFloat)
      return arith::MinimumFOp::create(builder, loc, a, b);
    return arith::MinSIOp::create(builder, loc, a, b);
  case AtomicKind::Max:
    if (isFloat)
      return arith::MaximumFOp::create(builder, loc, a, b);
    return arith::MaxSIOp::create(builder, loc, a, b);
  case AtomicKind::MinU:
    return arith::MinUIOp::create(builder, loc, a, b);
  case AtomicKind::MaxU:
    return arith::MaxUIOp::create(builder, loc, a, b);
  case AtomicKind::And:
    return arith::AndIOp::create(builder, loc, a, b);
  case AtomicKind::Or:
    return arith::OrIOp::create(builder, loc, a, b);
  case AtomicKind::Xor:
    return arith::XOrIOp::create(builder, loc, a, b);
  }
  llvm_unreachable("unknown kind");
}

Value tai::emitPlainUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                           Value value, Value pointer, AliasScopes scopes) {
  Value old = emitLoad(builder, loc, value.getType(), pointer, scopes);
  Value combined = emitCombination(builder, loc, kind, old, value);
  emitStore(builder, loc, combined, pointer, scopes);
  return old;
}

/// Returns the LLVM instruction for an atomic update of `kind`, if there is
/// one.
static std::optional<LLVM::AtomicBinOp> getBinOp(AtomicKind kind,
                                                 bool isFloat) {
  switch (kind) {
  case AtomicKind::Add:
    return isFloat ? LLVM::AtomicBinOp::fadd : LLVM::AtomicBinOp::add;
  case AtomicKind::Sub:
    return isFloat ? LLVM::AtomicBinOp::fsub : LLVM::AtomicBinOp::sub;
  case AtomicKind::Mul:
    return std::nullopt;
  case AtomicKind::Min:
    return isFloat ? LLVM::AtomicBinOp::fminimum : LLVM::AtomicBinOp::min;
  case AtomicKind::Max:
    return isFloat ? LLVM::AtomicBinOp::fmaximum : LLVM::AtomicBinOp::max;
  case AtomicKind::MinU:
    return LLVM::AtomicBinOp::umin;
  case AtomicKind::MaxU:
    return LLVM::AtomicBinOp::umax;
  case AtomicKind::And:
    return LLVM::AtomicBinOp::_and;
  case AtomicKind::Or:
    return LLVM::AtomicBinOp::_or;
  case AtomicKind::Xor:
    return LLVM::AtomicBinOp::_xor;
  }
  llvm_unreachable("unknown kind");
}

/// Emits an update by compare-and-exchange, repeated until no other thread has
/// changed the element in between.
static Value emitExchangeLoop(OpBuilder &builder, Location loc, AtomicKind kind,
                              Value value, Value pointer, AliasScopes scopes) {
  Type storage = getStorageType(value.getType());
  Type bits = builder.getIntegerType(storage.getIntOrFloatBitWidth());
  auto toBits = [&](OpBuilder &b, Value v) -> Value {
    if (v.getType().isInteger(1))
      return arith::ExtUIOp::create(b, loc, bits, v);
    if (v.getType() == bits)
      return v;
    return arith::BitcastOp::create(b, loc, bits, v);
  };
  auto fromBits = [&](OpBuilder &b, Value v) -> Value {
    if (value.getType().isInteger(1))
      return arith::TruncIOp::create(b, loc, value.getType(), v);
    if (value.getType() == bits)
      return v;
    return arith::BitcastOp::create(b, loc, value.getType(), v);
  };

  auto first = LLVM::LoadOp::create(builder, loc, bits, pointer);
  first.setAliasScopesAttr(scopes.own);
  first.setNoaliasScopesAttr(scopes.others);
  if (scopes.digits)
    first->setAttr(kDigitsAttrName, scopes.digits);
  auto loop = scf::WhileOp::create(
      builder, loc, TypeRange{bits}, ValueRange{first},
      [&](OpBuilder &b, Location, ValueRange args) {
        Value next = emitCombination(b, loc, kind, fromBits(b, args[0]), value);
        auto exchanged = LLVM::AtomicCmpXchgOp::create(
            b, loc, pointer, args[0], toBits(b, next),
            LLVM::AtomicOrdering::monotonic, LLVM::AtomicOrdering::monotonic);
        if (scopes.digits)
          exchanged->setAttr(kDigitsAttrName, scopes.digits);
        Value seen = LLVM::ExtractValueOp::create(b, loc, exchanged, 0);
        Value done = LLVM::ExtractValueOp::create(b, loc, exchanged, 1);
        Value yes = arith::ConstantIntOp::create(b, loc, 1, 1);
        Value again = arith::XOrIOp::create(b, loc, done, yes);
        scf::ConditionOp::create(b, loc, again, seen);
      },
      [&](OpBuilder &b, Location, ValueRange args) {
        scf::YieldOp::create(b, loc, args);
      });
  return fromBits(builder, loop.getResult(0));
}

Value tai::emitAtomicUpdate(OpBuilder &builder, Location loc, AtomicKind kind,
                            Value value, Value pointer, AliasScopes scopes) {
  std::optional<LLVM::AtomicBinOp> binOp =
      getBinOp(kind, isa<FloatType>(value.getType()));
  if (!binOp || value.getType().isInteger(1))
    return emitExchangeLoop(builder, loc, kind, value, pointer, scopes);
  if (value.getType().isIndex())
    value =
        arith::IndexCastOp::create(builder, loc, builder.getI64Type(), value);
  auto update = LLVM::AtomicRMWOp::create(builder, loc, *binOp, pointer, value,
                                          LLVM::AtomicOrdering::monotonic);
  update.setAliasScopesAttr(scopes.own);
  update.setNoaliasScopesAttr(scopes.others);
  if (scopes.digits)
    update->setAttr(kDigitsAttrName, scopes.digits);
  return update;
}
