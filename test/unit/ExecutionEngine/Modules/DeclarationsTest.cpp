//===- DeclarationsTest.cpp - Trees and fields without a session ----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modules/Declarations.h"
#include "../../Utils/ContextTest.h"
#include "mlir/Parser/Parser.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {

class DeclarationsTest : public ContextTest {
protected:
  DeclarationsTest() { declarations.emplace(&context, rt, failures); }
  FailureOr<runtime::FieldPtr> add(StringRef text) {
    return declarations->addField(text);
  }

  runtime::Runtime rt;
  FailureLog failures;
  std::optional<Declarations> declarations;
};

constexpr llvm::StringLiteral kLayout = "!tai.root<dense<[i: 4], {x: f32}>>";

TEST_F(DeclarationsTest, TellsTheRuntimeWhereElementsLie) {
  ASSERT_TRUE(succeeded(declarations->addTree("t", kLayout)))
      << failures.getLast().text;
  auto field = add("tai.field @x = @t[\"x\"] : f32, rank 1");
  ASSERT_TRUE(succeeded(field)) << failures.getLast().text;
  EXPECT_EQ((*field)->shape(), std::vector<int64_t>{4});
  EXPECT_EQ(declarations->size(), 2);
  EXPECT_TRUE(failed(add("tai.field @x = @t[\"x\"] : f32, rank 1")));
  EXPECT_EQ(failures.getLast().message, "'x' is already declared");
  EXPECT_TRUE(succeeded(declarations->destroyTree("t")));
  EXPECT_EQ(declarations->size(), 0);
  EXPECT_EQ(rt.store().findField("x"), nullptr);
}

TEST_F(DeclarationsTest, RefusesWithAReason) {
  EXPECT_TRUE(failed(declarations->addTree("t", "f32")));
  EXPECT_EQ(failures.getLast().message,
            "the layout of a tree is a !tai.root type, but got 'f32'");
  EXPECT_TRUE(failed(add("tai.field @x = @t[\"x\"] : f32, rank 1")));
  EXPECT_EQ(failures.getLast().message,
            "field 'x' names the tree 't', which is not there");
  EXPECT_EQ(declarations->size(), 0);
}

TEST_F(DeclarationsTest, GivesAModuleWhatItUsesInTheOrderOfUse) {
  ASSERT_TRUE(succeeded(declarations->addTree("t", kLayout)));
  ASSERT_TRUE(succeeded(add("tai.field @x = @t[\"x\"] : f32, rank 1")));
  auto module = parseSourceString<ModuleOp>(R"(
    tai.kernel @k() {
      %i = arith.constant 0 : index
      %v = tai.load @x[%i] : f32
      tai.store %v, @x[%i] : f32
      tai.return
    })",
                                            ParserConfig(&context, false));
  ASSERT_TRUE(module);
  EXPECT_TRUE(succeeded(declarations->declareUsed(*module)));
  EXPECT_TRUE(module->lookupSymbol<TreeOp>("t"));
  EXPECT_TRUE(module->lookupSymbol<FieldOp>("x"));
}

} // namespace
