//===- Services.cpp - Random numbers, checks, output, launches ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Program.h"
#include "llvm/ADT/bit.h"
#include <cmath>

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;
using llvm::APFloat;
using llvm::APInt;

//===----------------------------------------------------------------------===//
// Random numbers
//===----------------------------------------------------------------------===//

LogicalResult Run::runRandom(Operation *op) {
  auto draw = cast<RandomOp>(op);
  Type type = draw.getValue().getType();
  unsigned width = getWidth(type);
  std::vector<Operation *> path = calls;
  path.push_back(op);
  uint32_t &sequence = draws[path];
  auto bits = [&] {
    return uint64_t(tai_rt_random_u32(frame->seed, frame->launch, iteration,
                                      draw.getStream(), sequence++));
  };
  uint64_t drawn = bits();
  unsigned available = 32;
  if (width > 32) {
    drawn = drawn << 32 | bits();
    available = 64;
  }
  auto floating = dyn_cast<FloatType>(type);
  if (!floating) {
    set(draw.getValue(), Datum(Number(APInt(available, drawn).trunc(width))));
    return success();
  }
  // As many bits as the significand has.
  unsigned kept = APFloat::semanticsPrecision(floating.getFloatSemantics());
  set(draw.getValue(),
      Datum(fromDouble(
          std::ldexp(double(drawn >> (available - kept)), -int(kept)), type)));
  return success();
}

//===----------------------------------------------------------------------===//
// Messages
//===----------------------------------------------------------------------===//

Run::Message Run::getMessage(ValueRange reported) {
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

LogicalResult Run::runPrint(Operation *op) {
  auto print = cast<PrintOp>(op);
  Message message = getMessage(print.getArgs());
  tai_rt_print(frame, print.getFormat().str().c_str(), message.kinds.size(),
               message.kinds.data(), message.shapes.data(),
               message.slots.data());
  return success();
}

LogicalResult Run::runAssert(Operation *op) {
  auto assertion = cast<AssertOp>(op);
  if (program.getOptions().debug &&
      !isTrue(getNumber(assertion.getCondition())))
    report(op, assertion.getMessage(), assertion.getArgs(), TAI_FAIL_ASSERT);
  return success();
}

/// What a value needs follows from the arguments of the kernel.
LogicalResult Run::evaluate(Value value) {
  Operation *op = value.getDefiningOp();
  if (!op || values.contains(value))
    return success();
  for (Value operand : op->getOperands())
    if (failed(evaluate(operand)))
      return failure();
  return execute(op);
}

LogicalResult Run::checkPreconditions(Block &body) {
  bool good = true;
  for (auto condition : body.getOps<PreconditionOp>()) {
    for (Value operand : condition->getOperands())
      if (failed(evaluate(operand)))
        return failure();
    if (isTrue(getNumber(condition.getCondition())))
      continue;
    report(condition, condition.getMessage(), condition.getArgs(),
           TAI_FAIL_INDEX);
    good = false;
  }
  return success(good);
}

LogicalResult Run::runCheckClose(Operation *op) {
  auto check = cast<CheckCloseOp>(op);
  double actual = toDouble(getNumber(check.getActual()));
  double expected = toDouble(getNumber(check.getExpected()));
  double tolerance = check.getTolerance().convertToDouble();
  double allowed = tolerance * std::fmax(1, std::abs(expected));
  // A NaN on either side is a failure.
  if (std::abs(actual - expected) <= allowed)
    return success();
  int32_t kinds[] = {TAI_VALUE_F64, TAI_VALUE_F64, TAI_VALUE_F64};
  int32_t shapes[] = {1, 1, 1};
  uint64_t slots[] = {llvm::bit_cast<uint64_t>(actual),
                      llvm::bit_cast<uint64_t>(expected),
                      llvm::bit_cast<uint64_t>(tolerance)};
  tai_rt_fail(frame, TAI_FAIL_CHECK,
              "check failed: got {}, expected {} within {}",
              describePlaceOf(op).c_str(), 3, kinds, shapes, slots);
  return success();
}

//===----------------------------------------------------------------------===//
// Host programs
//===----------------------------------------------------------------------===//

LogicalResult Run::runLaunch(Operation *op) {
  auto launch = cast<LaunchOp>(op);
  SmallVector<uint64_t> arguments, results;
  for (Value operand : launch.getOperands()) {
    if (isa<MemRefType>(operand.getType()))
      return fail(op, "host programs pass no arrays");
    for (const Number &number : get(operand).numbers)
      writeNumber(number, reinterpret_cast<char *>(&arguments.emplace_back(0)));
  }
  auto count = [](Type type) {
    auto vector = dyn_cast<VectorType>(type);
    return vector ? vector.getNumElements() : 1;
  };
  for (Type type : launch.getResultTypes())
    results.append(count(type), 0);
  // The runtime knows kernels by the address of their names, which end in zero.
  tai_rt_host_launch(frame, launch.getKernel().data(), arguments.data(),
                     arguments.size(), results.data(), results.size());
  const uint64_t *slot = results.data();
  for (Value result : launch.getResults()) {
    Datum datum;
    for (int64_t i = 0; i != count(result.getType()); ++i)
      datum.numbers.push_back(
          readNumber(reinterpret_cast<const char *>(slot++),
                     getElementTypeOrSelf(result.getType())));
    set(result, std::move(datum));
  }
  return failure(tai_rt_failed(frame) != 0);
}

LogicalResult Run::runTape(Operation *op) {
  auto tape = cast<TapeOp>(op);
  tai_rt_host_tape_begin(frame, tape.getLoss().data());
  LogicalResult result = runBlock(tape.getBody().front(), {});
  tai_rt_host_tape_end(frame);
  return failure(failed(result) || tai_rt_failed(frame));
}

LogicalResult Run::runCheckGradient(Operation *op) {
  auto check = cast<CheckGradientOp>(op);
  struct Region {
    Run &run;
    Block &body;
  } region{*this, check.getBody().front()};
  auto call = [](TaiFrame *inner, void *closure) -> int32_t {
    Region &region = *static_cast<Region *>(closure);
    TaiFrame *outer = std::exchange(region.run.frame, inner);
    LogicalResult result = region.run.runBlock(region.body, {});
    region.run.frame = outer;
    return failed(result) || tai_rt_failed(inner);
  };
  SmallVector<std::string> names;
  SmallVector<const char *> wrt;
  for (Attribute field : check.getWrt())
    names.push_back(cast<FlatSymbolRefAttr>(field).getValue().str());
  for (const std::string &name : names)
    wrt.push_back(name.c_str());
  tai_rt_host_check_gradient(frame, check.getLoss().str().c_str(), wrt.data(),
                             wrt.size(), check.getTolerance().convertToDouble(),
                             call, &region, describePlaceOf(op).c_str());
  return failure(tai_rt_failed(frame) != 0);
}
