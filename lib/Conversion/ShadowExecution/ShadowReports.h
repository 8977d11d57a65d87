//===- ShadowReports.h - Reports of shadow execution ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Reports from code that `tai-shadow-execution` instruments. A function counts
// its results with errors in its stack frame, and the runtime adds up the
// counts when the function returns. The runtime is called for a result that may
// be the worst of its site so far, and for the first result of each site in a
// run of the function.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_SHADOWEXECUTION_SHADOWREPORTS_H
#define TAI_LIB_CONVERSION_SHADOWEXECUTION_SHADOWREPORTS_H

#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/Conversion/TaiToHost/RuntimeCalls.h"

namespace mlir::tai {

class ShadowReports {
public:
  /// Global constants with the descriptions of all sites in a module, by text.
  using Texts = llvm::StringMap<LLVM::GlobalOp>;

  ShadowReports(ImplicitLocOpBuilder &b, LLVM::LLVMFuncOp function,
                RuntimeCalls &runtime, Texts &texts)
      : b(b), function(function), runtime(runtime), texts(texts) {}

  /// The operands and the result of an operation in f64, each with the
  /// difference between its shadow and itself, and the shadow of the result.
  /// Scalars or vectors.
  struct Numbers {
    Value a, errorOfA, b, errorOfB, result, error, exact;
    bool isUnary;
  };

  /// Counts the result where `fires` holds; a scalar `fires` is known to hold.
  /// Splits the block at the insertion point, and continues in the block that
  /// follows.
  void emitResult(Operation *op, unsigned precision, Value fires,
                  const Numbers &numbers);
  /// Emits the report on a scalar comparison or conversion whose result differs
  /// from that of the shadows.
  void emitFlip(Operation *op, unsigned precision, const Numbers &numbers);

  /// Initialises the counts at the entry of the function, and passes them to
  /// the runtime at its returns. Must be called after the last report.
  void finish();

  /// Declares the memory that the runtime's functions for reports access.
  static void restrictEffects(ModuleOp module);

private:
  Value integer(unsigned bits, int64_t value) {
    return LLVM::ConstantOp::create(b, b.getIntegerType(bits), value);
  }
  Value describe(Operation *op);
  /// Returns the number of the counter of a site in the stack frame; nullopt if
  /// there are too many sites.
  std::optional<int32_t> getCount(Value site);
  Value emitMember(int32_t count, size_t offset);
  void emitAdd(int32_t count, size_t offset, Value more);
  void emitLanes(Value site, std::optional<int32_t> count, Value precision,
                 Value fires, const Numbers &numbers);
  /// Lets `emit` fill a block that runs if the condition holds, and continues
  /// in the block that follows.
  void emitIf(Value condition, bool isRare, llvm::function_ref<void()> emit);
  Value emitIsCommon(int32_t count, const Numbers &numbers);
  Value emitCancels(const Numbers &numbers);

  ImplicitLocOpBuilder &b;
  LLVM::LLVMFuncOp function;
  RuntimeCalls &runtime;
  Texts &texts;
  /// The counts in the stack frame, and space for the numbers of the lanes;
  /// null until used.
  LLVM::AllocaOp counts, lanes;
  int64_t mostLanes = 0;
  llvm::DenseMap<StringAttr, int32_t> numbersOfSites;
};

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_SHADOWEXECUTION_SHADOWREPORTS_H
