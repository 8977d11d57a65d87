//===- CAPITest.cpp - Contexts, threads and bad input ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../Utils/EngineTestUtil.h"
#include <cmath>
#include <thread>

using namespace tai_test;

namespace {

bool contains(const std::string &text, const std::string &part) {
  return text.find(part) != std::string::npos;
}

//===----------------------------------------------------------------------===//
// Contexts
//===----------------------------------------------------------------------===//

TEST(CAPI, ContextsAreIndependent) {
  Context a, b;
  a.addFields();
  b.addFields();
  TaiKernel inA = a.kernel("squares", squares("1.0"));
  TaiKernel inB = b.kernel("squares", squares("10.0"));
  a.ok(taiFieldFillF64(a.x, 1));
  b.ok(taiFieldFillF64(b.x, 2));
  a.ok(taiKernelLaunch(inA, nullptr, 0, nullptr));
  b.ok(taiKernelLaunch(inB, nullptr, 0, nullptr));
  EXPECT_EQ(a.read(a.y), 4);
  EXPECT_EQ(b.read(b.y), 160);
  EXPECT_EQ(a.read(a.x), 1);
}

TEST(CAPI, ContextsOnThreads) {
  std::vector<std::thread> threads;
  std::array<double, 4> results = {};
  for (size_t i = 0; i < results.size(); ++i)
    threads.emplace_back([i, &results] {
      Context context;
      context.addFields();
      TaiKernel kernel =
          context.kernel("squares", squares(std::to_string(i + 1) + ".0"));
      context.ok(taiFieldFillF64(context.x, 1));
      context.ok(taiKernelLaunch(kernel, nullptr, 0, nullptr));
      results[i] = context.read(context.y);
    });
  for (std::thread &thread : threads)
    thread.join();
  for (size_t i = 0; i < results.size(); ++i)
    EXPECT_EQ(results[i], 4.0 * (i + 1));
}

TEST(CAPI, ManyKernelsCompileInParallel) {
  Context context;
  context.addFields();
  std::vector<TaiKernel> kernels;
  for (int i = 1; i <= 8; ++i)
    kernels.push_back(
        context.kernel("squares", squares(std::to_string(i) + ".0")));
  context.ok(taiKernelsCompile(context, kernels.data(), kernels.size(), true));
  context.ok(taiFieldFillF64(context.x, 1));
  context.ok(taiFieldFillF64(context.gy, 1));
  for (TaiKernel kernel : kernels) {
    context.ok(taiKernelLaunch(kernel, nullptr, 0, nullptr));
    context.ok(taiKernelLaunchGrad(kernel, nullptr, 0));
  }
  EXPECT_EQ(context.read(context.y), 4.0 * 36);
  EXPECT_EQ(context.read(context.gx), 2.0 * 36);
}

TEST(CAPI, ArgumentsAndResults) {
  Context context;
  context.addFields();
  TaiKernel kernel = context.kernel("f", R"(
    tai.kernel @f(%a: f32, %v: vector<2xf64>, %m: memref<?xf64>, %b: i1) -> f64 {
      %c1 = arith.constant 1 : index
      %e = tai.sum %v : vector<2xf64>
      %w = arith.extf %a : f32 to f64
      %s = arith.addf %e, %w : f64
      %x = memref.load %m[%c1] : memref<?xf64>
      %t = arith.addf %s, %x : f64
      %n = arith.negf %t : f64
      %r = arith.select %b, %n, %t : f64
      tai.return %r : f64
    })");
  double array[3] = {1000, 2000, 3000};
  uint64_t args[6] = {};
  float a = 1;
  double v[2] = {10, 100};
  memcpy(&args[0], &a, sizeof(a));
  memcpy(&args[1], v, sizeof(v));
  args[3] = reinterpret_cast<uint64_t>(array);
  args[4] = 3;
  args[5] = 1;
  uint64_t result;
  context.ok(taiKernelLaunch(kernel, args, 6, &result));
  double value;
  memcpy(&value, &result, sizeof(value));
  EXPECT_EQ(value, -2111.0);
}

TEST(CAPI, ArraysAreConstantForTheAdjoint) {
  Context context;
  context.addFields();
  TaiKernel kernel = context.kernel("weigh", R"(
    tai.kernel @weigh(%w: memref<?xf64>) {
      tai.parallel_for (%i) in @x {
        %v = tai.load @x[%i] : f64
        %f = memref.load %w[%i] : memref<?xf64>
        %p = arith.mulf %v, %f : f64
        %old = tai.atomic add %p, @y[] : f64
      }
      tai.return
    })");
  double weights[4] = {1, 2, 3, 4};
  uint64_t args[2] = {reinterpret_cast<uint64_t>(weights), 4};
  context.ok(taiFieldFillF64(context.x, 1));
  context.ok(taiKernelLaunch(kernel, args, 2, nullptr));
  EXPECT_EQ(context.read(context.y), 10);
  context.ok(taiFieldFillF64(context.gy, 1));
  context.ok(taiKernelLaunchGrad(kernel, args, 2));
  EXPECT_EQ(context.read(context.gx, 2), 3);
}

TEST(CAPI, AdjointsCompileAheadOfNeed) {
  // Creates many kernels under one tape, and destroys some while their adjoints
  // may still be compiling.
  Context context;
  context.addFields();
  context.ok(taiFieldFillF64(context.x, 1));
  for (int round = 0; round < 3; ++round) {
    TaiTape tape;
    context.ok(taiTapeBegin(context, context.y, true, &tape));
    std::vector<TaiKernel> kernels;
    for (int i = 1; i <= 6; ++i) {
      kernels.push_back(
          context.kernel("squares", squares(std::to_string(i) + ".0")));
      context.ok(taiKernelLaunch(kernels.back(), nullptr, 0, nullptr));
    }
    if (round == 1)
      taiTapeDestroy(tape);
    for (TaiKernel kernel : kernels)
      taiKernelDestroy(kernel);
    if (round == 1)
      continue;
    context.ok(taiTapeBackward(tape));
    EXPECT_EQ(context.read(context.gx, 3), 2.0 * 21);
    taiTapeDestroy(tape);
  }
}

TEST(CAPI, TreesOfTheSameNameAreNotConfused) {
  Context context;
  context.addFields();
  TaiKernel kernel = context.kernel("squares", squares("1.0"));
  context.ok(taiContextDestroyTree(context, "t"));
  // The new tree is smaller, so that the old code would write beyond its end.
  context.ok(taiContextAddTree(context, "t", "!tai.root<{x: i8}>"));
  EXPECT_EQ(taiKernelLaunch(kernel, nullptr, 0, nullptr), TAI_ERROR_USAGE);
}

TEST(CAPI, DestroyedKernelsStayOnTheTape) {
  Context context;
  context.addFields();
  TaiKernel kernel = context.kernel("squares", squares("1.0"));
  context.ok(taiFieldFillF64(context.x, 3));
  TaiTape tape;
  context.ok(taiTapeBegin(context, context.y, true, &tape));
  context.ok(taiKernelLaunch(kernel, nullptr, 0, nullptr));
  taiKernelDestroy(kernel);
  context.ok(taiTapeBackward(tape));
  EXPECT_EQ(context.read(context.gx, 1), 6);
  taiTapeDestroy(tape);
}

TEST(CAPI, TapesSaveAndRecompute) {
  // x = x^2 in place, three times: the sum of squares at the end is x^16.
  for (TaiCheckpoint kind : {TAI_CHECKPOINT_NONE, TAI_CHECKPOINT_PERIODIC,
                             TAI_CHECKPOINT_BINOMIAL, TAI_CHECKPOINT_MIXED}) {
    Context context;
    context.addFields();
    TaiKernel square = context.kernel("square", R"(
      tai.kernel @square() {
        tai.parallel_for (%i) in @x {
          %v = tai.load @x[%i] : f64
          %p = arith.mulf %v, %v : f64
          tai.store %p, @x[%i] : f64
        }
        tai.return
      })");
    TaiKernel sum = context.kernel("squares", squares("1.0"));
    context.ok(taiFieldFillF64(context.x, 1.5));
    TaiTape tape;
    context.ok(taiTapeBegin(context, nullptr, true, &tape));
    context.ok(taiTapeAddLoss(tape, context.y));
    context.ok(taiTapeWant(tape, &context.y, 1));
    context.ok(taiTapeWant(tape, nullptr, 0));
    EXPECT_EQ(taiTapeAddLoss(tape, context.y), TAI_ERROR_USAGE);
    context.ok(taiTapeSetCheckpoint(tape, kind, 2, 0));
    double seed = 0.5;
    context.ok(taiTapeSetSeed(tape, context.y, &seed));
    EXPECT_EQ(taiTapeSetSeed(tape, context.x, &seed), TAI_ERROR_USAGE);
    for (int i = 0; i < 3; ++i)
      context.ok(taiKernelLaunch(square, nullptr, 0, nullptr));
    context.ok(taiKernelLaunch(sum, nullptr, 0, nullptr));
    EXPECT_EQ(taiTapeSetCheckpoint(tape, kind, 2, 0), TAI_ERROR_USAGE);
    context.ok(taiTapeBackward(tape));
    EXPECT_NEAR(context.read(context.gx, 2), 0.5 * 16 * std::pow(1.5, 15),
                1e-9);
    EXPECT_NEAR(context.read(context.x, 2), std::pow(1.5, 8), 1e-12);
    EXPECT_EQ(taiTapeWarning(tape, 0), nullptr);
    TaiTapeStats stats;
    context.ok(taiTapeGetStats(tape, &stats));
    EXPECT_GE(stats.peak_bytes, 4 * 8);
    EXPECT_EQ(stats.recomputed > 0, kind != TAI_CHECKPOINT_NONE);
    taiTapeDestroy(tape);
    context.ok(taiTapeBegin(context, context.y, true, &tape));
    context.ok(taiTapeBackward(tape));
    EXPECT_STREQ(taiTapeWarning(tape, 0),
                 "the tape has recorded no launch: there is nothing to "
                 "differentiate");
    taiTapeDestroy(tape);
  }
}

//===----------------------------------------------------------------------===//
// Bad input
//===----------------------------------------------------------------------===//

TEST(CAPIErrors, Layouts) {
  Context context;
  EXPECT_EQ(
      taiContextAddTree(context, "t", "!tai.root<dense<[i: 4] {x: f64}>>"),
      TAI_ERROR_SYNTAX);
  EXPECT_FALSE(context.message().empty());
  EXPECT_EQ(
      taiContextAddTree(context, "t", "!tai.root<dense<[i: 0], {x: f64}>>"),
      TAI_ERROR_SYNTAX);
  EXPECT_EQ(taiContextAddTree(context, "t", "f32"), TAI_ERROR_TYPE);
  EXPECT_EQ(taiContextAddTree(context, "t", "!tai.root<{x: f64}> and more"),
            TAI_ERROR_SYNTAX);
  EXPECT_TRUE(contains(context.message(), "and more"));
  // A rejected tree leaves nothing behind.
  context.ok(taiContextAddTree(context, "t", "!tai.root<{x: f64}>"));
  EXPECT_EQ(taiContextAddTree(context, "t", "!tai.root<{x: f64}>"),
            TAI_ERROR_USAGE);
}

TEST(CAPISparse, ActivityOfCells) {
  Context context;
  context.ok(taiContextAddTree(
      context, "t", "!tai.root<pointer<[i: 4], bitmasked<[i: 4], {x: f64}>>>"));
  TaiSparseLevel level = {};
  context.ok(taiContextGetSparseLevel(context, "t", 1, &level));
  EXPECT_EQ(level.numCells, 16);
  EXPECT_EQ(level.cellBytes, 8);
  EXPECT_EQ(level.numActive, 0);
  // Activating a cell also activates the cells above it.
  context.ok(taiContextSetActive(context, "t", 1, 6, 1));
  context.ok(taiContextSetActive(context, "t", 1, 5, 1));
  int64_t cells[2] = {-1, -1};
  context.ok(taiContextGetActiveCells(context, "t", 1, cells, 2));
  EXPECT_EQ(cells[0], 5);
  EXPECT_EQ(cells[1], 6);
  context.ok(taiContextGetActiveCells(context, "t", 0, cells, 1));
  EXPECT_EQ(cells[0], 1);
  // Deactivating a cell also deactivates the cells below it.
  context.ok(taiContextSetActive(context, "t", 0, 1, 0));
  context.ok(taiContextGetSparseLevel(context, "t", 1, &level));
  EXPECT_EQ(level.numActive, 0);
  context.ok(taiContextDeactivateAll(context, "t", 0));

  EXPECT_EQ(taiContextSetActive(context, "t", 1, 16, 1), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "'bitmasked' level above @x"))
      << context.message();
  EXPECT_EQ(taiContextGetSparseLevel(context, "t", 2, &level), TAI_ERROR_USAGE);
  EXPECT_EQ(taiContextGetSparseLevel(context, "u", 0, &level), TAI_ERROR_USAGE);
  EXPECT_EQ(taiContextGetActiveCells(context, "t", 0, cells, 1),
            TAI_ERROR_USAGE);
}

