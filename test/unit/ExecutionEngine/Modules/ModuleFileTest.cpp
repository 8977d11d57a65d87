//===- ModuleFileTest.cpp - Modules that come from outside ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modules/ModuleFile.h"
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

  /// The error when reading the bytes; empty if there is none.
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

// Except in the magic number, without which a file is text.
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
  // A valid checksum does not turn other bytes into bytecode.
  std::string other = write();
  EXPECT_TRUE(StringRef(read(other.substr(0, 24))).contains("damaged"));
}

TEST_F(ModuleFile, ZerosAreNoText) {
  EXPECT_EQ(read(std::string(100, '\0')),
            "given:1:1: error: this is neither text nor bytecode: a byte is "
            "zero\n");
  EXPECT_EQ(read(""), "");
}

// Text that would end the process in MLIR's parser.
TEST_F(ModuleFile, FatalTextIsRefused) {
  EXPECT_EQ(read("module attributes {\n  a = array < index : 1>} {}"),
            "given:2:13: error: an array attribute holds integers of known "
            "width or floats, not 'index'\n");
  EXPECT_EQ(read("\"a\"(%r#2147483647) : (i32) -> ()"),
            "given:1:7: error: no operation has so many results\n");
  // In comments, strings and other contexts, the same text is allowed.
  EXPECT_EQ(read("// array<index: 1> #12345678\n"
                 "module attributes {a = \"array<index: 1> \\\" #12345678\","
                 "b = array<i32: 1>, c = index, d = \"/\"} {} // \""),
            "");
}

std::string repeat(StringRef text, size_t count) {
  std::string result;
  for (size_t i = 0; i != count; ++i)
    result += text;
  return result;
}

std::string nest(StringRef before, StringRef open, StringRef inside,
                 StringRef close, StringRef after, size_t count) {
  return (before + repeat(open, count) + inside + repeat(close, count) + after)
      .str();
}

// The parser is recursive, and would overflow the stack.
TEST_F(ModuleFile, NestedTextIsRefused) {
  auto make = [](size_t n) -> std::vector<std::string> {
    std::string names = "!a0 = tuple<i1>\n", lists = "#a0 = [1]\n";
    for (size_t i = 0; i != n; ++i) {
      std::string before = std::to_string(i), after = std::to_string(i + 1);
      names += "!a" + after + " = tuple<!a" + before + ">\n";
      lists += "#a" + after + " = [#a" + before + "]\n";
    }
    std::string last = std::to_string(n);
    return {
        nest("module attributes {tai.x = ", "[", "", "]", "} {}", n),
        nest("module attributes {tai.x = ", "{a = ", "1", "}", "} {}", n),
        nest("#m = affine_map<(d0) -> (", "(", "d0", ")", ")>\nmodule {}", n),
        nest("#m = affine_map<(d0) -> (", "-", "d0", "", ")>\nmodule {}", n),
        nest("#m = affine_map<(d0) -> (", "- ", "d0", "", ")>\nmodule {}", n),
        nest("", "module {\n", "", "}", "", n),
        nest("func.func @f(%c: i1) {", "scf.if %c {\n", "", "}", "return }", n),
        nest("", "\"builtin.module\"() ({", "", "}) : () -> ()\n", "", n),
        nest("func.func private @f(", "tuple<", "i1", ">", ")", n),
        nest("func.func private @f(", "() -> (", "i1", ")", ")", n),
        nest("func.func private @f(", "memref<", "f32", ">", ")", n),
        nest("module {} loc(", "callsite(\"a\" at ", "\"b\"", ")", ")", n),
        nest("module {} loc(", "fused[", "\"b\"", "]", ")", n),
        nest("module attributes {tai.x = dense<", "[", "1", "]",
             "> : tensor<1xi32>} {}", n),
        nest("module attributes {tai.x = #tai.y", "<", "", ">", "} {}", n),
        names + "func.func private @f(!a" + last + ")",
        lists + "module attributes {tai.x = #a" + last + "} {}",
        // Nested brackets after quotes and comments are found as well.
        nest("// \"\nmodule attributes {tai.x = [\"\\\"\", ", "[", "", "]",
             "]} {}", n),
    };
  };
  for (const std::string &text : make(14000))
    EXPECT_TRUE(StringRef(read(text))
                    .contains("the text is nested more than 512 levels deep "
                              "here, which is not read"))
        << text.substr(0, 60);
  // Less nesting is accepted, or rejected by the parser itself.
  for (const std::string &text : make(200))
    EXPECT_FALSE(StringRef(read(text)).contains("nested more than"))
        << text.substr(0, 60);
}

