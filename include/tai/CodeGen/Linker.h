//===- Linker.h - Object code to functions in this process ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Places object code in memory with ORC and JITLink. Every object has a
// JITDylib of its own, so that kernels of equal names do not clash; all of them
// can call the runtime's functions and the math library.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_LINKER_H
#define TAI_CODEGEN_LINKER_H

#include "tai/Runtime/Launch/Runtime.h"
#include "llvm/ADT/ArrayRef.h"
#include "llvm/ADT/StringRef.h"
#include "llvm/Support/Error.h"
#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace llvm::orc {
class ExecutionSession;
class JITDylib;
class ObjectLinkingLayer;
} // namespace llvm::orc

namespace mlir::tai {

/// Links compiled objects into the process; thread-safe. Linked code lives
/// until it is unloaded or the linker is destroyed.
class Linker {
public:
  using Library = llvm::orc::JITDylib;

  static llvm::Expected<std::unique_ptr<Linker>>
  create(llvm::ArrayRef<runtime::RuntimeSymbol> runtime);
  ~Linker();

  struct Linked {
    Library *library = nullptr;
    /// The addresses of the linked functions, in the order in which they were
    /// asked for.
    std::vector<void *> addresses;
  };

  /// Links object code into the process and looks up the functions called
  /// `names` in it.
  llvm::Expected<Linked> link(llvm::ArrayRef<char> object,
                              llvm::ArrayRef<std::string> names);

  /// Frees the memory of one call of link(). The functions that this call
  /// linked must not be running.
  void unload(Library *library);
  int64_t numLinked() const { return linked.load(std::memory_order_relaxed); }

private:
  Linker();

  std::unique_ptr<llvm::orc::ExecutionSession> session;
  std::unique_ptr<llvm::orc::ObjectLinkingLayer> layer;
  Library *runtimeLibrary = nullptr;
  std::mutex mutex;
  /// Errors reported by the ORC session since the last failure.
  std::string reasons;
  uint64_t counter = 0;
  std::atomic<int64_t> linked{0};
  std::atomic<uint64_t> unloaded{0};
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_LINKER_H