TEST(CAPISparse, SomeElements) {
  Context context;
  context.ok(taiContextAddTree(context, "t",
                               "!tai.root<pointer<[i: 4, j: 4], dense<[i: 2, "
                               "j: 2], {x: vector<2xf32>}>>>"));
  TaiField x;
  context.ok(taiContextAddField(
      context, "tai.field @x = @t[\"x\"] : vector<2xf32>, rank 2", &x));
  const int64_t at[] = {0, 1, 7, 6};
  const float values[] = {1, 2, 3, 4};
  context.ok(taiFieldWriteElements(x, at, 2, values));
  TaiSparseLevel level = {};
  context.ok(taiContextGetSparseLevel(context, "t", 0, &level));
  EXPECT_EQ(level.numActive, 2);
  context.ok(taiContextDeactivateAll(context, "t", 0));
  context.ok(taiContextGetSparseLevel(context, "t", 0, &level));
  EXPECT_EQ(level.numActive, 0);
  EXPECT_EQ(level.peakActive, 2);

  context.ok(taiFieldWriteElements(x, at, 2, values));
  float read[4] = {};
  context.ok(taiFieldReadElements(x, at, 2, read));
  for (int k = 0; k < 4; ++k)
    EXPECT_EQ(read[k], values[k]);
  void *address = nullptr;
  context.ok(taiFieldGetAddress(x, at + 2, &address));
  EXPECT_EQ(static_cast<const float *>(address)[1], 4);

  const int64_t outside[] = {8, 0};
  EXPECT_NE(taiFieldReadElements(x, outside, 1, read), TAI_OK);
  EXPECT_NE(taiFieldWriteElements(x, outside, 1, values), TAI_OK);
  EXPECT_NE(taiFieldGetAddress(x, outside, &address), TAI_OK);
  EXPECT_TRUE(contains(context.message(), "out of range")) << context.message();
}