TEST_F(ModuleFile, LongTypesAndExpressionsAreRefused) {
  EXPECT_TRUE(StringRef(read(nest("func.func private @f(memref<", "1x", "f32",
                                  "", ">)", 100000)))
                  .contains("a type has more than 1024 dimensions"));
  EXPECT_TRUE(StringRef(read(nest("#m = affine_map<(d0) -> (d0", " + d0 mod 3",
                                  "", "", ")>\nmodule {}", 100000)))
                  .contains("an expression has more than 4096 operators"));
  EXPECT_FALSE(StringRef(read(nest("func.func private @f(memref<", "1x", "f32",
                                   "", ">)", 1000)))
                   .contains("dimensions"));
}

TEST_F(ModuleFile, LongMapsAreRefused) {
  auto nestMap = [&](StringRef name, StringRef begin, StringRef end,
                     int count) {
    return read(nest(("module attributes {m = " + name + begin).str(), "d, ",
                     "d", "", (end + ">} {}").str(), count));
  };
  constexpr StringLiteral message(
      "an affine map has more than 1024 dimensions");
  for (StringRef name : {"affine_map", "affine_set"}) {
    EXPECT_TRUE(
        StringRef(nestMap(name, " < (", ") -> (0)", 100000)).contains(message));
    EXPECT_TRUE(StringRef(nestMap(name, "<() [", "] -> (0)", 100000))
                    .contains(message));
    EXPECT_FALSE(
        StringRef(nestMap(name, "<(", ") -> (0)", 1000)).contains(message));
  }
  // A map may have many results, and the word alone is no map.
  EXPECT_EQ(read(nest("module attributes {m = affine_map<(d) -> (", "d, ", "d",
                      "", ")>} {}", 2000)),
            "");
  EXPECT_NE(read("module attributes {m = affine_map(1)} {}"), "");
}

// In bytecode, dimensions are numbers, but the layout of a memref is text.
TEST_F(ModuleFile, LongTypesInBytecodeAreRefused) {
  SmallVector<int64_t> shape(100000, 1);
  Type element = Float32Type::get(&context);
  auto readType = [&](Type type) {
    OwningOpRef<ModuleOp> module = ModuleOp::create(UnknownLoc::get(&context));
    (*module)->setAttr("t", TypeAttr::get(type));
    std::string bytes;
    llvm::raw_string_ostream stream(bytes);
    EXPECT_TRUE(succeeded(writeModule(*module, stream)));
    return read(bytes);
  };
  EXPECT_TRUE(StringRef(readType(MemRefType::get(shape, element)))
                  .contains("an affine map has more than 1024 dimensions"));
  EXPECT_TRUE(StringRef(readType(VectorType::get(shape, element)))
                  .contains("a type of 'builtin.module' has more than 1024 "
                            "dimensions, which is not read"));
  EXPECT_TRUE(
      StringRef(readType(FunctionType::get(
                    &context, RankedTensorType::get(shape, element), {})))
          .contains("a type of 'builtin.module' has more than 1024"));
  shape.resize(1000);
  EXPECT_EQ(readType(MemRefType::get(shape, element)), "");
  EXPECT_EQ(readType(VectorType::get(shape, element)), "");
}

// Brackets in strings, and consecutive ops of a file, are not nested.
TEST_F(ModuleFile, LongTextIsRead) {
  EXPECT_EQ(read(nest("", "module {}\n", "", "", "", 2000)), "");
  EXPECT_EQ(read(nest("module {} loc(\"", "[", "", "", "\")", 2000)), "");
  EXPECT_EQ(read(nest("// ", "[", "", "", "\nmodule {}", 2000)), "");
  EXPECT_EQ(read(nest("#m = affine_map<(d0) -> (-d0 + 3, ", "-d0, ", "d0", "",
                      ")>\nmodule {}", 2000)),
            "");
}

} // namespace
