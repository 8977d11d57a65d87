//===- TypeInferenceTest.cpp - Types of results ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An op whose result types follow from its operands can be made from these
// alone.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Interfaces/InferTypeOpInterface.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "gtest/gtest.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
class TypeInferenceTest : public ::testing::Test {
protected:
  TypeInferenceTest()
      : b(UnknownLoc::get(load(context)), &context),
        module(ModuleOp::create(b.getLoc())) {
    b.setInsertionPointToStart(module->getBody());
  }
  static MLIRContext *load(MLIRContext &context) {
    context.loadDialect<TaiDialect, arith::ArithDialect>();
    return &context;
  }

  Type type(ArrayRef<int64_t> shape) {
    return VectorType::get(shape, b.getF32Type());
  }
  Value vector(ArrayRef<int64_t> shape) {
    return arith::ConstantOp::create(b, b.getZeroAttr(type(shape)));
  }
  /// The types of the results, or none.
  SmallVector<Type> infer(StringRef name, ValueRange operands) {
    OperationName op(name, &context);
    SmallVector<Type> types;
    if (failed(op.getInterface<InferTypeOpInterface>()->inferReturnTypes(
            &context, std::nullopt, operands, b.getDictionaryAttr({}),
            OpaqueProperties(nullptr), RegionRange(), types)))
      types.clear();
    return types;
  }

  using Types = SmallVector<Type>;
  MLIRContext context;
  ImplicitLocOpBuilder b;
  OwningOpRef<ModuleOp> module;
};
} // namespace

TEST_F(TypeInferenceTest, Products) {
  EXPECT_EQ(infer("tai.matmul", {vector({2, 3}), vector({3, 4})}),
            Types{type({2, 4})});
  EXPECT_EQ(infer("tai.matmul", {vector({2, 3}), vector({3})}),
            Types{type({2})});
  EXPECT_EQ(infer("tai.outer", {vector({2}), vector({3})}),
            Types{type({2, 3})});
  EXPECT_EQ(infer("tai.transpose", {vector({2, 3})}), Types{type({3, 2})});
}

TEST_F(TypeInferenceTest, Decompositions) {
  Types expected{type({3}), type({3, 3})};
  EXPECT_EQ(infer("tai.sym_eig", {vector({3, 3})}), expected);
}

TEST_F(TypeInferenceTest, LocalsAndStacks) {
  Value local = AllocaOp::create(b, LocalType::get(type({2})));
  EXPECT_EQ(infer("tai.local_load", {local}), Types{type({2})});
  Value stack = StackCreateOp::create(b, StackType::get(b.getI64Type()));
  EXPECT_EQ(infer("tai.stack_pop", {stack}), Types{b.getI64Type()});
}

TEST_F(TypeInferenceTest, OtherOperandsHaveNoResult) {
  Value number = arith::ConstantOp::create(b, b.getF32FloatAttr(1));
  EXPECT_TRUE(infer("tai.matmul", {number, number}).empty());
  EXPECT_TRUE(infer("tai.transpose", {number}).empty());
  EXPECT_TRUE(infer("tai.outer", {number, vector({2})}).empty());
  EXPECT_TRUE(infer("tai.sym_eig", {vector({2})}).empty());
  EXPECT_TRUE(infer("tai.local_load", {number}).empty());
  EXPECT_TRUE(infer("tai.stack_pop", {number}).empty());
}
