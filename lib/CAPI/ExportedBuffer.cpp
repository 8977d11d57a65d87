//===- ExportedBuffer.cpp - Field memory for other libraries, in C --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"

using namespace mlir::tai;

struct TaiExportedBufferImpl {
  runtime::ExportedField exported;
};

TaiStatus taiFieldExport(TaiField field, TaiFieldMemory *memory,
                         TaiExportedBuffer *buffer) {
  return call(field->context, [&]() -> TaiStatus {
    TaiContextImpl &context = field->context;
    auto made = std::make_unique<TaiExportedBufferImpl>();
    TaiStatus status = context.status(context.session.getRuntime().exportField(
        *field->field, made->exported));
    if (status != TAI_OK)
      return status;
    *memory = {made->exported.address, made->exported.onDevice,
               made->exported.strides.data()};
    *buffer = made.release();
    return TAI_OK;
  });
}

void taiExportedBufferRelease(TaiExportedBuffer buffer) { delete buffer; }

TaiStatus taiFieldNoteWrite(TaiField field) {
  return call(field->context, [&]() -> TaiStatus {
    TaiContextImpl &context = field->context;
    return context.status(
        context.session.getRuntime().writes().noteOutside(*field->field));
  });
}

TaiStatus taiContextWaitForStream(TaiContext context, uint64_t stream) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(
        context->session.getRuntime().devices().waitForStream(stream));
  });
}

TaiStatus taiContextLetStreamWait(TaiContext context, uint64_t stream) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(
        context->session.getRuntime().devices().letStreamWait(stream));
  });
}

TaiStatus taiContextAllocateOnDevice(TaiContext context, int64_t bytes,
                                     void **address) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(
        context->session.getRuntime().devices().allocate(bytes, *address));
  });
}

void taiContextFreeOnDevice(TaiContext context, void *address) {
  callQuietly(*context,
              [&] { context->session.getRuntime().devices().free(address); });
}

TaiStatus taiContextCopyOnDevice(TaiContext context, void *to, const void *from,
                                 int64_t bytes) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(
        context->session.getRuntime().devices().copy(to, from, bytes));
  });
}

TaiStatus taiContextReadOnDevice(TaiContext context, const void *from,
                                 int64_t step, int64_t bytes, int64_t rows,
                                 void *to) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(context->session.getRuntime().devices().read(
        from, step, bytes, rows, to));
  });
}

int taiContextIsOnDevice(TaiContext context, const void *address) {
  return context->session.getRuntime().devices().isThere(address);
}

int taiContextIsOnGpu(TaiContext context) {
  const runtime::Device *device =
      context->session.getRuntime().devices().device();
  return device && device->kind() == runtime::DeviceKind::Cuda;
}
