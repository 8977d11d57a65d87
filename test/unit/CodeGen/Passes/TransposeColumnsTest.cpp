//===- TransposeColumnsTest.cpp - Columns that become rows ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/TransposeColumns.h"
#include "../../Utils/LLVMPassUtils.h"
#include "llvm/AsmParser/Parser.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/SourceMgr.h"
#include "gtest/gtest.h"

using namespace llvm;
using namespace mlir::tai;

namespace {
/// The starts of eight rows from row %i on, 464 bytes apart.
constexpr StringLiteral evenRows =
    "  %s = insertelement <8 x i64> poison, i64 %i, i64 0\n"
    "  %b = shufflevector <8 x i64> %s, <8 x i64> poison, "
    "<8 x i32> zeroinitializer\n"
    "  %n = add <8 x i64> %b, <i64 0, i64 1, i64 2, i64 3, i64 4, i64 5, i64 6,"
    " i64 7>\n"
    "  %m = mul <8 x i64> %n, splat (i64 464)\n"
    "  %rows = getelementptr i8, ptr %x, <8 x i64> %m\n";

/// The accesses of a function after the pass, in order, each with its number of
/// repetitions: gathers (G), scatters (C), loads (L) and stores (S).
std::string order(const std::string &body,
                  const std::string &rows = evenRows.str()) {
  LLVMContext context;
  SMDiagnostic error;
  std::string text =
      "declare <8 x float> @llvm.masked.gather.v8f32.v8p0(<8 x ptr>, "
      "<8 x i1>, <8 x float>)\n"
      "declare void @llvm.masked.scatter.v8f32.v8p0(<8 x float>, <8 x ptr>, "
      "<8 x i1>)\n"
      "define <8 x float> @f(ptr noalias %x, ptr noalias %y, i64 %i, "
      "<8 x ptr> %any, <8 x i1> %some) {\n" +
      rows + body + "  ret <8 x float> %v0\n}\n";
  std::unique_ptr<Module> module = parseAssemblyString(text, error, context);
  if (!module)
    return error.getMessage().str() + "\n" + text;
  Function &function = *module->getFunction("f");
  runPass(function, TransposeColumns());
  EXPECT_FALSE(verifyFunction(function, &errs()));
  std::string result;
  char last = 0;
  int count = 0;
  auto flush = [&] {
    if (last)
      result += (result.empty() ? "" : " ") + std::string(1, last) +
                std::to_string(count);
    count = 0;
  };
  for (Instruction &instruction : function.getEntryBlock()) {
    auto *call = dyn_cast<IntrinsicInst>(&instruction);
    char kind = isa<LoadInst>(instruction)                           ? 'L'
                : isa<StoreInst>(instruction)                        ? 'S'
                : !call                                              ? 0
                : call->getIntrinsicID() == Intrinsic::masked_gather ? 'G'
                                                                     : 'C';
    if (!kind)
      continue;
    if (kind != last)
      flush();
    last = kind;
    ++count;
  }
  flush();
  return result;
}

/// Gathers column n into %v<n>.
std::string gather(int n, const std::string &mask = "splat (i1 true)",
                   const std::string &rows = "%rows") {
  std::string number = std::to_string(n);
  return "  %p" + number + " = getelementptr i8, <8 x ptr> " + rows + ", i64 " +
         std::to_string(4 * n) + "\n  %v" + number +
         " = call <8 x float> @llvm.masked.gather.v8f32.v8p0(<8 x ptr> "
         "align 4 %p" +
         number + ", <8 x i1> " + mask + ", <8 x float> poison)\n";
}
std::string scatter(int n) {
  std::string number = std::to_string(n);
  return "  call void @llvm.masked.scatter.v8f32.v8p0(<8 x float> %v" + number +
         ", <8 x ptr> align 4 %p" + number + ", <8 x i1> splat (i1 true))\n";
}
} // namespace

TEST(TransposeColumns, FourColumnsAreEightPieces) {
  EXPECT_EQ(order(gather(0) + gather(1) + gather(2) + gather(3)), "L8");
  EXPECT_EQ(order(gather(3) + gather(0) + gather(2) + gather(1)), "L8");
}

