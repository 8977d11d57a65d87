//===- EmulatedCode.cpp - Code of the emulated device ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Compile/EmulatedCode.h"
#include "tai/CodeGen/InjectedFailures.h"
#include "tai/CodeGen/Linker.h"

using namespace mlir;
using namespace mlir::tai;

runtime::ObjectLinker mlir::tai::makeObjectLinker() {
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
