//===- Context.cpp - Contexts, trees and fields in the C API --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include "mlir/CAPI/IR.h"
#include "llvm/Config/llvm-config.h"
#include "llvm/Support/ErrorHandling.h"
#include <mutex>
#include <new>

using namespace mlir;
using namespace mlir::tai;

static StringRef toRef(const char *text) { return text ? text : ""; }

//===----------------------------------------------------------------------===//
// Context
//===----------------------------------------------------------------------===//

const char *taiVersion(void) { return TAI_VERSION_STRING; }

int taiVersionNumber(void) { return TAI_VERSION_NUMBER; }

const char *taiLLVMVersion(void) { return LLVM_VERSION_STRING; }

/// LLVM calls this function when its containers get no memory; LLVM would
/// otherwise end the process.
static void throwBadAlloc(void *, const char *, bool) {
  throw std::bad_alloc();
}

TaiContext taiContextCreate(void) {
  static std::once_flag once;
  try {
    std::call_once(
        once, [] { llvm::install_bad_alloc_error_handler(throwBadAlloc); });
    return new TaiContextImpl();
  } catch (...) {
    return nullptr;
  }
}

void taiContextDestroy(TaiContext context) { delete context; }

void taiStopBackgroundWork(void) {
  Background::stopAll();
  runtime::safepoint::stopClock();
}

int64_t taiListOptions(const TaiOptionRow **rows) {
  static constexpr TaiOptionRow table[] = {
#define TAI_OPTION(name, kind, initial, expects, about, to)                    \
  {name, initial, expects, about},
#include "tai/Support/Options.def"
  };
  *rows = table;
  return std::size(table);
}

TaiStatus taiContextSetOption(TaiContext context, const char *name,
                              const char *value) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(
        context->session.setOption(toRef(name), toRef(value)));
  });
}

MlirContext taiContextGetMlirContext(TaiContext context) {
  return wrap(context->session.getContext());
}

TaiError taiContextLastError(TaiContext context) {
  const Failure &failure = context->session.getFailure();
  return {static_cast<TaiStatus>(failure.kind),
          failure.message.c_str(),
          failure.file.c_str(),
          failure.line,
          failure.column,
          failure.text.c_str()};
}

TaiStatus taiContextSynchronize(TaiContext context) {
  return call(*context, [&]() -> TaiStatus {
    // On the CPU there is nothing to wait for, because launches have ended when
    // they return.
    return context->status(context->session.getRuntime().synchronize());
  });
}

void taiSetSafepointHandler(TaiSafepointHandler handler) {
  runtime::safepoint::setHandler(handler);
}

void taiContextInterrupt(TaiContext context) {
  context->session.getRuntime().interrupt();
}

void taiContextClearInterrupt(TaiContext context) {
  context->session.getRuntime().launcher().clearInterrupt();
}

void taiContextSetPrintHandler(TaiContext context, TaiPrintHandler handler,
                               void *user) {
  callQuietly(*context, [&] {
    runtime::Printer::Sink sink;
    if (handler)
      sink = [handler, user](std::string_view line) {
        handler(line.data(), line.size(), user);
      };
    context->session.getRuntime().setPrintSink(std::move(sink));
  });
}

void taiContextSetWarningHandler(TaiContext context, TaiWarningHandler handler,
                                 void *user) {
  callQuietly(*context, [&] {
    WarningLog::Handler sink;
    if (handler)
      sink = [handler, user](const Warning &warning, bool isOfGradient) {
        TaiWarning told = {
            warning.message.c_str(), warning.file.c_str(), warning.line,
            warning.column,          warning.text.c_str(), isOfGradient};
        handler(&told, user);
      };
    context->session.getWarnings().setHandler(std::move(sink));
  });
}

//===----------------------------------------------------------------------===//
// Trees and fields
//===----------------------------------------------------------------------===//

TaiStatus taiContextAddTree(TaiContext context, const char *name,
                            const char *layout) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(
        context->session.addTree(toRef(name), toRef(layout)));
  });
}

TaiStatus taiContextDestroyTree(TaiContext context, const char *name) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(context->session.destroyTree(toRef(name)));
  });
}

