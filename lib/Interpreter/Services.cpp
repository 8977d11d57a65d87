//===- Services.cpp - Random numbers, checks, output, launches ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Handlers.h"
#include "tai/Dialect/Check/IR/Check.h"
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

static LogicalResult runRandom(Run &run, Operation *op) {
  auto draw = cast<RandomOp>(op);
  Type type = draw.getValue().getType();
  unsigned width = getWidth(type);
  uint32_t &sequence = run.draws.at(op);
  auto bits = [&] {
    return uint64_t(tai_rt_random_u32(run.frame->seed, run.frame->launch,
                                      run.draws.iteration, draw.getStream(),
                                      sequence++));
  };
  uint64_t drawn = bits();
  unsigned available = 32;
  if (width > 32) {
    drawn = drawn << 32 | bits();
    available = 64;
  }
  auto floating = dyn_cast<FloatType>(type);
  if (!floating) {
    run.set(draw.getValue(),
            Datum(Number(APInt(available, drawn).trunc(width))));
    return success();
  }
  // A float gets a random bit for each bit of its significand, so that all its
  // digits are random.
  unsigned kept = APFloat::semanticsPrecision(floating.getFloatSemantics());
  run.set(
      draw.getValue(),
      Datum(fromDouble(
          std::ldexp(double(drawn >> (available - kept)), -int(kept)), type)));
  return success();
}

//===----------------------------------------------------------------------===//
// Messages
//===----------------------------------------------------------------------===//

static LogicalResult runPrint(Run &run, Operation *op) {
  auto print = cast<PrintOp>(op);
  Message message = run.getMessage(print.getArgs());
  std::string text = print.getFormat().str();
  if (print.getNoNewline())
    text += TAI_SAME_LINE;
  tai_rt_print(run.frame, text.c_str(), message.kinds.size(),
               message.kinds.data(), message.shapes.data(),
               message.slots.data());
  return success();
}

static LogicalResult runAssert(Run &run, Operation *op) {
  auto assertion = cast<AssertOp>(op);
  std::optional<uint32_t> failure = assertion.getFailure();
  if ((failure || run.program.getOptions().debug) &&
      !isTrue(run.getNumber(assertion.getCondition())))
    run.report(op, assertion.getMessage(), assertion.getArgs(),
               failure.value_or(TAI_FAIL_ASSERT));
  return success();
}

/// Runs the operations that compute `value`, which depends on arguments of the
/// kernel alone.
static LogicalResult evaluate(Run &run, Value value) {
  Operation *op = value.getDefiningOp();
  if (!op || run.values.contains(value))
    return success();
  for (Value operand : op->getOperands())
    if (failed(evaluate(run, operand)))
      return failure();
  return run.execute(op);
}

LogicalResult interpreter::checkPreconditions(Run &run, Block &body) {
  bool good = true;
  for (auto condition : body.getOps<PreconditionOp>()) {
    for (Value operand : condition->getOperands())
      if (failed(evaluate(run, operand)))
        return failure();
    if (isTrue(run.getNumber(condition.getCondition())))
      continue;
    run.report(condition, condition.getMessage(), condition.getArgs(),
               TAI_FAIL_INDEX);
    good = false;
  }
  return success(good);
}

static LogicalResult runCheckClose(Run &run, Operation *op) {
  auto check = cast<CheckCloseOp>(op);
  double actual = toDouble(run.getNumber(check.getActual()));
  double expected = toDouble(run.getNumber(check.getExpected()));
  double tolerance = check.getTolerance().convertToDouble();
  double allowed = tolerance * std::fmax(1, std::abs(expected));
  // This comparison is false if either number is NaN, which then is a failure.
  if (std::abs(actual - expected) <= allowed)
    return success();
  int32_t kinds[] = {TAI_VALUE_F64, TAI_VALUE_F64, TAI_VALUE_F64};
  int32_t shapes[] = {1, 1, 1};
  uint64_t slots[] = {llvm::bit_cast<uint64_t>(actual),
                      llvm::bit_cast<uint64_t>(expected),
                      llvm::bit_cast<uint64_t>(tolerance)};
  tai_rt_fail(run.frame, TAI_FAIL_CHECK,
              "check failed: got {}, expected {} within {}",
              describePlace(op->getLoc()).c_str(), 3, kinds, shapes, slots);
  return success();
}

//===----------------------------------------------------------------------===//
// Host programs
//===----------------------------------------------------------------------===//

static LogicalResult runLaunch(Run &run, Operation *op) {
  auto launch = cast<LaunchOp>(op);
  SmallVector<uint64_t> arguments, results;
  for (Value operand : launch.getOperands()) {
    if (isa<MemRefType>(operand.getType()))
      return run.fail(op, "host programs pass no arrays");
    for (const Number &number : run.get(operand).numbers)
      writeNumber(number, reinterpret_cast<char *>(&arguments.emplace_back(0)));
  }
  auto count = [](Type type) {
    auto vector = dyn_cast<VectorType>(type);
    return vector ? vector.getNumElements() : 1;
  };
  for (Type type : launch.getResultTypes())
    results.append(count(type), 0);
  // The runtime identifies kernels by the address of their names, which are
  // zero-terminated.
  tai_rt_host_launch(run.frame, launch.getKernel().data(), arguments.data(),
                     arguments.size(), results.data(), results.size());
  const uint64_t *slot = results.data();
  for (Value result : launch.getResults()) {
    Datum datum;
    for (int64_t i = 0; i != count(result.getType()); ++i)
      datum.numbers.push_back(
          readNumber(reinterpret_cast<const char *>(slot++),
                     getElementTypeOrSelf(result.getType())));
    run.set(result, std::move(datum));
  }
  return failure(tai_rt_failed(run.frame) != 0);
}

static LogicalResult runTape(Run &run, Operation *op) {
  auto tape = cast<TapeOp>(op);
  tai_rt_host_tape_begin(run.frame, tape.getLoss().data());
  if (CheckpointAttr checkpoint = tape.getCheckpointAttr())
    tai_rt_host_tape_checkpoint(
        run.frame, static_cast<int32_t>(checkpoint.getKind()),
        checkpoint.getSnapshots(), checkpoint.getBudget());
  LogicalResult result = run.runBlock(tape.getBody().front(), {});
  tai_rt_host_tape_end(run.frame);
  return failure(failed(result) || tai_rt_failed(run.frame));
}

static LogicalResult runCheckGradient(Run &run, Operation *op) {
  auto check = cast<CheckGradientOp>(op);
  struct Region {
    Run &run;
    Block &body;
  } region{run, check.getBody().front()};
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
  tai_rt_host_check_gradient(run.frame, check.getLoss().str().c_str(),
                             wrt.data(), wrt.size(),
                             check.getTolerance().convertToDouble(), call,
                             &region, describePlace(op->getLoc()).c_str());
  return failure(tai_rt_failed(run.frame) != 0);
}

void interpreter::addServiceHandlers(Handlers &handlers) {
  handlers["tai.assert"] = runAssert;
  handlers["tai.launch"] = runLaunch;
  handlers["tai.print"] = runPrint;
  handlers["tai.random"] = runRandom;
  handlers["tai.tape"] = runTape;
  handlers["tai_check.close"] = runCheckClose;
  handlers["tai_check.gradient"] = runCheckGradient;
}
