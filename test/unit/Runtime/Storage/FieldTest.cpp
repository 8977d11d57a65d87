//===- FieldTest.cpp - Trees, fields and host access ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>
#include <unistd.h>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

TEST(RuntimeTree, IsZeroAndAligned) {
  Runtime runtime;
  for (int i = 0; i < 20; ++i) {
    TreePtr tree;
    ASSERT_OK(runtime.store().addTree("t" + std::to_string(i), 5000, tree));
    EXPECT_EQ(reinterpret_cast<uintptr_t>(tree->base()) % 64, 0u);
    for (int64_t b = 0; b < tree->bytes(); ++b)
      ASSERT_EQ(tree->base()[b], 0);
    std::memset(tree->base(), 1, 5000);
  }
}

TEST(RuntimeTree, RefusesWhatDoesNotFit) {
  Options options;
  options.memoryLimit = 1 << 20;
  Runtime runtime(options);
  TreePtr small, large;
  ASSERT_OK(runtime.store().addTree("small", 600 << 10, small));
  Status status = runtime.store().addTree("large", 700 << 10, large);
  EXPECT_EQ(status.code(), StatusCode::Memory);
  EXPECT_EQ(status.message(),
            "out of memory: tree 'large' needs 700.0 KiB, 600.0 KiB of 1.0 MiB "
            "are taken by 1 other trees");
  // The runtime still works, and freed memory can be allocated again.
  ASSERT_OK(runtime.destroyTree("small"));
  EXPECT_OK(runtime.store().addTree("large", 700 << 10, large));
  EXPECT_EQ(runtime.store().addTree("huge", INT64_MAX, small).code(),
            StatusCode::Memory);
}

TEST(RuntimeTree, NamesAreDistinct) {
  Runtime runtime;
  TreePtr tree;
  ASSERT_OK(runtime.store().addTree("a", 8, tree));
  EXPECT_EQ(runtime.store().addTree("a", 8, tree).code(), StatusCode::Usage);
  EXPECT_EQ(runtime.destroyTree("b").code(), StatusCode::Usage);
}

TEST(RuntimeTree, HandlesOutliveTheTree) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {8});
  auto kernel = makeKernel(runtime, "k", [](TaiFrame *) { return 0; },
                           {{x, AccessKind::Read}});
  ASSERT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
  ASSERT_OK(runtime.destroyTree("x_tree"));
  EXPECT_FALSE(x->valid());
  double value;
  int64_t index = 0;
  EXPECT_EQ(x->readF64(&index, 0, value).message(),
            "field 'x' is gone: its tree 'x_tree' has been destroyed");
  EXPECT_EQ(runtime.writes().fillF64(*x, 1).code(), StatusCode::Usage);
  EXPECT_EQ(runtime.copies().copyOut(*x, &value).code(), StatusCode::Usage);
  EXPECT_EQ(runtime.store().findField("x"), nullptr);
  EXPECT_EQ(runtime.launch(*kernel, nullptr, 0, nullptr).message(),
            "kernel 'k' uses tree 'x_tree', which has been destroyed");
  // The names are free again.
  x = makeField(runtime, "x", ScalarKind::F64, {4});
  set(*x, {3}, 2.5);
  EXPECT_EQ(get(*x, {3}), 2.5);
}

// A kernel was compiled for the layout of a tree; a later tree of the same name
// may have another layout.
TEST(RuntimeTree, KernelsStayWithTheirTree) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {8});
  KernelInfo info;
  info.name = "k";
  info.trees = {runtime.store().findTree("x_tree")};
  provide(info).onCompile = [&](Kernel &kernel, TaiKernelFn &function) {
    kernel.setTrees({runtime.store().findTree("x_tree")});
    function = [](TaiFrame *) { return 0; };
    return Status::success();
  };
  KernelPtr late = runtime.launcher().kernels().create(info);
  KernelPtr never = runtime.launcher().kernels().create(info);
  ASSERT_OK(runtime.destroyTree("x_tree"));
  EXPECT_EQ(runtime.launch(*never, nullptr, 0, nullptr).message(),
            "kernel 'k' uses a tree that has been destroyed");
  x = makeField(runtime, "x", ScalarKind::F32, {2});
  EXPECT_EQ(runtime.launch(*late, nullptr, 0, nullptr).message(),
            "kernel 'k' uses tree 'x_tree', which has been destroyed");
  info.trees = {runtime.store().findTree("x_tree")};
  EXPECT_OK(runtime.launch(*runtime.launcher().kernels().create(info), nullptr,
                           0, nullptr));
}

static long residentPages() {
  long size = 0, resident = 0;
  if (FILE *file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &size, &resident) != 2)
      resident = 0;
    std::fclose(file);
  }
  return resident;
}