/// Returns the sparse level number `level` of the tree `name`; null after an
/// error.
static runtime::SparseNode *findLevel(TaiContext context, const char *name,
                                      int64_t level, TaiStatus &status,
                                      runtime::TreePtr *found = nullptr) {
  runtime::TreePtr tree = context->session.getRuntime().store().findTree(name);
  if (found)
    *found = tree;
  bool known =
      tree && level >= 0 && level < int64_t(tree->sparseNodes().size());
  status = context->status(
      known ? success()
            : context->session.fail(FailureKind::Usage,
                                    "there is no sparse level " + Twine(level) +
                                        " in a tree '" + name + "'"));
  return known ? tree->sparseNodes()[level].get() : nullptr;
}

TaiStatus taiContextGetSparseLevel(TaiContext context, const char *tree,
                                   int64_t level, TaiSparseLevel *result) {
  return call(*context, [&]() -> TaiStatus {
    TaiStatus status;
    if (const runtime::SparseNode *node =
            findLevel(context, tree, level, status))
      *result = {node->numCells(),  node->cellBytes(),   node->numActive(),
                 node->listsMade(), node->listsReused(), node->peakActive()};
    return status;
  });
}

TaiStatus taiContextGetActiveCells(TaiContext context, const char *tree,
                                   int64_t level, int64_t *cells,
                                   int64_t count) {
  return call(*context, [&]() -> TaiStatus {
    TaiStatus status;
    if (runtime::SparseNode *node = findLevel(context, tree, level, status)) {
      runtime::ActiveListPtr list = node->list();
      if (count != int64_t(list->cells.size()))
        return context->status(context->session.fail(
            FailureKind::Usage, "there are " + Twine(list->cells.size()) +
                                    " active cells, but room for " +
                                    Twine(count)));
      llvm::copy(list->cells, cells);
    }
    return status;
  });
}

TaiStatus taiContextSetActive(TaiContext context, const char *tree,
                              int64_t level, int64_t cell, int active) {
  return call(*context, [&]() -> TaiStatus {
    TaiStatus status;
    runtime::TreePtr found;
    runtime::SparseNode *node = findLevel(context, tree, level, status, &found);
    if (!node)
      return status;
    if (cell < 0 || cell >= node->numCells())
      return context->status(context->session.fail(
          FailureKind::Usage, "there is no cell " + Twine(cell) + " in " +
                                  node->info().label + ", which has " +
                                  Twine(node->numCells())));
    return context->status(
        context->session.setActive(found, level, cell, active != 0));
  });
}

TaiStatus taiContextDeactivateAll(TaiContext context, const char *tree,
                                  int64_t level) {
  return call(*context, [&]() -> TaiStatus {
    TaiStatus status;
    runtime::TreePtr found;
    if (!findLevel(context, tree, level, status, &found))
      return status;
    return context->status(context->session.setActive(found, level, -1, false));
  });
}

TaiStatus taiContextAddField(TaiContext context, const char *declaration,
                             TaiField *field) {
  return call(*context, [&]() -> TaiStatus {
    FailureOr<runtime::FieldPtr> made =
        context->session.addField(toRef(declaration));
    if (failed(made))
      return context->status(failure());
    *field = context->fields.add(std::unique_ptr<TaiFieldImpl>(
        new TaiFieldImpl{*context, std::move(*made)}));
    return TAI_OK;
  });
}

void taiFieldRelease(TaiField field) {
  callQuietly(field->context, [&] { field->context.fields.drop(field); });
}

bool taiContextHasKernel(TaiContext context, const char *name) {
  return context->session.hasCode(toRef(name));
}

TaiStatus taiContextCountObjects(TaiContext context,
                                 TaiContextObjects *objects) {
  return call(*context, [&]() -> TaiStatus {
    const SessionObjects held = context->session.countObjects();
    objects->trees = held.trees;
    objects->fields = held.fields;
    objects->declarations = held.declarations;
    objects->field_handles = context->fields.size();
    objects->kernel_handles = context->kernels.size();
    objects->tape_handles = context->tapes.size();
    objects->kernels = held.kernels;
    objects->kernel_codes = held.codes;
    objects->linked = held.linked;
    objects->failures = held.failures;
    return TAI_OK;
  });
}

