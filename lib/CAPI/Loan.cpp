//===- Loan.cpp - C functions to share fields with other libraries --------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"

using namespace mlir::tai;

struct TaiLoanImpl {
  runtime::LentField lent;
};

TaiStatus taiFieldLend(TaiField field, TaiFieldMemory *memory, TaiLoan *loan) {
  ContextLock lock(field->context);
  TaiContextImpl &context = field->context;
  auto made = std::make_unique<TaiLoanImpl>();
  TaiStatus status = context.status(
      context.session.getRuntime().lend(*field->field, made->lent));
  if (status != TAI_OK)
    return status;
  *memory = {made->lent.address, made->lent.onDevice,
             made->lent.strides.data()};
  *loan = made.release();
  return TAI_OK;
}

void taiLoanEnd(TaiLoan loan) { delete loan; }

TaiStatus taiFieldNoteWrite(TaiField field) {
  ContextLock lock(field->context);
  TaiContextImpl &context = field->context;
  return context.status(
      context.session.getRuntime().noteOutsideWrite(*field->field));
}

TaiStatus taiContextWaitForStream(TaiContext context, uint64_t stream) {
  ContextLock lock(*context);
  return context->status(context->session.getRuntime().waitForStream(stream));
}

TaiStatus taiContextLetStreamWait(TaiContext context, uint64_t stream) {
  ContextLock lock(*context);
  return context->status(context->session.getRuntime().letStreamWait(stream));
}

TaiStatus taiContextAllocateOnDevice(TaiContext context, int64_t bytes,
                                     void **address) {
  ContextLock lock(*context);
  return context->status(
      context->session.getRuntime().allocateOnDevice(bytes, *address));
}

void taiContextFreeOnDevice(TaiContext context, void *address) {
  ContextLock lock(*context);
  context->session.getRuntime().freeOnDevice(address);
}

TaiStatus taiContextCopyOnDevice(TaiContext context, void *to, const void *from,
                                 int64_t bytes) {
  ContextLock lock(*context);
  return context->status(
      context->session.getRuntime().copyOnDevice(to, from, bytes));
}

int taiContextIsOnDevice(TaiContext context, const void *address) {
  return context->session.getRuntime().isOnDevice(address);
}

int taiContextIsOnGpu(TaiContext context) {
  const runtime::Device *device = context->session.getRuntime().getDevice();
  return device && device->kind() == runtime::DeviceKind::Cuda;
}