TEST(RuntimeTree, RoundsLeakNothing) {
  Runtime runtime;
  auto rounds = [&](int count) {
    for (int i = 0; i < count; ++i) {
      FieldPtr x = makeDifferentiable(runtime, "x", ScalarKind::F32, {1000});
      ASSERT_OK(runtime.writes().fillF64(*x, 1));
      ASSERT_OK(runtime.destroyTree("x_tree"));
      ASSERT_OK(runtime.destroyTree("x_grad_tree"));
    }
  };
  rounds(1000);
  long before = residentPages();
  rounds(9000);
#ifndef TAI_TEST_SANITIZED
  EXPECT_LE(residentPages(), before + before / 100 + 64);
#else
  (void)before;
#endif
  EXPECT_EQ(runtime.memory().reserved(), 0);
}

TEST(RuntimeField, RefusesLayoutsThatLeaveTheTree) {
  Runtime runtime;
  FieldInfo info;
  ASSERT_OK(runtime.store().addTree("t", 100, info.tree));
  info.name = "x";
  info.layout = rowMajor(ScalarKind::F32, {26});
  FieldPtr field;
  EXPECT_EQ(runtime.store().addField(info, field).message(),
            "field 'x' does not fit into tree 't' of 100 bytes");
  info.layout = rowMajor(ScalarKind::F32, {25});
  EXPECT_OK(runtime.store().addField(info, field));
  EXPECT_EQ(runtime.store().addField(info, field).message(),
            "field 'x' exists already");
}

TEST(RuntimeField, ReadsAndWritesEveryKind) {
  Runtime runtime;
  struct {
    ScalarKind kind;
    double written, read;
  } cases[] = {
      {ScalarKind::I1, 3, 1},
      {ScalarKind::I8, -100.7, -100},
      {ScalarKind::I16, 30000, 30000},
      {ScalarKind::I32, -2e9, -2e9},
      {ScalarKind::I64, 9e15, 9e15},
      {ScalarKind::F16, 0.1, 0.0999755859375},
      {ScalarKind::BF16, 0.1, 0.10009765625},
      {ScalarKind::F32, 0.1, 0.1f},
      {ScalarKind::F64, 0.1, 0.1},
  };
  for (auto &test : cases) {
    FieldPtr x = makeField(runtime, spelling(test.kind), test.kind, {3}, {2});
    set(*x, {1}, test.written, 1);
    EXPECT_EQ(get(*x, {1}, 1), test.read) << spelling(test.kind);
    EXPECT_EQ(get(*x, {1}, 0), 0);
    EXPECT_EQ(get(*x, {2}, 0), 0);
    int64_t index = 2;
    ASSERT_OK(x->writeI64(&index, 0, 1));
    int64_t integer = 0;
    ASSERT_OK(x->readI64(&index, 0, integer));
    EXPECT_EQ(integer, 1);
  }
}

// Every f16 and every bf16 is preserved, and values between two of these are
// rounded to the nearest, ties to even.
TEST(RuntimeField, RoundsToSixteenBits) {
  Runtime runtime;
  for (ScalarKind kind : {ScalarKind::F16, ScalarKind::BF16}) {
    FieldPtr x = makeField(runtime, spelling(kind), kind, {});
    uint16_t infinity = kind == ScalarKind::F16 ? 0x7c00 : 0x7f80;
    auto bitsOf = [&] {
      uint16_t bits;
      std::memcpy(&bits, x->data(), 2);
      return bits;
    };
    double previous = 0;
    for (uint16_t bits = 0; bits < infinity; ++bits) {
      std::memcpy(x->data(), &bits, 2);
      double value = get(*x);
      set(*x, {}, value);
      ASSERT_EQ(bitsOf(), bits);
      set(*x, {}, -value);
      ASSERT_EQ(bitsOf(), bits | 0x8000);
      if (bits > 0) {
        ASSERT_GT(value, previous);
        double middle = (value + previous) / 2;
        set(*x, {}, middle);
        ASSERT_EQ(bitsOf(), bits & 1 ? bits - 1 : bits) << "tie to even";
        set(*x, {}, std::nextafter(middle, previous));
        ASSERT_EQ(bitsOf(), bits - 1);
        set(*x, {}, std::nextafter(middle, value));
        ASSERT_EQ(bitsOf(), bits);
      }
      previous = value;
    }
    set(*x, {}, 1e300);
    EXPECT_EQ(bitsOf(), infinity);
    EXPECT_TRUE(std::isinf(get(*x)));
    set(*x, {}, std::nan(""));
    EXPECT_TRUE(std::isnan(get(*x)));
  }
}