TaiStatus taiFieldGetInfo(TaiField handle, TaiFieldInfo *info) {
  const runtime::Field &field = *handle->field;
  *info = TaiFieldInfo();
  info->type = static_cast<TaiScalarType>(field.scalar());
  info->rank = field.rank();
  llvm::copy(field.shape(), info->shape);
  llvm::copy(field.layout().offset, info->offset);
  info->element_rank = field.elementShape().size();
  llvm::copy(field.elementShape(), info->element_shape);
  return TAI_OK;
}

TaiStatus taiFieldReadF64(TaiField handle, const int64_t *indices,
                          int64_t component, double *value) {
  return callInParallel(handle->context, handle->context.session.getRuntime(),
                        [&]() -> TaiStatus {
                          return handle->context.status(handle->field->readF64(
                              indices, component, *value));
                        });
}

TaiStatus taiFieldWriteF64(TaiField handle, const int64_t *indices,
                           int64_t component, double value) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(context.session.getRuntime().writes().writeF64(
        *handle->field, indices, component, value));
  });
}

TaiStatus taiFieldReadI64(TaiField handle, const int64_t *indices,
                          int64_t component, int64_t *value) {
  return callInParallel(handle->context, handle->context.session.getRuntime(),
                        [&]() -> TaiStatus {
                          return handle->context.status(handle->field->readI64(
                              indices, component, *value));
                        });
}

TaiStatus taiFieldWriteI64(TaiField handle, const int64_t *indices,
                           int64_t component, int64_t value) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(context.session.getRuntime().writes().writeI64(
        *handle->field, indices, component, value));
  });
}

TaiStatus taiFieldReadElements(TaiField handle, const int64_t *indices,
                               int64_t count, void *values) {
  return call(handle->context, [&]() -> TaiStatus {
    return handle->context.status(
        handle->field->readElements(indices, count, values));
  });
}

TaiStatus taiFieldWriteElements(TaiField handle, const int64_t *indices,
                                int64_t count, const void *values) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(context.session.getRuntime().writes().writeElements(
        *handle->field, indices, count, values));
  });
}

TaiStatus taiFieldGetAddress(TaiField handle, const int64_t *indices,
                             void **address) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    const runtime::Tree &tree = handle->field->tree();
    int64_t offset = 0;
    runtime::Status status = handle->field->locate(indices, 0, offset);
    // Return the address that kernels use: with a device, an address in the
    // memory of the device.
    if (status && tree.mirror())
      status =
          context.session.getRuntime().deviceAddress(tree, offset, *address);
    else if (status)
      *address = tree.base() + offset;
    handle->field->settleZeros();
    tree.noteLent();
    return context.status(status);
  });
}

TaiStatus taiFieldCopyToHost(TaiField handle, void *array) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(
        context.session.getRuntime().copies().copyOut(*handle->field, array));
  });
}

TaiStatus taiFieldCopyFromHost(TaiField handle, const void *array) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(
        context.session.getRuntime().writes().copyIn(*handle->field, array));
  });
}

TaiStatus taiFieldFillF64(TaiField handle, double value) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(
        context.session.getRuntime().writes().fillF64(*handle->field, value));
  });
}

TaiStatus taiFieldFillI64(TaiField handle, int64_t value) {
  return call(handle->context, [&]() -> TaiStatus {
    TaiContextImpl &context = handle->context;
    return context.status(
        context.session.getRuntime().writes().fillI64(*handle->field, value));
  });
}

TaiStatus taiContextClearTangents(TaiContext context) {
  return call(*context, [&]() -> TaiStatus {
    context->session.getRuntime().gradients().clearTangents();
    return TAI_OK;
  });
}

TaiStatus taiContextClearGradients(TaiContext context) {
  return call(*context, [&]() -> TaiStatus {
    return context->status(context->session.getRuntime().gradients().clear());
  });
}
