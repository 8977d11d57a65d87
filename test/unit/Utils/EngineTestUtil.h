//===- EngineTestUtil.h - A context with a few fields -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TEST_UNIT_COMPILER_ENGINETESTUTIL_H
#define TEST_UNIT_COMPILER_ENGINETESTUTIL_H

#include "tai-c/Tai.h"
#include "llvm/Support/FileSystem.h"
#include "gtest/gtest.h"
#include <string>

namespace tai_test {

/// A context without a compile cache, unless a test sets one.
class Context {
public:
  Context() : context(taiContextCreate()) { set("cache_dir", ""); }
  ~Context() { taiContextDestroy(context); }
  Context(const Context &) = delete;
  operator TaiContext() const { return context; }

  void set(const char *name, const char *value) {
    ok(taiContextSetOption(context, name, value));
  }
  void ok(TaiStatus status) {
    EXPECT_EQ(status, TAI_OK) << taiContextLastError(context).diagnostics;
  }
  std::string message() const { return taiContextLastError(context).message; }
  std::string diagnostics() const {
    return taiContextLastError(context).diagnostics;
  }
  TaiError error() const { return taiContextLastError(context); }

  TaiField field(const char *declaration) {
    TaiField made = nullptr;
    ok(taiContextAddField(context, declaration, &made));
    return made;
  }

  /// Adds fields x and gx of four f64, and y and gy of one f64; gx and gy are
  /// adjoints.
  void addFields() {
    ok(taiContextAddTree(
        context, "t",
        "!tai.root<dense<[i: 4], {x: f64, gx: f64}>, {y: f64, gy: f64}>"));
    x = field("tai.field @x = @t[\"x\"] : f64, rank 1, adjoint @gx");
    gx = field("tai.field @gx = @t[\"gx\"] : f64, rank 1");
    y = field("tai.field @y = @t[\"y\"] : f64, rank 0, adjoint @gy");
    gy = field("tai.field @gy = @t[\"gy\"] : f64, rank 0");
  }

  TaiStatus create(const char *name, const std::string &text,
                   TaiKernel &kernel) {
    return taiKernelParse(context, text.c_str(), "kernel.mlir", name, &kernel);
  }

  TaiKernel kernel(const char *name, const std::string &text) {
    TaiKernel made = nullptr;
    ok(create(name, text, made));
    return made;
  }

  double read(TaiField field, int64_t index = 0) {
    double value = -1;
    ok(taiFieldReadF64(field, &index, 0, &value));
    return value;
  }

  TaiContext context;
  TaiField x = nullptr, gx = nullptr, y = nullptr, gy = nullptr;
};

/// y += sum of factor * x^2
inline std::string squares(const std::string &factor) {
  return "tai.kernel @squares() {\n"
         "  %f = arith.constant " +
         factor +
         " : f64\n"
         "  tai.parallel_for (%i) in @x {\n"
         "    %v = tai.load @x[%i] : f64\n"
         "    %q = arith.mulf %v, %v : f64\n"
         "    %p = arith.mulf %q, %f : f64\n"
         "    %old = tai.atomic add %p, @y[] : f64\n"
         "  }\n"
         "  tai.return\n"
         "}\n";
}

/// A temporary folder that is removed at the end.
struct TemporaryFolder {
  TemporaryFolder() {
    EXPECT_FALSE(llvm::sys::fs::createUniqueDirectory("tai-test", path));
  }
  ~TemporaryFolder() { llvm::sys::fs::remove_directories(path); }
  llvm::SmallString<128> path;
};

} // namespace tai_test

#endif // TEST_UNIT_COMPILER_ENGINETESTUTIL_H