TEST(CAPISparse, ArraysActivateWhatIsNotZero) {
  Context context;
  context.ok(taiContextAddTree(
      context, "t", "!tai.root<pointer<[i: 4], dense<[i: 2], {x: f64}>>>"));
  TaiField x;
  context.ok(taiContextAddField(context,
                                "tai.field @x = @t[\"x\"] : f64, rank 1", &x));
  const double values[8] = {0, 0, 0, 5, 0, 0, 0, 0};
  context.ok(taiFieldCopyFromHost(x, values));
  TaiSparseLevel level = {};
  context.ok(taiContextGetSparseLevel(context, "t", 0, &level));
  EXPECT_EQ(level.numActive, 1);
  // Cells take 16 bytes: the limit allows one.
  context.ok(taiContextSetOption(context, "memory_limit", "16"));
  const double more[8] = {1, 1, 1, 1, 1, 1, 1, 1};
  EXPECT_EQ(taiFieldCopyFromHost(x, more), TAI_ERROR_MEMORY);
  EXPECT_EQ(taiContextSetOption(context, "memory_limit", "-1"),
            TAI_ERROR_USAGE);
  context.ok(taiContextSetOption(context, "memory_limit", "0"));
  context.ok(taiFieldCopyFromHost(x, more));
}

TEST(CAPIErrors, MemoryNamesTheTree) {
  Context context;
  EXPECT_EQ(taiContextAddTree(context, "huge",
                              "!tai.root<dense<[i: 1000000000, j: 1000000], "
                              "{x: f64}>>"),
            TAI_ERROR_MEMORY);
  EXPECT_TRUE(contains(context.message(), "huge")) << context.message();
}

