//===- Run.cpp - One execution of a function ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Run.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "llvm/ADT/bit.h"

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;
using llvm::APInt;

LogicalResult Run::fail(Operation *op, const Twine &message, int32_t kind) {
  tai_rt_fail(frame, kind, message.str().c_str(),
              describePlace(op->getLoc()).c_str(), 0, nullptr, nullptr,
              nullptr);
  return failure();
}

void Run::report(Operation *op, StringRef message, ValueRange reported,
                 int32_t kind) {
  Message packed = getMessage(reported);
  tai_rt_fail(frame, kind, message.str().c_str(),
              describePlace(op->getLoc()).c_str(), packed.shapes.size(),
              packed.kinds.data(), packed.shapes.data(), packed.slots.data());
}

LogicalResult Run::passSafepoint() {
  if (LLVM_LIKELY(runtime::safepoint::now() == frame->tick))
    return success();
  return failure(tai_rt_safepoint(frame) != 0);
}

SmallVector<int64_t> Run::getIndices(ValueRange indices) {
  SmallVector<int64_t> result;
  for (Value index : indices)
    result.push_back(toIndex(getNumber(index)));
  return result;
}

Message Run::getMessage(ValueRange reported) {
  Message message;
  for (Value value : reported) {
    Type type = getElementTypeOrSelf(value.getType());
    const Numbers &numbers = get(value).numbers;
    message.kinds.push_back(isa<FloatType>(type) ? TAI_VALUE_F64
                            : type.isInteger(1)  ? TAI_VALUE_BOOL
                                                 : TAI_VALUE_I64);
    message.shapes.push_back(numbers.size());
    for (const Number &number : numbers)
      message.slots.push_back(
          isa<FloatType>(type) ? llvm::bit_cast<uint64_t>(toDouble(number))
          : type.isInteger(1)
              ? std::get<APInt>(number).getZExtValue()
              : static_cast<uint64_t>(std::get<APInt>(number).getSExtValue()));
  }
  return message;
}

Data Run::getOperands(Operation *terminator) {
  Data operands;
  for (Value operand : terminator->getOperands())
    operands.push_back(get(operand));
  return operands;
}

void Run::setResults(Operation *op, const Data &results) {
  for (auto [result, datum] : llvm::zip(op->getResults(), results))
    set(result, datum);
}

const FieldPlace &Run::getField(Operation *op) {
  return program.getField(getNamedField(op).getAttr());
}

LogicalResult Run::checkDefined(Operation *op) {
  if (isa<arith::SelectOp>(op) || program.getScalarFunction(op))
    return success();
  for (Value operand : op->getOperands())
    if (auto &undefined = get(operand).undefined) {
      const Undefined &first = undefined->begin()->second;
      return fail(first.op, first.problem);
    }
  return success();
}

LogicalResult Run::runBlock(Block &block, ArrayRef<Datum> arguments) {
  for (auto [argument, datum] :
       llvm::zip_equal(block.getArguments(), arguments))
    set(argument, datum);
  for (Operation &op : block)
    if (failed(execute(&op)))
      return failure();
  return success();
}
