//===-- tai-c/Sizes.h - Structs that may grow ---------------------*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Later versions may add members at the end of these structs. So that programs
// and libtai of different versions agree, each function that fills such a
// struct has a second form with the size of the caller's struct. C and C++ call
// this form without a change: the macros below add the size. With the size of
// an older version, libtai leaves out the members that the older struct does
// not have; with the size of a newer version, members that libtai does not know
// are zero. Rows form an array of elements of the given size.
//
// The plain functions, for languages without these macros, give the structs of
// version 0.2. All other structs of tai-c never change.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_C_SIZES_H
#define TAI_C_SIZES_H

#include "tai-c/Tai.h"

#ifdef __cplusplus
extern "C" {
#endif

TAI_EXPORT TaiStatus taiFieldGetInfoSized(TaiField field, TaiFieldInfo *info,
                                          size_t size);
TAI_EXPORT TaiStatus taiContextGetSparseLevelSized(TaiContext context,
                                                   const char *tree,
                                                   int64_t level,
                                                   TaiSparseLevel *result,
                                                   size_t size);
TAI_EXPORT TaiStatus taiContextCountObjectsSized(TaiContext context,
                                                 TaiContextObjects *objects,
                                                 size_t size);
TAI_EXPORT TaiStatus taiFieldExportSized(TaiField field, TaiFieldMemory *memory,
                                         TaiExportedBuffer *buffer,
                                         size_t size);
TAI_EXPORT TaiStatus taiTapeGetStatsSized(TaiTape tape, TaiTapeStats *stats,
                                          size_t size);

TAI_EXPORT TaiStatus taiTapeRecordAccessesSized(TaiTape tape, int64_t record,
                                                const TaiTapeAccess **rows,
                                                int64_t *count, size_t size);
TAI_EXPORT TaiStatus taiTapeHealthSized(TaiTape tape,
                                        const TaiTapeHealthRow **rows,
                                        int64_t *count, size_t size);
TAI_EXPORT TaiStatus taiTapeViolationsSized(TaiTape tape,
                                            const TaiViolation **rows,
                                            int64_t *count, int64_t *total,
                                            size_t size);
TAI_EXPORT TaiStatus taiProfilerRowsSized(TaiContext context,
                                          const TaiProfileRow **rows,
                                          int64_t *count, size_t size);
TAI_EXPORT TaiStatus taiProfilerTraceSized(TaiContext context,
                                           const TaiTraceEvent **events,
                                           int64_t *count, int64_t *lost,
                                           size_t size);
TAI_EXPORT TaiStatus taiShadowRowsSized(TaiContext context,
                                        const TaiShadowRow **rows,
                                        int64_t *count, size_t size);
TAI_EXPORT TaiStatus taiProfilerSkipsSized(TaiContext context,
                                           const TaiSkipRow **rows,
                                           int64_t *count, size_t size);

#ifdef __cplusplus
}
#endif

#ifndef TAI_PLAIN_FUNCTIONS
#define taiFieldGetInfo(field, info)                                           \
  taiFieldGetInfoSized(field, info, sizeof(TaiFieldInfo))
#define taiContextGetSparseLevel(context, tree, level, result)                 \
  taiContextGetSparseLevelSized(context, tree, level, result,                  \
                                sizeof(TaiSparseLevel))
#define taiContextCountObjects(context, objects)                               \
  taiContextCountObjectsSized(context, objects, sizeof(TaiContextObjects))
#define taiFieldExport(field, memory, buffer)                                  \
  taiFieldExportSized(field, memory, buffer, sizeof(TaiFieldMemory))
#define taiTapeGetStats(tape, stats)                                           \
  taiTapeGetStatsSized(tape, stats, sizeof(TaiTapeStats))
#define taiTapeRecordAccesses(tape, record, rows, count)                       \
  taiTapeRecordAccessesSized(tape, record, rows, count, sizeof(TaiTapeAccess))
#define taiTapeHealth(tape, rows, count)                                       \
  taiTapeHealthSized(tape, rows, count, sizeof(TaiTapeHealthRow))
#define taiTapeViolations(tape, rows, count, total)                            \
  taiTapeViolationsSized(tape, rows, count, total, sizeof(TaiViolation))
#define taiProfilerRows(context, rows, count)                                  \
  taiProfilerRowsSized(context, rows, count, sizeof(TaiProfileRow))
#define taiProfilerTrace(context, events, count, lost)                         \
  taiProfilerTraceSized(context, events, count, lost, sizeof(TaiTraceEvent))
#define taiShadowRows(context, rows, count)                                    \
  taiShadowRowsSized(context, rows, count, sizeof(TaiShadowRow))
#define taiProfilerSkips(context, rows, count)                                 \
  taiProfilerSkipsSized(context, rows, count, sizeof(TaiSkipRow))
#endif // TAI_PLAIN_FUNCTIONS

#endif // TAI_C_SIZES_H
