//===- Sizes.cpp - Structs of other versions in the C API -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A struct that gets new members keeps its old members where they are. The
// plain functions then fill the struct of version 0.2, by calls of the
// functions here.
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include <algorithm>
#include <cstring>

/// Writes the members that both the library and the caller know, and zeroes the
/// further members of the caller's struct.
template <typename Struct>
static void give(const Struct &known, void *to, size_t size) {
  size_t common = std::min(size, sizeof(Struct));
  std::memcpy(to, &known, common);
  std::memset(static_cast<char *>(to) + common, 0, size - common);
}

/// Replaces an array of structs by a copy in which each struct has `size`
/// bytes.
template <typename Row>
static TaiStatus give(TaiContextImpl &context, const Row **rows, int64_t count,
                      size_t size) {
  if (size == sizeof(Row))
    return TAI_OK;
  // The size of the caller's struct must be a multiple of the alignment of its
  // members.
  if (size < alignof(Row) || size % alignof(Row))
    return context.usage("a row cannot have " + llvm::Twine(size) + " bytes");
  std::vector<uint64_t> &memory = context.sizedRows;
  memory.assign((count * size + 7) / 8, 0);
  char *bytes = reinterpret_cast<char *>(memory.data());
  for (int64_t i = 0; i < count; ++i)
    give((*rows)[i], bytes + i * size, size);
  *rows = reinterpret_cast<const Row *>(bytes);
  return TAI_OK;
}

/// Calls `get` to fill a struct of this library's version, and copies the
/// members that the caller's version of the struct has.
template <typename Struct, typename Call>
static TaiStatus fill(Struct *to, size_t size, const Call &get) {
  Struct known = {};
  TaiStatus status = get(&known);
  if (status == TAI_OK)
    give(known, to, size);
  return status;
}

/// Calls `get` for an array of rows, and copies the rows to the size that the
/// caller knows. The context stays locked until they are copied.
template <typename Row, typename Call>
static TaiStatus fillRows(TaiContextImpl &context, const Row **rows,
                          int64_t *count, size_t size, const Call &get) {
  return call(context, [&]() -> TaiStatus {
    TaiStatus status = get();
    return status == TAI_OK ? give(context, rows, *count, size) : status;
  });
}

TaiStatus taiFieldGetInfoSized(TaiField field, TaiFieldInfo *info,
                               size_t size) {
  return fill(info, size,
              [&](TaiFieldInfo *to) { return taiFieldGetInfo(field, to); });
}

TaiStatus taiContextGetSparseLevelSized(TaiContext context, const char *tree,
                                        int64_t level, TaiSparseLevel *result,
                                        size_t size) {
  return fill(result, size, [&](TaiSparseLevel *to) {
    return taiContextGetSparseLevel(context, tree, level, to);
  });
}

TaiStatus taiContextCountObjectsSized(TaiContext context,
                                      TaiContextObjects *objects, size_t size) {
  return fill(objects, size, [&](TaiContextObjects *to) {
    return taiContextCountObjects(context, to);
  });
}

TaiStatus taiFieldExportSized(TaiField field, TaiFieldMemory *memory,
                              TaiExportedBuffer *buffer, size_t size) {
  return fill(memory, size, [&](TaiFieldMemory *to) {
    return taiFieldExport(field, to, buffer);
  });
}

TaiStatus taiTapeGetStatsSized(TaiTape tape, TaiTapeStats *stats, size_t size) {
  return fill(stats, size,
              [&](TaiTapeStats *to) { return taiTapeGetStats(tape, to); });
}

TaiStatus taiTapeRecordAccessesSized(TaiTape tape, int64_t record,
                                     const TaiTapeAccess **rows, int64_t *count,
                                     size_t size) {
  return fillRows(tape->context, rows, count, size, [&] {
    return taiTapeRecordAccesses(tape, record, rows, count);
  });
}

TaiStatus taiTapeHealthSized(TaiTape tape, const TaiTapeHealthRow **rows,
                             int64_t *count, size_t size) {
  return fillRows(tape->context, rows, count, size,
                  [&] { return taiTapeHealth(tape, rows, count); });
}

TaiStatus taiTapeViolationsSized(TaiTape tape, const TaiViolation **rows,
                                 int64_t *count, int64_t *total, size_t size) {
  return fillRows(tape->context, rows, count, size,
                  [&] { return taiTapeViolations(tape, rows, count, total); });
}

TaiStatus taiProfilerRowsSized(TaiContext context, const TaiProfileRow **rows,
                               int64_t *count, size_t size) {
  return fillRows(*context, rows, count, size,
                  [&] { return taiProfilerRows(context, rows, count); });
}

TaiStatus taiProfilerTraceSized(TaiContext context,
                                const TaiTraceEvent **events, int64_t *count,
                                int64_t *lost, size_t size) {
  return fillRows(*context, events, count, size, [&] {
    return taiProfilerTrace(context, events, count, lost);
  });
}

TaiStatus taiShadowRowsSized(TaiContext context, const TaiShadowRow **rows,
                             int64_t *count, size_t size) {
  return fillRows(*context, rows, count, size,
                  [&] { return taiShadowRows(context, rows, count); });
}

TaiStatus taiProfilerSkipsSized(TaiContext context, const TaiSkipRow **rows,
                                int64_t *count, size_t size) {
  return fillRows(*context, rows, count, size,
                  [&] { return taiProfilerSkips(context, rows, count); });
}
