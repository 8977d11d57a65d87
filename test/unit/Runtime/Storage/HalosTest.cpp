//===- HalosTest.cpp - Halos that are current -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

/// A halo of a field of eight numbers of four bytes.
static Halo makeHalo(const Field &field, int64_t before, int64_t after) {
  const char *base = field.tree().base() + field.layout().placeOffset;
  return {base, base, {8}, {4}, before, after};
}

TEST(RuntimeHalos, WiderHalosServeNarrowerFetches) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {8});
  runtime.halos().add(makeHalo(*x, 2, 1));
  EXPECT_TRUE(runtime.halos().isCurrent(makeHalo(*x, 1, 1)));
  EXPECT_FALSE(runtime.halos().isCurrent(makeHalo(*x, 2, 2)));
}

TEST(RuntimeHalos, BelongToARuntime) {
  Runtime one, other;
  FieldPtr x = makeField(one, "x", ScalarKind::F32, {8});
  FieldPtr y = makeField(other, "y", ScalarKind::F32, {8});
  one.halos().add(makeHalo(*x, 1, 1));
  EXPECT_FALSE(other.halos().isCurrent(makeHalo(*x, 1, 1)));
  // A write of the host removes the halos of its runtime alone.
  ASSERT_OK(other.writes().fillF64(*y, 1));
  EXPECT_TRUE(one.halos().isCurrent(makeHalo(*x, 1, 1)));
  ASSERT_OK(one.writes().fillF64(*x, 1));
  EXPECT_FALSE(one.halos().isCurrent(makeHalo(*x, 1, 1)));
}

TEST(RuntimeHalos, EndWithTheirTree) {
  Runtime runtime;
  TreePtr tree;
  ASSERT_OK(runtime.store().addTree("t", 64, tree));
  Halo halo{tree->base(), tree->base(), {8}, {4}, 1, 1};
  runtime.halos().add(halo);
  ASSERT_OK(runtime.destroyTree("t"));
  EXPECT_FALSE(runtime.halos().isCurrent(halo));
}
