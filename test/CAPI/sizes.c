/*===- sizes.c - Structs of other versions of the C API ----------*- C -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A program of an older version gives libtai smaller structs, and one of a newer
// version larger ones.
//
//===----------------------------------------------------------------------===*/

#include "tai-c/Tai.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static TaiContext context;

static void require(bool holds, int line) {
  if (holds)
    return;
  printf("line %d: %s\n", line, taiContextLastError(context).diagnostics);
  exit(1);
}
#define REQUIRE(condition) require(condition, __LINE__)

/* As TaiFieldInfo was before, and will be. */
typedef struct OldInfo {
  TaiScalarType type;
  int rank;
  int64_t shape[TAI_MAX_RANK];
} OldInfo;
typedef struct NewInfo {
  TaiFieldInfo known;
  int64_t later[3];
} NewInfo;

/* The same for rows of counters. */
typedef struct OldRow {
  const char *skip, *counter;
} OldRow;
typedef struct NewRow {
  TaiSkipRow known;
  const char *later;
} NewRow;

int main(void) {
  REQUIRE(taiVersionNumber() == TAI_VERSION_NUMBER);
  REQUIRE(TAI_VERSION_NUMBER == TAI_VERSION_MAJOR * 10000 +
                                    TAI_VERSION_MINOR * 100 +
                                    TAI_VERSION_PATCH);
  REQUIRE(strcmp(taiVersion(), TAI_VERSION_STRING) == 0);
  context = taiContextCreate();
  TaiField x;
  REQUIRE(!taiContextAddTree(context, "t",
                             "!tai.root<dense<[i: 3, j: 5], {x: f32}>>"));
  REQUIRE(!taiContextAddField(context, "tai.field @x = @t[\"x\"] : f32, rank 2",
                              &x));

  /* The macro, and the function of languages without it. */
  TaiFieldInfo info, plain;
  REQUIRE(!taiFieldGetInfo(x, &info));
  REQUIRE(!(taiFieldGetInfo)(x, &plain));
  REQUIRE(info.rank == 2 && info.shape[1] == 5 && info.type == TAI_F32);
  REQUIRE(plain.rank == 2 && plain.shape[1] == 5 && plain.type == TAI_F32);

  /* Nothing is written behind an older struct. */
  struct {
    OldInfo info;
    int64_t behind;
  } old = {.behind = 77};
  REQUIRE(!taiFieldGetInfoSized(x, (TaiFieldInfo *)&old.info, sizeof(OldInfo)));
  REQUIRE(old.info.rank == 2 && old.info.shape[0] == 3 && old.behind == 77);

  /* Members that libtai does not know are zero. */
  NewInfo later;
  memset(&later, 0x55, sizeof(later));
  REQUIRE(!taiFieldGetInfoSized(x, &later.known, sizeof(later)));
  REQUIRE(later.known.shape[0] == 3 && later.later[0] == 0 &&
          later.later[2] == 0);

  /* A failure leaves the struct alone. */
  TaiSparseLevel level = {.numCells = 12};
  REQUIRE(taiContextGetSparseLevel(context, "t", 4, &level) ==
          TAI_ERROR_USAGE);
  REQUIRE(level.numCells == 12);

  const TaiSkipRow *rows, *olderRows, *newerRows;
  int64_t count, older, newer;
  REQUIRE(!taiProfilerSkips(context, &rows, &count));
  REQUIRE(count > 10 && rows[count - 1].skip != NULL);
  char last[100];
  snprintf(last, sizeof(last), "%s", rows[count - 1].counter);
  REQUIRE(!taiProfilerSkipsSized(context, &olderRows, &older, sizeof(OldRow)));
  const OldRow *oldRows = (const OldRow *)olderRows;
  REQUIRE(older == count && strcmp(oldRows[count - 1].counter, last) == 0);
  REQUIRE(!taiProfilerSkipsSized(context, &newerRows, &newer, sizeof(NewRow)));
  const NewRow *newRows = (const NewRow *)newerRows;
  REQUIRE(newer == count && newRows[count - 1].later == NULL);
  REQUIRE(strcmp(newRows[count - 1].known.counter, last) == 0);

  /* No struct has such a size. */
  REQUIRE(taiProfilerSkipsSized(context, &rows, &count, 0) == TAI_ERROR_USAGE);
  REQUIRE(taiProfilerSkipsSized(context, &rows, &count, 17) == TAI_ERROR_USAGE);
  printf("refused: %s\n", taiContextLastError(context).message);
  taiContextDestroy(context);
  printf("done\n");
  return 0;
}
