//===- SessionDevice.cpp - The machine that a session runs on -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../CodeGen/InjectedFailures.h"
#include "tai/ExecutionEngine/Session.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include "llvm/Support/Process.h"

using namespace mlir;
using namespace mlir::tai;

/// Places the code of the emulated device in memory. It has a linker of its
/// own, which what was linked keeps: that outlives the compiler of the session.
static runtime::ObjectLinker makeObjectLinker() {
  auto shared = std::make_shared<std::unique_ptr<Linker>>();
  return
      [shared](std::string_view object, const std::vector<std::string> &names,
               std::vector<void *> &addresses, std::shared_ptr<void> &library) {
        auto fail = [](llvm::Error error) {
          return runtime::Status::failure(runtime::StatusCode::Internal,
                                          "device code cannot be linked: " +
                                              llvm::toString(std::move(error)));
        };
        if (injectsFailure("load"))
          return fail(llvm::createStringError("a failure was asked for"));
        if (!*shared) {
          auto made = Linker::create(runtime::runtimeSymbols());
          if (!made)
            return fail(made.takeError());
          *shared = std::move(*made);
        }
        auto linked = (*shared)->link({object.data(), object.size()}, names);
        if (!linked)
          return fail(linked.takeError());
        addresses = std::move(linked->addresses);
        Linker::Library *unit = linked->library;
        library = std::shared_ptr<void>(
            unit, [shared, unit](void *) { (*shared)->unload(unit); });
        return runtime::Status::success();
      };
}

LogicalResult Session::setArch(StringRef name) {
  std::unique_ptr<runtime::Device> device;
  if (name == "cuda") {
    std::optional<std::string> emulated =
        llvm::sys::Process::GetEnv("TAI_CUDA_EMULATION");
    if (emulated && *emulated == "1")
      device = runtime::openEmulatedDevice(makeObjectLinker());
    else if (failed(check(runtime::openCudaDevice(0, device))))
      return failure();
  } else if (name != "cpu" && name != "interpreter") {
    return fail(FailureKind::Usage, "there is no arch '" + name +
                                        "'; there are cpu, cuda and "
                                        "interpreter");
  }
  if (failed(check(rt->useDevice(std::move(device), deviceMemoryLimit))))
    return failure();
  options.interpret = name == "interpreter";
  options.device = std::nullopt;
  options.deviceTarget.clear();
  if (const runtime::Device *used = rt->getDevice()) {
    options.device = used->kind();
    options.deviceTarget = used->target();
    options.places = rt->wantsPlaces();
  }
  if (runtime::DeviceQueue *queue = rt->getDeviceQueue())
    queue->setProgramMaker(
        [this](const runtime::ProgramPlan &plan, runtime::DeviceImage &image) {
          Failure problem;
          auto made = compiler->makeProgram(plan, options, problem);
          if (!made)
            return keepFailure(std::move(problem));
          image = std::move(*made);
          return runtime::Status::success();
        });
  setFuseLaunches(fuseLaunches);
  return success();
}

void Session::setFuseLaunches(bool on) {
  fuseLaunches = on;
  rt->setFuseLaunches(on);
  if (runtime::DeviceQueue *queue = rt->getDeviceQueue())
    queue->setMode(on ? runtime::ProgramMode::Automatic
                      : runtime::ProgramMode::Launches);
}