TEST(RuntimeField, SaysWhatIsOutOfRange) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {4, 5});
  double value;
  int64_t index[] = {1, 5};
  Status status = x->readF64(index, 0, value);
  EXPECT_EQ(status.code(), StatusCode::Index);
  EXPECT_EQ(status.message(), "index (1, 5) is out of range of field 'x', "
                              "whose indices are 0 to 3, 0 to 4");
  int64_t inside[] = {1, 4};
  EXPECT_EQ(x->writeF64(inside, 1, 0).message(),
            "component 1 of field 'x', whose elements have 1");
}

TEST(RuntimeField, CountsFromItsOffset) {
  Runtime runtime;
  FieldInfo info;
  ASSERT_OK(runtime.store().addTree("t", 40, info.tree));
  info.name = "x";
  info.layout = rowMajor(ScalarKind::F32, {10});
  info.layout.offset = {-5};
  FieldPtr x;
  ASSERT_OK(runtime.store().addField(info, x));
  set(*x, {-5}, 1);
  set(*x, {4}, 2);
  float values[10];
  ASSERT_OK(runtime.copies().copyOut(*x, values));
  EXPECT_EQ(values[0], 1);
  EXPECT_EQ(values[9], 2);
  int64_t index = 5;
  EXPECT_EQ(x->writeF64(&index, 0, 0).code(), StatusCode::Index);
}

namespace {
/// Layouts whose elements the bulk copies locate in different ways.
struct LayoutCase {
  const char *name;
  int64_t treeBytes;
  FieldLayout layout;
  bool contiguous;
};

std::vector<LayoutCase> layoutCases() {
  std::vector<LayoutCase> cases;
  cases.push_back(
      {"row-major", 6 * 10 * 8, rowMajor(ScalarKind::F32, {6, 10}, {2}), true});
  // dense<[i: 6, j: 10], {a: f32, x: vector<2xf32>, b: f32}>
  FieldLayout record = rowMajor(ScalarKind::F32, {6, 10}, {2}, 4);
  record.indices = {{{1, 6, 160}}, {{1, 10, 16}}};
  cases.push_back({"record", 6 * 160, record, false});
  // dense<[i: 3, j: 5], dense<[i: 2, j: 2], {x}>>
  FieldLayout blocked = rowMajor(ScalarKind::F32, {6, 10}, {2});
  blocked.indices = {{{2, 3, 5 * 32}, {1, 2, 16}}, {{2, 5, 32}, {1, 2, 8}}};
  cases.push_back({"blocked", 6 * 10 * 8, blocked, false});
  // dense<[j: 10], dense<[i: 6], {x}>>
  FieldLayout transposed = rowMajor(ScalarKind::F32, {6, 10}, {2});
  transposed.indices = {{{1, 6, 8}}, {{1, 10, 48}}};
  cases.push_back({"column-major", 6 * 10 * 8, transposed, false});
  // dense<[i: 6], dense<[j: 2], dense<[j: 5], {x}>>>: nested, yet in order.
  FieldLayout nested = rowMajor(ScalarKind::F32, {6, 10}, {2});
  nested.indices = {{{1, 6, 80}}, {{5, 2, 40}, {1, 5, 8}}};
  cases.push_back({"nested", 6 * 10 * 8, nested, true});
  // Components are apart: an array of x and an array of y.
  FieldLayout planar = rowMajor(ScalarKind::F32, {6, 10}, {2});
  planar.componentStride = 240;
  planar.indices = {{{1, 6, 40}}, {{1, 10, 4}}};
  cases.push_back({"planar", 6 * 10 * 8, planar, false});
  return cases;
}
} // namespace

TEST(RuntimeField, BulkCopiesFollowTheLayout) {
  for (const LayoutCase &test : layoutCases()) {
    SCOPED_TRACE(test.name);
    Runtime runtime;
    FieldInfo info;
    ASSERT_OK(runtime.store().addTree("t", test.treeBytes, info.tree));
    info.name = "x";
    info.layout = test.layout;
    FieldPtr x;
    ASSERT_OK(runtime.store().addField(info, x));
    EXPECT_EQ(x->contiguous(), test.contiguous);
    EXPECT_EQ(x->hostBytes(), 6 * 10 * 2 * 4);
    std::vector<float> in(120), out(120);
    std::iota(in.begin(), in.end(), 1.0f);
    ASSERT_OK(runtime.writes().copyIn(*x, in.data()));
    for (int64_t i = 0; i < 6; ++i)
      for (int64_t j = 0; j < 10; ++j)
        for (int64_t c = 0; c < 2; ++c)
          ASSERT_EQ(get(*x, {i, j}, c), in[(i * 10 + j) * 2 + c]);
    ASSERT_OK(runtime.copies().copyOut(*x, out.data()));
    EXPECT_EQ(in, out);
    // No memory outside the field may change.
    std::string before(info.tree->base(), info.tree->bytes());
    ASSERT_OK(runtime.writes().fillF64(*x, 7));
    ASSERT_OK(runtime.copies().copyOut(*x, out.data()));
    EXPECT_EQ(out, std::vector<float>(120, 7));
    ASSERT_OK(runtime.writes().copyIn(*x, in.data()));
    EXPECT_EQ(before, std::string(info.tree->base(), info.tree->bytes()));
  }
}

