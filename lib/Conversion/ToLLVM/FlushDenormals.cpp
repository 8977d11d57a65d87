//===- FlushDenormals.cpp - Flush-to-zero functions -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Flushing is a mode in the processor's control word, which is per thread. Each
// function that the runtime may call sets and restores it, so that neither the
// caller nor another launch on the same worker is affected. LLVM does not know
// that arithmetic depends on the mode, so the body is a separate function that
// is not inlined. The operands of library functions are flushed before.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "tai/Conversion/ToLLVM/FloatOptions.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Ownership.h"

using namespace mlir;
using namespace mlir::tai;

#if defined(__x86_64__)
// The bits of the control register MXCSR that make denormal operands and
// denormal results zero.
constexpr int32_t kFlushBits = 0x8040;
constexpr bool kCanFlush = true;
#elif defined(__aarch64__)
// The bit of the control word FPCR of ARM processors that flushes operands and
// results.
constexpr int64_t kFlushBits = 1 << 24;
constexpr bool kCanFlush = true;
#else
constexpr int64_t kFlushBits = 0;
constexpr bool kCanFlush = false;
#endif

namespace {
/// Emits reads and writes of the floating-point control word.
class ControlWord {
public:
  ControlWord(OpBuilder &builder, Location loc) : builder(builder), loc(loc) {}

  /// Emits code that sets the flush bits; returns the previous control word.
  Value setFlushing() {
#if defined(__x86_64__)
    Type word = builder.getI32Type();
    Value one = LLVM::ConstantOp::create(builder, loc, builder.getI64Type(), 1);
    slot = LLVM::AllocaOp::create(
        builder, loc, LLVM::LLVMPointerType::get(builder.getContext()), word,
        one);
    call("llvm.x86.sse.stmxcsr", {}, slot);
    Value old = LLVM::LoadOp::create(builder, loc, word, slot);
    Value bits = LLVM::ConstantOp::create(builder, loc, word, kFlushBits);
    write(LLVM::OrOp::create(builder, loc, old, bits));
    return old;
#else
    Type word = builder.getI64Type();
    Value old = call("llvm.aarch64.get.fpcr", word, {});
    Value bits = LLVM::ConstantOp::create(builder, loc, word, kFlushBits);
    write(LLVM::OrOp::create(builder, loc, old, bits));
    return old;
#endif
  }

  void write(Value word) {
#if defined(__x86_64__)
    LLVM::StoreOp::create(builder, loc, word, slot);
    call("llvm.x86.sse.ldmxcsr", {}, slot);
#else
    call("llvm.aarch64.set.fpcr", {}, word);
#endif
  }

private:
  Value call(StringRef name, Type result, ValueRange arguments) {
    auto made = result
                    ? LLVM::CallIntrinsicOp::create(builder, loc, result,
                                                    builder.getStringAttr(name),
                                                    arguments)
                    : LLVM::CallIntrinsicOp::create(
                          builder, loc, builder.getStringAttr(name), arguments);
    return result ? made.getResult(0) : Value();
  }

  OpBuilder &builder;
  Location loc;
  Value slot;
};
} // namespace

/// Keeps LLVM from changing the parameters of a function with a single caller:
/// polls are inserted later, into functions recognised by their type, and use
/// the frame, which must remain the first parameter.
static void keepArguments(LLVM::LLVMFuncOp function) {
  OpBuilder builder = OpBuilder::atBlockBegin(&function.getBody().front());
  // Each argument gets its own inline asm, because there may be more arguments
  // than registers.
  for (Value argument : function.getBody().getArguments())
    if (isa<LLVM::LLVMPointerType, IntegerType>(argument.getType()))
      LLVM::InlineAsmOp::create(
          builder, function.getLoc(), /*resultTypes=*/TypeRange(), argument,
          /*asm_string=*/"", /*constraints=*/"r", /*has_side_effects=*/true,
          /*is_align_stack=*/false, LLVM::TailCallKind::None,
          /*asm_dialect=*/LLVM::AsmDialectAttr(),
          /*operand_attrs=*/ArrayAttr());
}

