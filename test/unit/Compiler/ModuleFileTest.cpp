//===- ModuleFileTest.cpp - Modules that come from outside ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/ModuleFile.h"
#include "mlir/Bytecode/BytecodeWriter.h"
#include "mlir/Parser/Parser.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

class ModuleFile : public testing::Test {
protected:
  ModuleFile() { context.loadDialect<TaiDialect>(); }

  /// The error on reading, or nothing.
  std::string read(StringRef bytes) {
    DiagnosticCollector collector(&context);
    ParserConfig config(&context, /*verifyAfterParse=*/false);
    if (OwningOpRef<ModuleOp> module = readModule(bytes, config, "given")) {
      last.clear();
      llvm::raw_string_ostream(last) << *module;
      return "";
    }
    return collector.take(FailureKind::Syntax, "no error").text;
  }

  std::string write() {
    auto module = parseSourceString<ModuleOp>(text, &context);
    std::string bytes;
    llvm::raw_string_ostream stream(bytes);
    EXPECT_TRUE(succeeded(writeModule(*module, stream)));
    return bytes;
  }

  MLIRContext context;
  std::string last;
  static constexpr StringLiteral text = R"(
      tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
      tai.field @x = @t["x"] : f32, rank 1)";
};

TEST_F(ModuleFile, WhatIsWrittenIsRead) {
  EXPECT_EQ(read(text), "");
  std::string fromText = last;
  EXPECT_EQ(read(write()), "");
  EXPECT_EQ(last, fromText);
}

// The magic number apart, without which a file is text.
TEST_F(ModuleFile, EveryDamagedByteIsSeen) {
  std::string bytes = write();
  for (size_t i = 0; i < bytes.size(); ++i) {
    std::string damaged = bytes;
    damaged[i] ^= 1 << i % 8;
    std::string error = read(damaged);
    EXPECT_NE(error, "") << i;
    if (i >= 8) {
      EXPECT_TRUE(StringRef(error).contains("damaged")) << i << error;
    }
  }
}

TEST_F(ModuleFile, EveryShorterAndLongerFileIsSeen) {
  std::string bytes = write();
  for (size_t size = 8; size < bytes.size(); ++size)
    EXPECT_TRUE(StringRef(read(bytes.substr(0, size))).contains("cut off"))
        << size;
  EXPECT_TRUE(StringRef(read(bytes + "x")).contains("cut off or damaged"));
}

TEST_F(ModuleFile, BytecodeWithoutAChecksumIsRefused) {
  auto module = parseSourceString<ModuleOp>(text, &context);
  std::string bytes;
  llvm::raw_string_ostream stream(bytes);
  ASSERT_TRUE(succeeded(writeBytecodeToFile(*module, stream)));
  EXPECT_TRUE(
      StringRef(read(bytes))
          .starts_with("given:1:1: error: this is MLIR bytecode without a "
                       "checksum"))
      << read(bytes);
  // A checksum does not make bytecode of something else.
  std::string other = write();
  EXPECT_TRUE(StringRef(read(other.substr(0, 24))).contains("damaged"));
}

TEST_F(ModuleFile, ZerosAreNoText) {
  EXPECT_EQ(read(std::string(100, '\0')),
            "given:1:1: error: this is neither text nor bytecode: a byte is "
            "zero\n");
  EXPECT_EQ(read(""), "");
}

// Text that ends the process in MLIR's parser.
TEST_F(ModuleFile, FatalTextIsRefused) {
  EXPECT_EQ(read("module attributes {\n  a = array < index : 1>} {}"),
            "given:2:13: error: an array attribute holds integers of known "
            "width or floats, not 'index'\n");
  EXPECT_EQ(read("\"a\"(%r#2147483647) : (i32) -> ()"),
            "given:1:7: error: no operation has so many results\n");
  // Neither in comments nor in strings nor in other places.
  EXPECT_EQ(read("// array<index: 1> #12345678\n"
                 "module attributes {a = \"array<index: 1> \\\" #12345678\","
                 "b = array<i32: 1>, c = index, d = \"/\"} {} // \""),
            "");
}

} // namespace
