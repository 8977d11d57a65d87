//===- CAPIAdjointsTest.cpp - Adjoints of arguments and results -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../Utils/EngineTestUtil.h"

using namespace tai_test;

namespace {

/// r = a (w[0] + w[1]), differentiated by `a`, the array and the result.
const char *const kScaledSum = R"(
  tai.kernel @scaled_sum(%a: f64, %w: memref<?xf64>) -> f64
      attributes {tai.gradients = array<i64: 0, 1, 2>} {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %0 = memref.load %w[%c0] : memref<?xf64>
    %1 = memref.load %w[%c1] : memref<?xf64>
    %2 = arith.addf %0, %1 : f64
    %3 = arith.mulf %a, %2 : f64
    tai.return %3 : f64
  })";

struct Arguments {
  double w[2] = {3, 4};
  double gradA = 0, gradW[2] = {0, 0}, gradResult = 0;
  uint64_t slots[7];

  explicit Arguments(double a) {
    memcpy(&slots[0], &a, sizeof(a));
    slots[1] = reinterpret_cast<uint64_t>(w);
    slots[2] = 2;
    slots[3] = reinterpret_cast<uint64_t>(&gradA);
    slots[4] = reinterpret_cast<uint64_t>(gradW);
    slots[5] = 2;
    slots[6] = reinterpret_cast<uint64_t>(&gradResult);
  }
};

TEST(CAPIAdjoints, ATapePassesThem) {
  Context context;
  TaiKernel kernel = context.kernel("scaled_sum", kScaledSum);
  Arguments first(2), second(5), unused(7);
  TaiTape tape;
  context.ok(taiTapeBegin(context, nullptr, true, &tape));
  for (Arguments *arguments : {&first, &second, &unused}) {
    uint64_t result;
    context.ok(taiKernelLaunch(kernel, arguments->slots, 7, &result));
  }
  context.ok(taiTapeEnd(tape));
  first.gradResult = 1;
  second.gradResult = 10;
  context.ok(taiTapeBackward(tape));
  EXPECT_EQ(first.gradA, 7);
  EXPECT_EQ(first.gradW[1], 2);
  EXPECT_EQ(second.gradA, 70);
  EXPECT_EQ(second.gradW[0], 50);
  EXPECT_EQ(unused.gradA, 0);
  taiTapeDestroy(tape);
}

TEST(CAPIAdjoints, ByHand) {
  Context context;
  TaiKernel kernel = context.kernel("scaled_sum", kScaledSum);
  Arguments arguments(2);
  arguments.gradResult = 1;
  context.ok(taiKernelLaunchGrad(kernel, arguments.slots, 7));
  context.ok(taiKernelLaunchGrad(kernel, arguments.slots, 7));
  EXPECT_EQ(arguments.gradA, 14);
  EXPECT_EQ(arguments.gradW[0], 4);
}

TEST(CAPIAdjoints, WithoutATapeTheyAreNotWanted) {
  Context context;
  TaiKernel kernel = context.kernel("scaled_sum", kScaledSum);
  Arguments arguments(2);
  uint64_t result;
  context.ok(taiKernelLaunch(kernel, arguments.slots, 3, &result));
  double value;
  memcpy(&value, &result, sizeof(value));
  EXPECT_EQ(value, 14);
  EXPECT_EQ(taiKernelLaunch(kernel, arguments.slots, 5, &result),
            TAI_ERROR_USAGE);
}

TEST(CAPIAdjoints, MissingOnesAreRefused) {
  Context context;
  TaiKernel kernel = context.kernel("scaled_sum", kScaledSum);
  Arguments arguments(2);
  uint64_t result;
  TaiTape tape;
  context.ok(taiTapeBegin(context, nullptr, true, &tape));
  EXPECT_EQ(taiKernelLaunch(kernel, arguments.slots, 3, &result),
            TAI_ERROR_USAGE);
  EXPECT_STREQ(taiContextLastError(context).message,
               "kernel 'scaled_sum' takes 7 argument slots, but got 3; the "
               "last 4 are for the adjoints of its arguments and results");
  // A suspended tape records nothing, and needs no slots for adjoints.
  context.ok(taiTapeSuspend(tape));
  context.ok(taiKernelLaunch(kernel, arguments.slots, 3, &result));
  context.ok(taiTapeResume(tape));
  EXPECT_EQ(taiTapeNumRecords(tape), 0);
  context.ok(taiTapeEnd(tape));
  taiTapeDestroy(tape);
  EXPECT_EQ(taiKernelLaunchGrad(kernel, arguments.slots, 3), TAI_ERROR_USAGE);
}

TEST(CAPIAdjoints, PositionsThatMeanNoFloat) {
  Context context;
  TaiKernel kernel;
  EXPECT_EQ(taiKernelParse(context, R"(
    tai.kernel @k(%n: i32) attributes {tai.gradients = array<i64: 0>} {
      tai.return
    })",
                           "k.mlir", "k", &kernel),
            TAI_ERROR_TYPE);
  EXPECT_STREQ(taiContextLastError(context).message,
               "cannot differentiate by argument 0, which is no float but "
               "'i32'");
}

} // namespace