/// Emits a zero with the sign of `x` if `x` is denormal, otherwise `x`.
static Value createFlushed(OpBuilder &builder, Location loc, Value x) {
  Type type = x.getType();
  auto element = cast<FloatType>(getElementTypeOrSelf(type));
  auto constant = [&](const APFloat &number) {
    TypedAttr value = builder.getFloatAttr(element, number);
    if (auto vector = dyn_cast<VectorType>(type))
      value = DenseElementsAttr::get(vector, Attribute(value));
    return LLVM::ConstantOp::create(builder, loc, type, value);
  };
  const llvm::fltSemantics &semantics = element.getFloatSemantics();
  Value least = constant(APFloat::getSmallestNormalized(semantics));
  Value size = LLVM::FAbsOp::create(builder, loc, type, x);
  Value isDenormal =
      LLVM::FCmpOp::create(builder, loc, LLVM::FCmpPredicate::olt, size, least);
  Value zero = LLVM::CopySignOp::create(
      builder, loc, type, constant(APFloat::getZero(semantics)), x);
  return LLVM::SelectOp::create(builder, loc, isDenormal, zero, x);
}

/// True if a library computes the function, rather than an instruction, which
/// would follow the control word.
static bool isOfLibrary(Operation *op) {
  if (isa<LLVM::ATan2Op, LLVM::LogOp, LLVM::Log2Op, LLVM::Log10Op, LLVM::PowOp,
          LLVM::SinOp, LLVM::TanOp, LLVM::ASinOp, LLVM::ATanOp, LLVM::SinhOp,
          LLVM::TanhOp>(op))
    return true;
  auto call = dyn_cast<LLVM::CallOp>(op);
  if (!call || !call.getCallee())
    return false;
  auto callee = SymbolTable::lookupNearestSymbolFrom<LLVM::LLVMFuncOp>(
      call, call.getCalleeAttr());
  return callee && callee.isExternal() &&
         llvm::all_of(call.getOperandTypes(), llvm::IsaPred<FloatType>);
}

/// Flushes the operands of library functions. Such functions scale a denormal
/// number by a power of two, which yields zero in this mode: a logarithm is
/// then wrong for any argument. Sines, for example, return a denormal argument
/// unchanged.
static void flushOperands(LLVM::LLVMFuncOp function) {
  function.walk([](Operation *op) {
    if (!isOfLibrary(op))
      return;
    OpBuilder builder(op);
    for (OpOperand &operand : op->getOpOperands()) {
      Type type = getElementTypeOrSelf(operand.get().getType());
      if (type.isF32() || type.isF64())
        operand.set(createFlushed(builder, op->getLoc(), operand.get()));
    }
  });
}

/// Moves the body of the function into a new function, and makes the function
/// call it.
static void wrap(LLVM::LLVMFuncOp function) {
  Location loc = function.getLoc();
  OpBuilder builder(function);
  builder.setInsertionPointAfter(function);
  auto body = LLVM::LLVMFuncOp::create(
      builder, loc, (function.getSymName() + ".flushing").str(),
      function.getFunctionType(), LLVM::Linkage::Internal);
  body.getBody().takeBody(function.getBody());
  body.setNoInline(true);
  markLowered(body);
  keepArguments(body);
  builder.setInsertionPointToStart(function.addEntryBlock(builder));
  ControlWord word(builder, loc);
  Value old = word.setFlushing();
  auto call = LLVM::CallOp::create(builder, loc, body,
                                   function.getBody().getArguments());
  word.write(old);
  LLVM::ReturnOp::create(builder, loc, call.getResults());
}

LogicalResult tai::flushDenormals(Operation *root) {
  SmallVector<LLVM::LLVMFuncOp> functions;
  // Device functions in the module are skipped, since they are converted
  // separately.
  for (auto function : root->getRegion(0).getOps<LLVM::LLVMFuncOp>())
    if (!function.isExternal() && Modes::of(function).flushes())
      functions.push_back(function);
  if (functions.empty())
    return success();
  if (!kCanFlush)
    return functions.front().emitError(
        "ftz=True cannot be had: this processor has no such mode that is known "
        "here");
  for (LLVM::LLVMFuncOp function : functions) {
    flushOperands(function);
    wrap(function);
  }
  return success();
}
