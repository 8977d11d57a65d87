//===- Linker.cpp - Object code to functions in this process --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Linker.h"
#include "PerfMap.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "llvm/ExecutionEngine/Orc/AbsoluteSymbols.h"
#include "llvm/ExecutionEngine/Orc/Core.h"
#include "llvm/ExecutionEngine/Orc/ExecutionUtils.h"
#include "llvm/ExecutionEngine/Orc/ObjectLinkingLayer.h"
#include "llvm/ExecutionEngine/Orc/SelfExecutorProcessControl.h"
#include "llvm/ExecutionEngine/Orc/TaskDispatch.h"
#include "llvm/Support/MemoryBuffer.h"

using namespace llvm;
using namespace llvm::orc;
using namespace mlir::tai;

Linker::Linker() = default;

Linker::~Linker() {
  // The session is ended before the layer is destroyed, because it frees the
  // linked code through the layer.
  if (session)
    consumeError(session->endSession());
  layer.reset();
}

Expected<std::unique_ptr<Linker>>
Linker::create(ArrayRef<runtime::RuntimeSymbol> runtime) {
  std::unique_ptr<Linker> linker(new Linker());
  // Code is linked on the calling thread, without threads of the ORC session's
  // own, because the compiler has its own threads.
  auto control = SelfExecutorProcessControl::Create(
      nullptr, std::make_unique<InPlaceTaskDispatcher>());
  if (!control)
    return control.takeError();
  linker->session = std::make_unique<ExecutionSession>(std::move(*control));
  // The session's error reporter collects the reasons of errors, which the
  // returned errors lack, and prints nothing.
  linker->session->setErrorReporter([linker = linker.get()](Error error) {
    std::lock_guard<std::mutex> lock(linker->mutex);
    linker->reasons +=
        (linker->reasons.empty() ? "" : "; ") + toString(std::move(error));
  });
  linker->layer = std::make_unique<ObjectLinkingLayer>(*linker->session);
  addPerfMap(*linker->layer);

  JITDylib &library = linker->session->createBareJITDylib("runtime");
  SymbolMap symbols;
  for (const runtime::RuntimeSymbol &symbol : runtime)
    symbols[linker->session->intern(symbol.name)] = {
        ExecutorAddr::fromPtr(symbol.address),
        JITSymbolFlags::Exported | JITSymbolFlags::Callable};
  if (Error error = library.define(absoluteSymbols(std::move(symbols))))
    return error;
  // The math libraries are loaded by name, because the process may have loaded
  // them without making their symbols visible.
  SmallVector<StringRef> names{"libm.so.6"};
  append_range(names, getVectorLibraries());
  for (StringRef name : names) {
    auto generator = DynamicLibrarySearchGenerator::Load(name.data(), '\0');
    if (generator)
      library.addGenerator(std::move(*generator));
    else
      consumeError(generator.takeError());
  }
  auto process = DynamicLibrarySearchGenerator::GetForCurrentProcess('\0');
  if (!process)
    return process.takeError();
  library.addGenerator(std::move(*process));
  linker->runtimeLibrary = &library;
  return linker;
}

Expected<Linker::Linked> Linker::link(ArrayRef<char> object,
                                      ArrayRef<std::string> names) {
  std::string name;
  {
    std::lock_guard<std::mutex> lock(mutex);
    name = "kernel" + std::to_string(counter++);
  }
  JITDylib &library = session->createBareJITDylib(name);
  linked.fetch_add(1, std::memory_order_relaxed);
  library.addToLinkOrder(*runtimeLibrary);
  Linked result;
  result.library = &library;
  auto fail = [&](Error error) -> Error {
    unload(&library);
    std::lock_guard<std::mutex> lock(mutex);
    if (reasons.empty())
      return error;
    return createStringError(toString(std::move(error)) + ": " +
                             std::exchange(reasons, std::string()));
  };
  auto buffer = MemoryBuffer::getMemBufferCopy(
      StringRef(object.data(), object.size()), name);
  if (Error error = layer->add(library, std::move(buffer)))
    return fail(std::move(error));
  for (const std::string &symbol : names) {
    auto address = session->lookup({&library}, session->intern(symbol));
    if (!address)
      return fail(address.takeError());
    result.addresses.push_back(address->getAddress().toPtr<void *>());
  }
  return result;
}

void Linker::unload(Library *library) {
  consumeError(session->removeJITDylib(*library));
  linked.fetch_sub(1, std::memory_order_relaxed);
  // The session keeps the names of unused symbols until they are cleaned up;
  // this is done after each 256th unloading.
  constexpr uint64_t often = 256;
  if (unloaded.fetch_add(1, std::memory_order_relaxed) % often == often - 1)
    session->getSymbolStringPool()->clearDeadEntries();
}