TEST(CAPIErrors, Fields) {
  Context context;
  context.ok(
      taiContextAddTree(context, "t", "!tai.root<dense<[i: 4], {x: f64}>>"));
  TaiField field;
  auto add = [&](const char *text) {
    return taiContextAddField(context, text, &field);
  };
  // The field names a tree that does not exist yet.
  EXPECT_EQ(add("tai.field @x = @later[\"x\"] : f64, rank 1"), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "later")) << context.message();
  EXPECT_EQ(add("tai.field @x = @t[\"z\"] : f64, rank 1"), TAI_ERROR_TYPE);
  EXPECT_TRUE(contains(context.message(), "z")) << context.message();
  EXPECT_EQ(add("tai.field @x = @t[\"x\"] : f32, rank 1"), TAI_ERROR_TYPE);
  EXPECT_EQ(add("tai.field @x = @t[\"x\"] : f64, rank 2"), TAI_ERROR_TYPE);
  EXPECT_EQ(add("tai.field @x = "), TAI_ERROR_SYNTAX);
  EXPECT_EQ(add("tai.tree @u : !tai.root<{x: f64}>"), TAI_ERROR_SYNTAX);
  EXPECT_EQ(add("tai.field @x = @t[\"x\"] : f64, rank 1"), TAI_OK);
  EXPECT_EQ(add("tai.field @x = @t[\"x\"] : f64, rank 1"), TAI_ERROR_USAGE);
}

