//===- FailureLogTest.cpp - Failures on their way through the runtime -----===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Reports/FailureLog.h"
#include "gtest/gtest.h"
#include <thread>

using namespace mlir::tai;

namespace {

TEST(FailureLog, KeepsTheLastOfEachThread) {
  FailureLog log;
  EXPECT_EQ(log.getLast().kind, FailureKind::None);
  EXPECT_TRUE(failed(log.fail(FailureKind::Usage, "here")));
  std::thread([&] {
    EXPECT_EQ(log.getLast().kind, FailureKind::None);
    EXPECT_TRUE(failed(log.fail(FailureKind::Memory, "there")));
    EXPECT_EQ(log.getLast().message, "there");
  }).join();
  EXPECT_EQ(log.getLast().message, "here");
  // A log does not return the failures of other logs.
  EXPECT_EQ(FailureLog().getLast().kind, FailureKind::None);
}

TEST(FailureLog, AStatusBringsTheFailureBack) {
  FailureLog log;
  Failure failure = Failure::get(FailureKind::Autodiff, "no derivative");
  failure.file = "a.py";
  failure.line = 3;
  failure.column = 4;
  failure.text = "a.py:3:4: error: no derivative\n  x = y";
  runtime::Status status = log.keep(failure);
  EXPECT_EQ(status.where(), "a.py:3:4");
  EXPECT_TRUE(failed(log.check(status)));
  EXPECT_EQ(log.getLast().kind, FailureKind::Autodiff);
  EXPECT_EQ(log.getLast().text, failure.text);
}

TEST(FailureLog, OldOnesAreToldByTheirStatus) {
  FailureLog log;
  runtime::Status first = log.keep(Failure::get(FailureKind::Type, "first"));
  for (int i = 0; i < 2000; ++i)
    (void)log.keep(Failure::get(FailureKind::Type, "later"));
  EXPECT_LT(log.numKept(), 2000);
  EXPECT_TRUE(failed(log.fail(first)));
  EXPECT_EQ(log.getLast().message, "first");
  EXPECT_EQ(log.getLast().kind, FailureKind::Internal);
  runtime::Status last = log.keep(Failure::get(FailureKind::Type, "last"));
  EXPECT_TRUE(failed(log.fail(last)));
  EXPECT_EQ(log.getLast().kind, FailureKind::Type);
}

TEST(FailureLog, FindsThePlaceOfAStatus) {
  FailureLog log;
  auto status = runtime::Status::failure(runtime::StatusCode::Assert, "wrong",
                                         "c:/x.py:12:7");
  EXPECT_TRUE(failed(log.check(status)));
  EXPECT_EQ(log.getLast().file, "c:/x.py");
  EXPECT_EQ(log.getLast().line, 12);
  EXPECT_EQ(log.getLast().column, 7);
  EXPECT_EQ(log.getLast().kind, FailureKind::Runtime);
}

} // namespace
