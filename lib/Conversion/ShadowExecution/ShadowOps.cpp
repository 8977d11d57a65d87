//===- ShadowOps.cpp - Operations in shadow execution ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "ShadowOps.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "llvm/ADT/StringSwitch.h"

using namespace mlir;

std::string tai::nameOperation(Operation *op) {
  if (auto call = dyn_cast<LLVM::CallOp>(op))
    return call.getCallee() ? call.getCallee()->str() : "call";
  StringRef name = op->getName().stripDialect();
  StringRef sign = llvm::StringSwitch<StringRef>(name)
                       .Case("fadd", "+")
                       .Case("fsub", "-")
                       .Case("fmul", "*")
                       .Case("fdiv", "/")
                       .Case("frem", "%")
                       .Case("fcmp", "comparison")
                       .Cases({"fptosi", "fptoui"}, "conversion to an integer")
                       .Case("atomicrmw", "atomic update")
                       .Default(name);
  sign.consume_front("intr.");
  return sign.str();
}

std::string tai::nameWiderCall(StringRef name, Type type, Type shadow) {
  static constexpr StringLiteral known[] = {
      "acos",  "acosh", "asin",  "asinh", "atan",  "atan2",     "atanh",
      "cbrt",  "cos",   "cosh",  "erf",   "erfc",  "exp",       "exp2",
      "expm1", "fmod",  "log",   "log10", "log1p", "log2",      "pow",
      "sin",   "sinh",  "sqrt",  "tan",   "tanh",  "floor",     "ceil",
      "trunc", "rint",  "round", "hypot", "exp10", "remainder", "roundeven"};
  if (type.isF32() && !name.consume_back("f"))
    return "";
  if (!llvm::is_contained(known, name))
    return "";
  return shadow.isF64() ? name.str() : name.str() + "l";
}

bool tai::onlyRounds(Operation *op) {
  return isa<LLVM::FMulOp, LLVM::FDivOp, LLVM::FNegOp, LLVM::SqrtOp,
             LLVM::FAbsOp, LLVM::CopySignOp, LLVM::FPExtOp, LLVM::FPTruncOp,
             LLVM::MaxNumOp, LLVM::MinNumOp, LLVM::MaximumOp, LLVM::MinimumOp,
             LLVM::SelectOp, LLVM::FreezeOp, LLVM::ExtractElementOp,
             LLVM::InsertElementOp, LLVM::ShuffleVectorOp>(op);
}

bool tai::onlyMoves(Operation *op) {
  return isa<LLVM::FNegOp, LLVM::FAbsOp, LLVM::CopySignOp, LLVM::FPExtOp,
             LLVM::SelectOp, LLVM::FreezeOp, LLVM::ExtractElementOp,
             LLVM::InsertElementOp, LLVM::ShuffleVectorOp, LLVM::MaxNumOp,
             LLVM::MinNumOp, LLVM::MaximumOp, LLVM::MinimumOp>(op);
}

Value tai::emitSplat(ImplicitLocOpBuilder &b, Value value, Type like) {
  auto vector = dyn_cast<VectorType>(like);
  if (!vector)
    return value;
  Type type = vector.clone(value.getType());
  Value none = LLVM::PoisonOp::create(b, type);
  Value zero = LLVM::ConstantOp::create(b, b.getI32Type(), 0);
  Value first = LLVM::InsertElementOp::create(b, none, value, zero);
  SmallVector<int32_t> lanes(vector.getNumElements(), 0);
  return LLVM::ShuffleVectorOp::create(b, first, none, lanes);
}