TEST(CAPIErrors, Access) {
  Context context;
  context.addFields();
  int64_t index = 4;
  double value;
  EXPECT_NE(taiFieldReadF64(context.x, &index, 0, &value), TAI_OK);
  EXPECT_TRUE(contains(context.message(), "4")) << context.message();
  index = 0;
  EXPECT_NE(taiFieldWriteF64(context.x, &index, 1, 1.0), TAI_OK);
  context.ok(taiContextDestroyTree(context, "t"));
  EXPECT_NE(taiFieldReadF64(context.x, &index, 0, &value), TAI_OK);
  EXPECT_NE(taiContextDestroyTree(context, "t"), TAI_OK);
}

TEST(CAPIErrors, Kernels) {
  Context context;
  context.addFields();
  TaiKernel kernel = nullptr;
  EXPECT_EQ(context.create("cubes", squares("1.0"), kernel), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "cubes"));
  // An unknown field, at its line.
  EXPECT_EQ(context.create("k", R"(tai.kernel @k() {
      %v = tai.load @q[] : f64
      tai.store %v, @y[] : f64
      tai.return
    })",
                           kernel),
            TAI_ERROR_TYPE);
  EXPECT_TRUE(contains(context.message(), "q")) << context.message();
  EXPECT_EQ(std::string(context.error().file), "kernel.mlir");
  EXPECT_EQ(context.error().line, 2);
  // The wrong number of indices.
  EXPECT_EQ(context.create("k", R"(tai.kernel @k() {
      %v = tai.load @x[] : f64
      tai.store %v, @y[] : f64
      tai.return
    })",
                           kernel),
            TAI_ERROR_TYPE);
  EXPECT_TRUE(contains(context.message(), "ind")) << context.message();
}

