//===- Kernel.cpp - Kernels and tapes in the C API ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include "mlir/CAPI/IR.h"
#include "mlir/CAPI/Utils.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Kernels
//===----------------------------------------------------------------------===//

static TaiKernel keep(TaiContextImpl &context, SessionKernel *kernel) {
  return context.kernels.add(
      std::unique_ptr<TaiKernelImpl>(new TaiKernelImpl{context, kernel, ""}));
}

TaiStatus taiKernelCreate(TaiContext context, MlirModule module,
                          const char *name, TaiKernel *kernel) {
  return call(*context, [&]() -> TaiStatus {
    OwningOpRef<ModuleOp> owned(unwrap(module));
    if (!name)
      return context->usage("a kernel needs a name");
    FailureOr<SessionKernel *> made =
        context->session.createKernel(std::move(owned), name);
    if (failed(made))
      return context->status(failure());
    *kernel = keep(*context, *made);
    return TAI_OK;
  });
}

TaiStatus taiKernelLoad(TaiContext context, const char *bytes, size_t size,
                        const char *file, const char *name, TaiKernel *kernel) {
  return call(*context, [&]() -> TaiStatus {
    if (!bytes)
      return context->usage("there is no kernel to load: 'bytes' is null");
    FailureOr<SessionKernel *> made = context->session.parseKernel(
        StringRef(bytes, size), file ? file : "", name ? name : "");
    if (failed(made))
      return context->status(failure());
    *kernel = keep(*context, *made);
    return TAI_OK;
  });
}

TaiStatus taiKernelParse(TaiContext context, const char *text, const char *file,
                         const char *name, TaiKernel *kernel) {
  StringRef given = text ? text : "";
  return taiKernelLoad(context, given.data(), given.size(), file, name, kernel);
}

TaiStatus taiModuleWrite(TaiContext context, MlirModule module,
                         MlirStringCallback callback, void *userData) {
  return call(*context, [&]() -> TaiStatus {
    mlir::detail::CallbackOstream stream(callback, userData);
    if (failed(writeModule(unwrap(module), stream)))
      return context->usage("the module cannot be written as bytecode");
    return TAI_OK;
  });
}

void taiKernelDestroy(TaiKernel kernel) {
  callQuietly(kernel->context, [&] {
    TaiContextImpl &context = kernel->context;
    context.session.getRuntime().launcher().running().waitForVisits();
    if (TaiProgramImpl *program = kernel->program)
      program->kernels.erase(kernel->kernel->code->getName());
    else
      context.session.destroyKernel(kernel->kernel);
    context.kernels.drop(kernel);
  });
}

const char *taiKernelGetTree(TaiKernel kernel, int64_t number) {
  const std::vector<runtime::TreePtr> &trees = kernel->kernel->code->getTrees();
  if (number < 0 || number >= static_cast<int64_t>(trees.size()))
    return nullptr;
  return trees[number]->name().c_str();
}

/// Compiles the kernel, without locking the context.
static TaiStatus resolve(TaiKernelImpl &kernel) noexcept {
  try {
    // If compilation succeeds, failures that the context has noted are not
    // read: another thread's call may be noting one at the same time.
    runtime::Status status = kernel.launched.resolve();
    return status ? TAI_OK : kernel.context.status(status);
  } catch (...) {
    return kernel.context.outOfMemory();
  }
}

TaiStatus taiKernelLaunch(TaiKernel kernel, const uint64_t *args, int64_t slots,
                          uint64_t *results) {
  TaiContextImpl &context = kernel->context;
  // The kernel is compiled before the context is locked: compilation takes
  // long, and other threads may go on meanwhile.
  if (LLVM_UNLIKELY(kernel->runtime.devices().device() != nullptr) &&
      !kernel->launched.resolved())
    if (TaiStatus status = resolve(*kernel); status != TAI_OK)
      return status;
  return callInParallel(context, kernel->runtime, [&]() -> TaiStatus {
    return context.status(
        kernel->runtime.launch(kernel->launched, args, slots, results));
  });
}

TaiStatus taiKernelLaunchGrad(TaiKernel kernel, const uint64_t *args,
                              int64_t slots) {
  return call(kernel->context, [&]() -> TaiStatus {
    return kernel->context.status(
        kernel->runtime.launchAdjoint(kernel->launched, args, slots));
  });
}

bool taiKernelReadsInReverse(TaiKernel kernel, int64_t slot) {
  return llvm::is_contained(kernel->launched.adjoint().plan().arrays, slot);
}

TaiStatus taiKernelsCompile(TaiContext context, TaiKernel *kernels,
                            int64_t count, bool adjoints) {
  return call(*context, [&]() -> TaiStatus {
    SmallVector<SessionKernel *> list;
    for (int64_t i = 0; i < count; ++i)
      list.push_back(kernels[i]->kernel);
    return context->status(context->session.compile(list, adjoints));
  });
}

