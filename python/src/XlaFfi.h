//===- XlaFfi.h - The binary interface of XLA's foreign calls ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The part of XLA's FFI (version 0.1 and later) that a handler of buffers,
// scalar attributes and the stream needs. Structures begin with their size and
// only grow at the end, so the module is compiled without jaxlib's headers.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_XLAFFI_H
#define TAI_PYTHON_XLAFFI_H

#include <cstddef>
#include <cstdint>

namespace taipy::xla {

struct Extension {
  size_t size;
  int32_t type;
  Extension *next;
};

struct Version {
  size_t size;
  Extension *extensions;
  int32_t major, minor;
};

struct Error;

enum ErrorCode : int32_t { kInvalidArgument = 3, kInternal = 13 };

struct ErrorCreateArgs {
  size_t size;
  Extension *extensions;
  const char *message;
  int32_t code;
};

struct StreamGetArgs {
  size_t size;
  Extension *extensions;
  void *context;
  void *stream; // out
};

/// The functions that XLA gives to handlers.
struct Api {
  size_t size;
  Extension *extensions;
  Version version;
  const void *internal;
  Error *(*createError)(ErrorCreateArgs *);
  void *getErrorMessage;
  void *destroyError;
  void *registerHandler;
  Error *(*getStream)(StreamGetArgs *);
};

enum DataType : int32_t {
  kPred = 1,
  kS8 = 2,
  kS16 = 3,
  kS32 = 4,
  kS64 = 5,
  kU8 = 6,
  kU16 = 7,
  kU32 = 8,
  kU64 = 9,
  kF16 = 10,
  kF32 = 11,
  kF64 = 12
};

struct Buffer {
  size_t size;
  Extension *extensions;
  int32_t type;
  void *data;
  int64_t rank;
  int64_t *extents;
};

/// Arguments, and results.
struct Buffers {
  size_t size;
  Extension *extensions;
  int64_t count;
  int32_t *kinds;
  void **buffers;
};

struct Span {
  const char *data;
  size_t length;
};

struct Scalar {
  int32_t type;
  void *value;
};

enum AttributeKind : int32_t { kScalar = 3 };

struct Attributes {
  size_t size;
  Extension *extensions;
  int64_t count;
  int32_t *kinds;
  Span **names;
  void **values;
};

enum Stage : int32_t { kExecute = 3 };

struct CallFrame {
  size_t size;
  Extension *extensions;
  const Api *api;
  void *context;
  int32_t stage;
  Buffers arguments, results;
  Attributes attributes;
};

constexpr int32_t kMetadataExtension = 1;

struct Metadata {
  size_t size;
  Version version;
  uint32_t traits;
};

struct MetadataExtension {
  Extension base;
  Metadata *metadata;
};

static_assert(sizeof(Buffer) == 48 && sizeof(Attributes) == 48 &&
                  sizeof(CallFrame) == 40 + 2 * 40 + 48,
              "the layout is that of XLA");

} // namespace taipy::xla

#endif // TAI_PYTHON_XLAFFI_H