TEST(TransposeColumns, RowsNeedNotBeEven) {
  EXPECT_EQ(order(gather(0) + gather(1) + gather(2) + gather(3),
                  "  %rows = getelementptr i8, <8 x ptr> %any, i64 16\n"),
            "L8");
}

TEST(TransposeColumns, OneIndexMayStandForAllRows) {
  // As in a loop along rows that was unrolled: %any[lane][%j + n].
  auto body = [](const std::string &other) {
    std::string text;
    for (int n : {0, 1, 2, 3}) {
      std::string number = std::to_string(n);
      std::string index = n == 2 && !other.empty() ? other : "%j";
      text += "  %i" + number + " = or disjoint i64 " + index + ", " + number +
              "\n  %p" + number +
              " = getelementptr float, <8 x ptr> %any, i64 %i" + number +
              "\n  %v" + number +
              " = call <8 x float> @llvm.masked.gather.v8f32.v8p0(<8 x ptr> "
              "align 4 %p" +
              number + ", <8 x i1> splat (i1 true), <8 x float> poison)\n";
    }
    return text;
  };
  EXPECT_EQ(order(body(""), "  %j = shl i64 %i, 2\n"), "L8");
  EXPECT_EQ(order(body("%k"), "  %j = shl i64 %i, 2\n  %k = shl i64 %i, 3\n"),
            "G4");
}

TEST(TransposeColumns, IndicesOfLanesAreNoRows) {
  std::string body;
  for (int n : {0, 1, 2, 3})
    body += gather(n);
  EXPECT_EQ(order(body, "  %s = insertelement <8 x i64> poison, i64 %i, i64 0\n"
                        "  %rows = getelementptr float, <8 x ptr> %any, "
                        "<8 x i64> %s\n"),
            "L8");
}

TEST(TransposeColumns, OthersStayColumns) {
  EXPECT_EQ(order(gather(0) + gather(1) + gather(2)), "G3");
  EXPECT_EQ(order(gather(0) + gather(1) + gather(2) + gather(4)), "G4");
  EXPECT_EQ(order(gather(0) + gather(1) + gather(2) + gather(3) + gather(4)),
            "L8 G1");
  EXPECT_EQ(order(gather(0, "%some") + gather(1, "%some") + gather(2, "%some") +
                  gather(3, "%some")),
            "G4");
}

TEST(TransposeColumns, AWriteInBetweenSeparates) {
  std::string front = gather(0) + gather(1), back = gather(2) + gather(3);
  EXPECT_EQ(order(front + "  store i32 0, ptr %x\n" + back), "G2 S1 G2");
  EXPECT_EQ(order(front + "  store i32 0, ptr %y\n" + back), "L8 S1");
}

TEST(TransposeColumns, UpdatesOfRowsAreThose) {
  std::string body;
  for (int n : {3, 2, 1, 0})
    body += gather(n) + scatter(n);
  EXPECT_EQ(order(body), "L8 S8");
}

TEST(TransposeColumns, OverlappingRowsKeepTheirOrder) {
  // Rows are 8 bytes apart: column 2 of a row is column 0 of the next row.
  std::string rows = evenRows.str();
  rows.replace(rows.find("464"), 3, "8");
  std::string body;
  for (int n : {3, 2, 1, 0})
    body += gather(n) + scatter(n);
  EXPECT_EQ(order(body, rows), "G1 C1 G1 C1 G1 C1 G1 C1");
  // Scatters to rows at unknown distances are not combined.
  EXPECT_EQ(order(body, "  %rows = getelementptr i8, <8 x ptr> %any, i64 16\n"),
            "G1 C1 G1 C1 G1 C1 G1 C1");
}

TEST(TransposeColumns, AColumnThatIsReadAgainIsNotStoredLater) {
  std::string body;
  for (int n : {0, 1, 2, 3})
    body += gather(n);
  std::string again = "  %w = call <8 x float> @llvm.masked.gather.v8f32.v8p0("
                      "<8 x ptr> align 4 %p0, <8 x i1> splat (i1 true), "
                      "<8 x float> poison)\n"
                      "  store <8 x float> %w, ptr %y\n";
  EXPECT_EQ(
      order(body + scatter(0) + again + scatter(1) + scatter(2) + scatter(3)),
      "L8 C1 G1 S1 C3");
}
