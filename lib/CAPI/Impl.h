//===- Impl.h - The objects behind C API handles ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CAPI_IMPL_H
#define TAI_LIB_CAPI_IMPL_H

// The plain functions are defined in this library, without the macros of
// tai-c/Sizes.h.
#define TAI_PLAIN_FUNCTIONS
#include "tai-c/Tai.h"
#include "tai/ExecutionEngine/Modules/Program.h"
#include "tai/Runtime/Tape/Tape.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include <mutex>
#include <unordered_map>

/// Owns handles of the C API, and finds one by its address in constant time.
/// The map is not a DenseMap, which is damaged when memory runs out while it
/// grows.
template <typename Impl> class Handles {
public:
  Impl *add(std::unique_ptr<Impl> handle) {
    Impl *address = handle.get();
    owned.try_emplace(address, std::move(handle));
    return address;
  }
  void drop(Impl *handle) {
    auto found = owned.find(handle);
    if (found == owned.end())
      return;
    // The handle is removed from the map before it is destroyed, because its
    // destructor may remove other handles.
    std::unique_ptr<Impl> gone = std::move(found->second);
    owned.erase(found);
  }
  size_t size() const { return owned.size(); }

private:
  std::unordered_map<Impl *, std::unique_ptr<Impl>> owned;
};

/// A context of the C API, which owns every handle created in it that has not
/// been destroyed.
struct TaiContextImpl {
  /// The lock of the context. Every call holds it, except launches and accesses
  /// to single elements on the CPU: a context has one user at a time.
  std::recursive_timed_mutex mutex;
  mlir::tai::Session session;
  Handles<TaiFieldImpl> fields;
  Handles<TaiKernelImpl> kernels;
  Handles<TaiProgramImpl> programs;
  Handles<TaiTapeImpl> tapes;
  std::vector<mlir::tai::runtime::ProfileRow> profile;
  std::vector<TaiProfileRow> profileRows;
  std::vector<mlir::tai::runtime::ShadowRow> shadows;
  std::vector<TaiShadowRow> shadowRows;
  std::vector<TaiTraceEvent> traceEvents;
  std::vector<TaiSkipRow> skipRows;
  std::string lostTangents;
  /// Copies of arrays of structs for callers whose structs have another size
  /// than this library's, valid until the next such call.
  std::vector<uint64_t> sizedRows;

  /// Returns the C status for the result of a call of the session, which keeps
  /// the failure.
  TaiStatus status(llvm::LogicalResult result) {
    if (succeeded(result))
      return TAI_OK;
    return static_cast<TaiStatus>(session.getFailure().kind);
  }
  /// Returns the C status of a call of the runtime. If the call has not failed,
  /// a failure that the runtime has noted in a function without a status, such
  /// as one that frees memory, becomes the failure of the call.
  TaiStatus status(const mlir::tai::runtime::Status &result) {
    if (LLVM_LIKELY(result.ok() && !session.getRuntime().hasNotedFailure()))
      return TAI_OK;
    mlir::tai::runtime::Status noted = session.getRuntime().takeFailure();
    return status(session.fail(result ? noted : result));
  }
  TaiStatus usage(const llvm::Twine &message) {
    return status(session.fail(mlir::tai::FailureKind::Usage, message));
  }
  /// The status of a call that an exception has ended. The text is so short
  /// that it takes no memory.
  TaiStatus outOfMemory() noexcept {
    return status(
        session.fail(mlir::tai::FailureKind::Memory, "out of memory"));
  }
};

/// Locks the context. While waiting for another thread's call it passes
/// safepoints, so that the host language can let that thread run (as with
/// Python's GIL).
class ContextLock {
public:
  explicit ContextLock(TaiContextImpl &context)
      : lock(context.mutex, std::defer_lock) {
    mlir::tai::runtime::safepoint::lock(lock);
  }

private:
  std::unique_lock<std::recursive_timed_mutex> lock;
};

/// Locks the context only if there is a device. Used by calls that several
/// threads can make at once on the CPU: a device has one queue, and a thread
/// may wait for another thread's work.
class DeviceLock {
public:
  DeviceLock(TaiContextImpl &context, mlir::tai::runtime::Runtime &runtime)
      : lock(context.mutex, std::defer_lock) {
    if (LLVM_UNLIKELY(runtime.devices().device() != nullptr))
      mlir::tai::runtime::safepoint::lock(lock);
  }

private:
  std::unique_lock<std::recursive_timed_mutex> lock;
};

/// Every C function with a context runs its body in callOr or in a function
/// below. Libraries of C++ throw when memory runs out (LLVM by the handler of
/// taiContextCreate); no exception leaves the C API, and the locks of the call
/// are released.
template <typename Result, typename Body>
Result callOr(TaiContextImpl &context, Result otherwise,
              const Body &body) noexcept {
  try {
    ContextLock lock(context);
    return body();
  } catch (...) {
    (void)context.outOfMemory();
    return otherwise;
  }
}

template <typename Body>
TaiStatus call(TaiContextImpl &context, const Body &body) noexcept {
  return callOr(context, TAI_ERROR_MEMORY, body);
}

/// Runs `body` of a C function that cannot fail: if memory runs out, the rest
/// of `body` is left out.
template <typename Body>
void callQuietly(TaiContextImpl &context, const Body &body) noexcept {
  callOr(context, 0, [&] {
    body();
    return 0;
  });
}

/// Like callOr, but runs `body` with a DeviceLock instead of the context's
/// lock.
template <typename Body>
TaiStatus callInParallel(TaiContextImpl &context,
                         mlir::tai::runtime::Runtime &runtime,
                         const Body &body) noexcept {
  try {
    DeviceLock lock(context, runtime);
    return body();
  } catch (...) {
    return context.outOfMemory();
  }
}

struct TaiFieldImpl {
  TaiContextImpl &context;
  mlir::tai::runtime::FieldPtr field;
};

struct TaiKernelImpl {
  TaiContextImpl &context;
  mlir::tai::SessionKernel *kernel;
  std::string text;
  /// The program that the kernel belongs to, or null.
  TaiProgramImpl *program = nullptr;
  /// References kept here so that a launch reads fewer pointers: the runtime of
  /// `context`, and the runtime's kernel.
  mlir::tai::runtime::Runtime &runtime = context.session.getRuntime();
  mlir::tai::runtime::Kernel &launched = *kernel->kernel;
};

struct TaiProgramImpl {
  TaiContextImpl &context;
  std::unique_ptr<mlir::tai::Program> program;
  /// The handles of the program's kernels, by name.
  llvm::StringMap<TaiKernel> kernels;
  /// For each TaiSymbolKind, the names of the program's symbols of that kind.
  std::array<std::vector<std::string>, 6> symbols;
};

struct TaiTapeImpl {
  TaiContextImpl &context;
  std::unique_ptr<mlir::tai::runtime::Tape> tape;
  std::string explanation;
  std::vector<TaiTapeAccess> accesses;
  std::vector<TaiTapeHealthRow> health;
  std::vector<TaiViolation> violations;
};

/// Calls back into the host's language. If the callback fails, its failure is
/// the context's last error, or `otherwise` if the last error is of another
/// kind.
mlir::tai::runtime::Status callBack(TaiContextImpl &context,
                                    TaiStatus (*callback)(void *user),
                                    void *user, llvm::StringRef otherwise);

#endif // TAI_LIB_CAPI_IMPL_H
