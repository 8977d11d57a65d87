//===- DeviceCode.cpp - Translations of device code -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// `--tai-to-ptx` prints the PTX of a module from `tai-opt --tai-to-nvvm`,
// `--tai-to-device-llvmir` the LLVM IR before that, also for the emulated
// device.
//
//===----------------------------------------------------------------------===//

#include "DeviceCode.h"
#include "mlir/Dialect/DLTI/DLTI.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/Tools/mlir-translate/Translation.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "tai/InitAll.h"
#include "llvm/Support/CommandLine.h"
#include "llvm/Support/raw_ostream.h"

using namespace mlir;
using namespace mlir::tai;
namespace cl = llvm::cl;

namespace {
enum class Floats { Strict, Default, Fast };
} // namespace

static cl::OptionCategory category("Device code");

static cl::opt<std::string>
    deviceTarget("device-target",
                 cl::desc("The GPU to make code for, such as sm_90, or "
                          "'emulated'"),
                 cl::init("sm_90"), cl::cat(category));
static cl::opt<Floats> floats(
    "device-floats", cl::desc("What may be done to float operations"),
    cl::values(clEnumValN(Floats::Strict, "strict",
                          "Every operation is rounded by itself"),
               clEnumValN(Floats::Default, "default",
                          "A product and a sum may be rounded once"),
               clEnumValN(Floats::Fast, "fast",
                          "Operations may be reordered and approximated, and "
                          "denormal numbers may be taken for zero")),
    cl::init(Floats::Default), cl::cat(category));
static cl::opt<unsigned> deviceOptLevel("device-opt-level",
                                        cl::desc("Effort, 0 to 3"), cl::init(3),
                                        cl::cat(category));

static cl::opt<bool> combineScatters(
    "device-combine-scatters",
    cl::desc("Compare the elements that data choose for additions in a warp"),
    cl::init(true), cl::cat(category));
static cl::opt<bool> overlapped(
    "device-overlapped",
    cl::desc("Make kernels that may start while the one before still runs"),
    cl::cat(category));

static LogicalResult translate(Operation *op, raw_ostream &output,
                               bool wantsPtx) {
  auto fail = [&](llvm::Error error) -> LogicalResult {
    std::string message = llvm::toString(std::move(error));
    // An error without a message has already been reported by the translation.
    return message.empty() ? failure() : op->emitError(message);
  };
  auto module = dyn_cast<ModuleOp>(op);
  if (!module)
    return op->emitError("expected a module");
  auto deviceModule = findDeviceModule(module);
  if (!deviceModule)
    return fail(deviceModule.takeError());
  if (!*deviceModule)
    return module.emitError("there is no device code in this module");
  DeviceTarget target;
  target.name = deviceTarget;
  if (deviceTarget == "emulated")
    target.kind = runtime::DeviceKind::Emulated;
  if (wantsPtx && target.kind != runtime::DeviceKind::Cuda)
    return module.emitError("the emulated device has no PTX");
  CodegenOptions options;
  options.optLevel = deviceOptLevel;
  options.fastMath = floats == Floats::Fast;
  options.contract = floats != Floats::Strict;
  options.combineScatters = combineScatters && floats != Floats::Strict;
  auto compiler = DeviceCompiler::create(target, options);
  if (!compiler)
    return fail(compiler.takeError());
  auto code = (*compiler)->translate(*deviceModule);
  if (!code)
    return fail(code.takeError());
  if (llvm::Error error = (*compiler)->optimize(*code))
    return fail(std::move(error));
  if (!wantsPtx) {
    code->module->print(output, nullptr);
    return success();
  }
  auto image = (*compiler)->emit(*code);
  if (!image)
    return fail(image.takeError());
  if (overlapped) {
    runtime::ProgramPlan plan;
    plan.scope = TAI_SCOPE_LAUNCHES;
    for (auto [i, function] : llvm::enumerate(image->functions))
      plan.parts.push_back({image->bitcode, function, /*isInTable=*/false,
                            /*isTile=*/false, image->blockSize(i)});
    image = makeProgram(**compiler, plan);
    if (!image)
      return fail(image.takeError());
  }
  output << image->bytes;
  return success();
}

static void registerDialects(DialectRegistry &registry) {
  registerAll(registry);
  registry.insert<DLTIDialect>();
  registerDeviceTranslations(registry);
}

void mlir::tai::registerDeviceCodeTranslations() {
  static TranslateFromMLIRRegistration toPtx(
      "tai-to-ptx", "the PTX of the device code of a module",
      [](Operation *op, raw_ostream &output) {
        return translate(op, output, /*wantsPtx=*/true);
      },
      registerDialects);
  static TranslateFromMLIRRegistration toLLVM(
      "tai-to-device-llvmir", "the LLVM IR of the device code of a module",
      [](Operation *op, raw_ostream &output) {
        return translate(op, output, /*wantsPtx=*/false);
      },
      registerDialects);
}