TEST(CAPIErrors, Launches) {
  Context context;
  context.addFields();
  TaiKernel kernel = context.kernel("squares", squares("1.0"));
  uint64_t args[1] = {0};
  EXPECT_EQ(taiKernelLaunch(kernel, args, 1, nullptr), TAI_ERROR_USAGE);
  context.ok(taiContextDestroyTree(context, "t"));
  EXPECT_EQ(taiKernelLaunch(kernel, nullptr, 0, nullptr), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "t")) << context.message();
}

TEST(CAPIErrors, GradientsThatAreNotThere) {
  Context context;
  context.addFields();
  TaiField plain = nullptr;
  context.ok(taiContextAddTree(context, "u", "!tai.root<{p: f64}>"));
  plain = context.field("tai.field @p = @u[\"p\"] : f64, rank 0");
  TaiTape tape = nullptr;
  EXPECT_EQ(taiTapeBegin(context, plain, true, &tape), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "p")) << context.message();
  EXPECT_EQ(taiTapeBegin(context, context.x, true, &tape), TAI_ERROR_USAGE);
  context.ok(taiTapeBegin(context, context.y, true, &tape));
  TaiTape second = nullptr;
  EXPECT_EQ(taiTapeBegin(context, context.y, true, &second), TAI_ERROR_USAGE);
  taiTapeDestroy(tape);
}

TEST(CAPIErrors, ChecksInDebugMode) {
  Context context;
  context.set("debug", "true");
  context.addFields();
  TaiKernel index = context.kernel("index", R"(tai.kernel @index(%i: i32) {
      %n = arith.index_cast %i : i32 to index
      %v = tai.load @x[%n] : f64
      tai.store %v, @y[] : f64
      tai.return
    })");
  uint64_t args[1] = {2};
  context.ok(taiKernelLaunch(index, args, 1, nullptr));
  args[0] = 4;
  EXPECT_EQ(taiKernelLaunch(index, args, 1, nullptr), TAI_ERROR_RUNTIME);
  EXPECT_TRUE(contains(context.message(), "4")) << context.message();
  EXPECT_TRUE(contains(context.message(), "x")) << context.message();
  EXPECT_EQ(context.error().line, 3);
  TaiKernel claim = context.kernel("claim", R"(tai.kernel @claim(%i: i32) {
      %c = arith.constant 7 : i32
      %ok = arith.cmpi slt, %i, %c : i32
      tai.assert %ok, "{} is too large"(%i) : i32
      tai.return
    })");
  context.ok(taiKernelLaunch(claim, args, 1, nullptr));
  args[0] = 8;
  EXPECT_EQ(taiKernelLaunch(claim, args, 1, nullptr), TAI_ERROR_RUNTIME);
  EXPECT_TRUE(contains(context.message(), "8 is too large"))
      << context.message();
  // The context can still be used.
  args[0] = 1;
  context.ok(taiKernelLaunch(claim, args, 1, nullptr));
}

TEST(CAPIErrors, CodeGeneratorFailsWithoutAborting) {
  Context context;
  context.addFields();
  // An intrinsic of another machine is a fatal error of LLVM.
  TaiKernel kernel = context.kernel("k", R"(tai.kernel @k() {
      %r = llvm.call_intrinsic "llvm.nvvm.read.ptx.sreg.tid.x"() : () -> i32
      %f = arith.sitofp %r : i32 to f64
      tai.store %f, @y[] : f64
      tai.return
    })");
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(taiKernelLaunch(kernel, nullptr, 0, nullptr), TAI_ERROR_INTERNAL);
    EXPECT_TRUE(contains(context.message(), "code generation failed"))
        << context.message();
  }
  TaiKernel good = context.kernel("squares", squares("1.0"));
  context.ok(taiFieldFillF64(context.x, 1));
  context.ok(taiKernelLaunch(good, nullptr, 0, nullptr));
  EXPECT_EQ(context.read(context.y), 4);
}

