//===- ExpandBfloat.cpp - Rounding to bf16 by integers --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/ExpandBfloat.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/InstIterator.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/Module.h"

using namespace llvm;

/// Emits the upper half of the bits of an f32, rounded: half a unit is added to
/// the dropped bits, and the last kept bit decides a tie. A NaN becomes a quiet
/// NaN.
static Value *roundToBfloat(IRBuilder<> &builder, Value *number, Type *type) {
  Type *larger = number->getType()->getWithNewType(builder.getInt32Ty());
  Type *narrow = larger->getWithNewType(builder.getInt16Ty());
  Value *bits = builder.CreateBitCast(number, larger);
  Value *upper = builder.CreateLShr(bits, 16);
  Value *last = builder.CreateAnd(upper, 1);
  Value *half = builder.CreateAdd(last, ConstantInt::get(larger, 0x7fff));
  Value *rounded = builder.CreateLShr(builder.CreateAdd(bits, half), 16);
  Value *quiet = builder.CreateOr(upper, ConstantInt::get(larger, 0x40));
  Value *isNaN = builder.CreateFCmpUNO(number, number);
  Value *result = builder.CreateSelect(isNaN, quiet, rounded);
  return builder.CreateBitCast(builder.CreateTrunc(result, narrow), type);
}

static bool isBfloat(Value *value) {
  return value->getType()->getScalarType()->isBFloatTy();
}

/// True for intrinsics that the backend computes in f32 and rounds by an
/// instruction that flushes denormals. Intrinsics that copy bits, such as fabs
/// and copysign, round nothing.
static bool isRounded(Intrinsic::ID id) {
  switch (id) {
  case Intrinsic::sqrt:
  case Intrinsic::fma:
  case Intrinsic::fmuladd:
  case Intrinsic::minnum:
  case Intrinsic::maxnum:
  case Intrinsic::minimum:
  case Intrinsic::maximum:
  case Intrinsic::minimumnum:
  case Intrinsic::maximumnum:
  case Intrinsic::floor:
  case Intrinsic::ceil:
  case Intrinsic::trunc:
  case Intrinsic::rint:
  case Intrinsic::nearbyint:
  case Intrinsic::round:
  case Intrinsic::roundeven:
    return true;
  default:
    return false;
  }
}

static bool mustExpand(Instruction &instruction) {
  if (!isBfloat(&instruction))
    return false;
  if (auto *trunc = dyn_cast<FPTruncInst>(&instruction))
    return trunc->getSrcTy()->getScalarType()->isFloatTy();
  if (auto *call = dyn_cast<IntrinsicInst>(&instruction))
    return isRounded(call->getIntrinsicID());
  return isa<BinaryOperator>(instruction);
}

static Value *expand(Instruction &instruction) {
  IRBuilder<> builder(&instruction);
  Type *type = instruction.getType();
  if (isa<FPTruncInst>(instruction))
    return roundToBfloat(builder, instruction.getOperand(0), type);
  builder.setFastMathFlags(instruction.getFastMathFlags());
  Type *larger = type->getWithNewType(builder.getFloatTy());
  auto extend = [&](Value *value) {
    return builder.CreateFPExt(value, larger);
  };
  Value *result;
  if (auto *call = dyn_cast<IntrinsicInst>(&instruction)) {
    SmallVector<Value *> operands;
    for (Value *operand : call->args())
      operands.push_back(extend(operand));
    result =
        builder.CreateIntrinsic(call->getIntrinsicID(), {larger}, operands);
  } else {
    auto &binary = cast<BinaryOperator>(instruction);
    result =
        builder.CreateBinOp(binary.getOpcode(), extend(binary.getOperand(0)),
                            extend(binary.getOperand(1)));
  }
  return roundToBfloat(builder, result, type);
}

void mlir::tai::expandBfloat(Module &module) {
  for (Function &function : module) {
    SmallVector<Instruction *> found;
    for (Instruction &instruction : instructions(function))
      if (mustExpand(instruction))
        found.push_back(&instruction);
    for (Instruction *instruction : found) {
      instruction->replaceAllUsesWith(expand(*instruction));
      instruction->eraseFromParent();
    }
  }
}