TaiStatus taiKernelGetIR(TaiKernel kernel, const char *stage,
                         const char **text) {
  return call(kernel->context, [&]() -> TaiStatus {
    TaiContextImpl &context = kernel->context;
    FailureOr<std::string> printed =
        context.session.getIR(*kernel->kernel, stage ? stage : "");
    if (failed(printed))
      return context.status(failure());
    kernel->text = std::move(*printed);
    *text = kernel->text.c_str();
    return TAI_OK;
  });
}

//===----------------------------------------------------------------------===//
// Tape
//===----------------------------------------------------------------------===//

TaiStatus taiTapeBegin(TaiContext context, TaiField loss, bool clearGradients,
                       TaiTape *tape) {
  return call(*context, [&]() -> TaiStatus {
    std::unique_ptr<runtime::Tape> made;
    TaiStatus status = context->status(context->session.getRuntime().beginTape(
        loss ? loss->field : nullptr, clearGradients, made));
    if (status != TAI_OK)
      return status;
    *tape = context->tapes.add(std::unique_ptr<TaiTapeImpl>(
        new TaiTapeImpl{*context, std::move(made), {}, {}, {}, {}}));
    return TAI_OK;
  });
}

TaiStatus taiTapeEnd(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    tape->tape->end();
    tape->tape->releaseFields();
    return tape->context.status(runtime::Status::success());
  });
}

TaiStatus taiTapeEndToSweep(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    tape->tape->end(/*isSwept=*/true);
    return tape->context.status(runtime::Status::success());
  });
}

TaiStatus taiTapeClearGradients(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    return tape->context.status(tape->tape->clearGradients());
  });
}

TaiStatus taiTapeBackward(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    TaiContextImpl &context = tape->context;
    if (failed(context.session.prepareReverse(*tape->tape, /*cleared=*/false)))
      return context.status(failure());
    return context.status(tape->tape->backward());
  });
}

TaiStatus taiTapeReplay(TaiTape tape, bool forward, bool backward) {
  return call(tape->context, [&]() -> TaiStatus {
    TaiContextImpl &context = tape->context;
    if (backward &&
        failed(context.session.prepareReverse(*tape->tape, /*cleared=*/true)))
      return context.status(failure());
    return context.status(tape->tape->replay(forward, backward));
  });
}

runtime::Status callBack(TaiContextImpl &context,
                         TaiStatus (*callback)(void *user), void *user,
                         StringRef otherwise) {
  TaiStatus status = callback(user);
  if (status == TAI_OK)
    return runtime::Status::success();
  Failure failure = context.session.getFailure();
  if (failure.kind != static_cast<FailureKind>(status))
    failure = Failure::get(static_cast<FailureKind>(status), otherwise);
  return context.session.keepFailure(std::move(failure));
}

static std::function<runtime::Status()>
wrapCallback(TaiContextImpl &context, TaiTapeCallback callback, void *user) {
  if (!callback)
    return nullptr;
  return [&context, callback, user] {
    return callBack(context, callback, user,
                    "a function recorded by the tape failed");
  };
}

TaiStatus taiTapeRecordCallback(TaiTape tape, TaiTapeCallback forward,
                                TaiTapeCallback backward, void *user) {
  return call(tape->context, [&]() -> TaiStatus {
    TaiContextImpl &context = tape->context;
    if (!tape->tape->recording())
      return context.usage("the tape does not record");
    tape->tape->recordCallback({wrapCallback(context, forward, user),
                                wrapCallback(context, backward, user)});
    return TAI_OK;
  });
}

TaiStatus taiTapeSuspend(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    tape->tape->suspend();
    return TAI_OK;
  });
}

TaiStatus taiTapeResume(TaiTape tape) {
  return call(tape->context, [&]() -> TaiStatus {
    return tape->context.status(tape->tape->resume());
  });
}

const char *taiTapeExplain(TaiTape tape) {
  return callOr(
      tape->context, static_cast<const char *>(nullptr), [&]() -> const char * {
        tape->explanation = tape->tape->explain();
        std::vector<const mlir::tai::runtime::Kernel *> known;
        for (int64_t i = 0, e = tape->tape->numRecords(); i != e; ++i) {
          const auto *kernel = tape->tape->kernelOf(i);
          if (!kernel || llvm::is_contained(known, kernel))
            continue;
          known.push_back(kernel);
          tape->explanation += tape->context.session.explainGathers(kernel);
        }
        return tape->explanation.c_str();
      });
}

int64_t taiTapeNumRecords(TaiTape tape) {
  return callOr(tape->context, int64_t(0),
                [&]() -> int64_t { return tape->tape->numRecords(); });
}

int64_t taiTapeNumSkipped(TaiTape tape) {
  return callOr(tape->context, int64_t(0),
                [&]() -> int64_t { return tape->tape->numSkipped(); });
}

void taiTapeDestroy(TaiTape tape) {
  callQuietly(tape->context, [&] { tape->context.tapes.drop(tape); });
}