TEST(CAPIErrors, WordsThatContradict) {
  Context context;
  auto refuses = [&](const char *name, const char *value,
                     const std::string &why) {
    EXPECT_EQ(taiContextSetOption(context, name, value), TAI_ERROR_USAGE);
    EXPECT_TRUE(contains(context.message(), why)) << context.message();
  };
  context.set("math", "strict");
  refuses("fast_math", "true",
          "options 'math=\"strict\"' and 'fast_math' contradict one another: "
          "the first rounds every operation by itself, the second reorders "
          "them; choose one");
  // A rejected option changes nothing.
  context.set("math", "fast");
  refuses("strict", "true",
          "options 'strict' and 'math=\"fast\"' contradict one another");
  refuses("sums", "compensated",
          "options 'sums=\"compensated\"' and 'math=\"fast\"' contradict");
  refuses("shadow", "true", "options 'shadow' and 'math=\"fast\"' contradict");
  context.set("math", "default");
  context.set("sums", "compensated");
  refuses("math", "fast", "contradict");
  refuses("precision", "f8", "option 'precision' expects default, f64 or f32");
  refuses("adjoints", "f32", "option 'adjoints' expects default or f64");
  refuses("ftz", "perhaps", "option 'ftz' expects true or false");
  // A kernel's own modes are checked against the context's options.
  context.addFields();
  std::string fast = squares("1.0");
  fast.insert(fast.find('{'), "attributes {tai.modes = {math = \"fast\"}} ");
  TaiKernel kernel = nullptr;
  EXPECT_EQ(context.create("squares", fast, kernel), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.diagnostics(), "kernel.mlir:1:1: error: kernel "
                                              "'squares': "
                                              "sums=\"compensated\" and "
                                              "math=\"fast\" contradict"))
      << context.diagnostics();
}

TEST(CAPI, WordsOfAContextStandOnItsKernels) {
  Context context;
  context.addFields();
  context.set("sums", "compensated");
  context.set("ftz", "true");
  TaiKernel kernel = context.kernel("squares", squares("1.0"));
  const char *text = nullptr;
  context.ok(taiKernelGetIR(kernel, "autodiff", &text));
  EXPECT_TRUE(contains(text, "{ftz = true, sums = \"compensated\"}")) << text;
  // Added to 1e16 one after another, each 1 would be lost.
  int64_t first = 0;
  context.ok(taiFieldFillF64(context.x, 1));
  context.ok(taiFieldWriteF64(context.x, &first, 0, 1e8));
  context.ok(taiKernelLaunch(kernel, nullptr, 0, nullptr));
  EXPECT_EQ(context.read(context.y), 1e16 + 4); // 3, rounded
  // Options apply only to kernels that are created afterwards.
  context.set("sums", "default");
  context.set("ftz", "false");
  TaiKernel plain = context.kernel("squares", squares("1.0"));
  context.ok(taiKernelGetIR(plain, "tai", &text));
  EXPECT_FALSE(contains(text, "sums"));
}

TEST(CAPI, AdjointsOfTheTypeThatAContextAsksFor) {
  Context context;
  context.ok(taiContextAddTree(
      context, "t", "!tai.root<dense<[i: 4], {x: f32, gx: f32}>, {y: f64}>"));
  context.field("tai.field @x = @t[\"x\"] : f32, rank 1, adjoint @gx");
  context.field("tai.field @gx = @t[\"gx\"] : f32, rank 1");
  context.field("tai.field @y = @t[\"y\"] : f64, rank 0");
  const char *load = "tai.kernel @k() {\n"
                     "  %0 = arith.constant 0 : index\n"
                     "  %1 = tai.load @x[%0] : f32\n"
                     "  tai.store %1, @x[%0] : f32\n"
                     "  tai.return\n"
                     "}\n";
  TaiKernel kernel = context.kernel("k", load);
  taiKernelDestroy(kernel);
  context.set("adjoints", "f64");
  EXPECT_EQ(context.create("k", load, kernel), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "'@gx', that of '@x', holds 'f32'"))
      << context.message();
}

