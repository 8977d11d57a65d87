//===- SkipsTest.cpp - The switch of skipped work -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Support/Skips.h"
#include "tai-c/Tai.h"
#include "tai/Analysis/SkipScope.h"
#include "gtest/gtest.h"
#include <string>

using namespace mlir::tai;

namespace {

SkipSet parse(const char *text) {
  SkipSet set;
  std::string error;
  EXPECT_TRUE(SkipSet::parse(text, set, error)) << error;
  return set;
}

TEST(Skips, ParsesNames) {
  EXPECT_EQ(SkipSet(), SkipSet::all());
  EXPECT_EQ(parse("all"), SkipSet::all());
  EXPECT_EQ(parse("none"), SkipSet::none());
  EXPECT_EQ(parse(""), SkipSet::none());
  SkipSet set = parse(" dead-launches , unchanged-lists");
  EXPECT_EQ(set.str(), "unchanged-lists,dead-launches");
  EXPECT_TRUE(set.has(Skip::UnchangedLists));
  EXPECT_FALSE(set.has(Skip::UntouchedMemory));
  set = parse("-unchanged-lists");
  EXPECT_FALSE(set.has(Skip::UnchangedLists));
  set.set(Skip::UnchangedLists, true);
  EXPECT_EQ(set, SkipSet::all());
  EXPECT_EQ(parse("all,none"), SkipSet::none());
  EXPECT_EQ(parse("all,-all"), SkipSet::none());
  EXPECT_EQ(parse("none,untouched-memory").str(), "untouched-memory");
}

TEST(Skips, EverySetIsReadAsItIsWritten) {
  for (unsigned i = 0; i < kNumSkips; ++i) {
    SkipSet without = SkipSet::all();
    without.set(static_cast<Skip>(i), false);
    EXPECT_EQ(parse(without.str().c_str()), without);
    EXPECT_EQ(parse(kSkips[i].name).str(), kSkips[i].name);
  }
}

TEST(Skips, RefusesWhatIsNoName) {
  SkipSet set = SkipSet::none();
  std::string error;
  for (const char *text :
       {"List-reuse", "all,-", "unchanged-lists,,", "- all"}) {
    EXPECT_FALSE(SkipSet::parse(text, set, error)) << text;
    EXPECT_NE(error.find("the skips are all, none, unchanged-lists, "),
              std::string::npos);
  }
  EXPECT_EQ(set, SkipSet::none());
}

TEST(Skips, ScopesDoNotHearOfEachOther) {
  SkipScope::count(SkipCount::WritesKept); // nobody listens
  SkipScope outer;
  SkipScope::count(SkipCount::WritesKept, 2);
  {
    SkipScope inner;
    SkipScope::count(SkipCount::WritesKept, 5);
    EXPECT_EQ(inner.getAmounts()[unsigned(SkipCount::WritesKept)], 5);
  }
  SkipScope::count(SkipCount::WritesKept);
  EXPECT_EQ(outer.getAmounts()[unsigned(SkipCount::WritesKept)], 3);
}

TEST(Skips, AreInTheCApi) {
  TaiContext context = taiContextCreate();
  EXPECT_EQ(taiContextSetOption(context, "skip", "nothing"), TAI_ERROR_USAGE);
  EXPECT_NE(
      std::string(taiContextLastError(context).message).find("unchanged-lists"),
      std::string::npos);
  ASSERT_EQ(taiContextSetOption(context, "skip", "-unchanged-lists"), TAI_OK);
  ASSERT_EQ(
      taiContextAddTree(context, "t", "!tai.root<dense<[i: 1024], {x: f32}>>"),
      TAI_OK);
  const TaiSkipRow *rows = nullptr;
  int64_t count = 0;
  ASSERT_EQ(taiProfilerSkips(context, &rows, &count), TAI_OK);
  ASSERT_EQ(count, kNumSkipCounts);
  EXPECT_EQ(std::string(rows[0].skip), "unchanged-lists");
  EXPECT_EQ(std::string(rows[0].counter), "made");
  EXPECT_FALSE(rows[0].on);
  EXPECT_TRUE(rows[count - 1].on);
  for (int64_t i = 0; i < count; ++i)
    if (std::string(rows[i].counter) == "bytes_reserved")
      EXPECT_EQ(rows[i].value, 4096);
  EXPECT_EQ(taiProfilerClearSkips(context), TAI_OK);
  taiContextDestroy(context);
}

} // namespace