TEST(RuntimeField, CopiesLargeFieldsOnAllThreads) {
  Options options;
  options.threads = 4;
  Runtime runtime(options);
  int64_t n = 1 << 18;
  // A record of three values, with x in the middle.
  FieldInfo info;
  ASSERT_OK(runtime.store().addTree("t", n * 12, info.tree));
  info.name = "x";
  info.layout = rowMajor(ScalarKind::I32, {n}, {}, 4);
  info.layout.indices = {{{1, n, 12}}};
  FieldPtr x;
  ASSERT_OK(runtime.store().addField(info, x));
  std::vector<int32_t> in(n), out(n);
  std::iota(in.begin(), in.end(), -1000);
  ASSERT_OK(runtime.writes().copyIn(*x, in.data()));
  ASSERT_OK(runtime.copies().copyOut(*x, out.data()));
  EXPECT_EQ(in, out);
  ASSERT_OK(runtime.writes().fillI64(*x, -3));
  ASSERT_OK(runtime.copies().copyOut(*x, out.data()));
  EXPECT_EQ(out, std::vector<int32_t>(n, -3));
  for (int64_t b = 0; b < n * 12; b += 12)
    ASSERT_EQ(info.tree->base()[b], 0);
}

TEST(RuntimeField, LinksAdjointsInEitherOrder) {
  Runtime runtime;
  FieldPtr x = makeField(runtime, "x", ScalarKind::F32, {3}, {}, "x_grad");
  EXPECT_EQ(x->adjoint(), nullptr);
  FieldPtr xGrad = makeField(runtime, "x_grad", ScalarKind::F32, {3});
  EXPECT_EQ(x->adjoint(), xGrad.get());
  FieldPtr yGrad = makeField(runtime, "y_grad", ScalarKind::F32, {3});
  EXPECT_FALSE(yGrad->isAdjoint());
  FieldPtr y = makeField(runtime, "y", ScalarKind::F32, {3}, {}, "y_grad");
  EXPECT_EQ(y->adjoint(), yGrad.get());
  EXPECT_TRUE(yGrad->isAdjoint());
  FieldInfo bad;
  ASSERT_OK(runtime.store().addTree("z_tree", 16, bad.tree));
  bad.name = "z";
  bad.layout = rowMajor(ScalarKind::F32, {4});
  bad.adjoint = "x_grad";
  FieldPtr z;
  EXPECT_EQ(runtime.store().addField(bad, z).message(),
            "field 'z' and its adjoint or tangent 'x_grad' differ in shape or "
            "element type");
}

TEST(RuntimeField, ClearsDirtyAdjointsOnly) {
  Runtime runtime;
  FieldPtr x = makeDifferentiable(runtime, "x", ScalarKind::F32, {100});
  FieldPtr y = makeDifferentiable(runtime, "y", ScalarKind::F32, {100});
  set(*x, {1}, 5);
  set(*x->adjoint(), {2}, 6);
  EXPECT_TRUE(runtime.gradients().clear());
  EXPECT_EQ(get(*x, {1}), 5);
  EXPECT_EQ(get(*x->adjoint(), {2}), 0);
  EXPECT_EQ(runtime.counters().clearedFields, 1);
  EXPECT_TRUE(runtime.gradients().clear());
  EXPECT_EQ(runtime.counters().clearedFields, 1);
  // A launch that changes an adjoint marks it as dirty.
  FieldPtr yGrad = runtime.store().findField("y_grad");
  auto kernel = makeKernel(runtime, "k",
                           [](TaiFrame *frame) {
                             static_cast<float *>(frame->trees[0])[7] = 3;
                             return 0;
                           },
                           {{yGrad, AccessKind::Accumulate}});
  ASSERT_OK(runtime.launch(*kernel, nullptr, 0, nullptr));
  EXPECT_TRUE(yGrad->dirty());
  EXPECT_EQ(get(*yGrad, {7}), 3);
  EXPECT_TRUE(runtime.gradients().clear());
  EXPECT_EQ(get(*yGrad, {7}), 0);
  EXPECT_FALSE(yGrad->dirty());
}