TEST(CAPI, WarningsOfTheCompiler) {
  TemporaryFolder folder;
  const char *turns = "tai.kernel @k() {\n"
                      "  %a = tai.load @a[] : vector<2x2xf64>\n"
                      "  %u, %s, %v = tai.svd %a : vector<2x2xf64>\n"
                      "  %c = vector.extract %u[0, 0] : f64 from "
                      "vector<2x2xf64>\n"
                      "  tai.store %c, @y[] : f64\n"
                      "  tai.return\n"
                      "}\n";
  // The second time, the code is in the cache; the third time, the kernel is at
  // another line.
  for (const char *before : {"", "", "\n\n"}) {
    Context context;
    context.set("cache_dir", folder.path.c_str());
    std::vector<std::string> told;
    taiContextSetWarningHandler(
        context,
        [](const TaiWarning *warning, void *user) {
          static_cast<std::vector<std::string> *>(user)->push_back(
              std::string(warning->file) + ":" + std::to_string(warning->line) +
              (warning->of_gradient ? " gradient: " : ": ") + warning->message +
              "\n" + warning->diagnostics);
        },
        &told);
    context.ok(taiContextAddTree(context, "t",
                                 "!tai.root<{a: vector<2x2xf64>, ga: "
                                 "vector<2x2xf64>, y: f64, gy: f64}>"));
    context.field(
        "tai.field @a = @t[\"a\"] : vector<2x2xf64>, rank 0, adjoint @ga");
    context.field("tai.field @ga = @t[\"ga\"] : vector<2x2xf64>, rank 0");
    context.field("tai.field @y = @t[\"y\"] : f64, rank 0, adjoint @gy");
    context.field("tai.field @gy = @t[\"gy\"] : f64, rank 0");
    TaiKernel kernel = context.kernel("k", std::string(before) + turns);
    context.ok(taiKernelLaunch(kernel, nullptr, 0, nullptr));
    EXPECT_TRUE(told.empty());
    for (int i = 0; i < 2; ++i)
      context.ok(taiKernelLaunchGrad(kernel, nullptr, 0));
    ASSERT_EQ(told.size(), 1u);
    std::string line = *before ? "5" : "3";
    EXPECT_TRUE(contains(told[0], "kernel.mlir:" + line +
                                      " gradient: where singular values are"))
        << told[0];
    EXPECT_TRUE(contains(told[0], "kernel.mlir:" + line + ":"));
    EXPECT_TRUE(contains(told[0], "note: products such as"));
  }
}

TEST(CAPIErrors, Options) {
  Context context;
  EXPECT_EQ(taiContextSetOption(context, "threads", "many"), TAI_ERROR_USAGE);
  EXPECT_EQ(taiContextSetOption(context, "opt_level", "4"), TAI_ERROR_USAGE);
  EXPECT_EQ(taiContextSetOption(context, "print_ir", "ast"), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "llvmir"));
  EXPECT_EQ(taiContextSetOption(context, "debug", "perhaps"), TAI_ERROR_USAGE);
  context.addFields();
  TaiKernel kernel = context.kernel("squares", squares("1.0"));
  const char *text;
  context.ok(taiKernelGetIR(kernel, "adjoint.llvm", &text));
  EXPECT_TRUE(contains(text, "squares_grad"));
  EXPECT_EQ(taiKernelGetIR(kernel, "bytes", &text), TAI_ERROR_USAGE);
  EXPECT_TRUE(contains(context.message(), "autodiff"));
}

} // namespace
