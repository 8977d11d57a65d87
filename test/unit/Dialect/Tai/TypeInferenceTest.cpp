//===- TypeInferenceTest.cpp - Types of results ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A builder of an op whose result type follows from its operands takes the
// operands alone.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
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

  VectorType type(ArrayRef<int64_t> shape) {
    return VectorType::get(shape, b.getF32Type());
  }
  Value vector(ArrayRef<int64_t> shape) {
    return arith::ConstantOp::create(b, b.getZeroAttr(type(shape)));
  }

  MLIRContext context;
  ImplicitLocOpBuilder b;
  OwningOpRef<ModuleOp> module;
};
} // namespace

TEST_F(TypeInferenceTest, Products) {
  EXPECT_EQ(MatmulOp::create(b, vector({2, 3}), vector({3, 4})).getType(),
            type({2, 4}));
  EXPECT_EQ(MatmulOp::create(b, vector({2, 3}), vector({3})).getType(),
            type({2}));
  EXPECT_EQ(OuterOp::create(b, vector({2}), vector({3})).getType(),
            type({2, 3}));
  EXPECT_EQ(TransposeOp::create(b, vector({2, 3})).getType(), type({3, 2}));
}

TEST_F(TypeInferenceTest, Decompositions) {
  auto eigen = SymEigOp::create(b, vector({3, 3}));
  EXPECT_EQ(eigen.getValues().getType(), type({3}));
  EXPECT_EQ(eigen.getVectors().getType(), type({3, 3}));
}

TEST_F(TypeInferenceTest, LocalsAndStacks) {
  auto local = AllocaOp::create(b, LocalType::get(type({2})));
  EXPECT_EQ(LocalLoadOp::create(b, local).getType(), type({2}));
  auto stack = StackCreateOp::create(b, StackType::get(b.getI64Type()));
  EXPECT_EQ(StackPopOp::create(b, stack).getType(), b.getI64Type());
}

TEST_F(TypeInferenceTest, FailsWithoutAType) {
  SmallVector<Type> types;
  Value number = arith::ConstantOp::create(b, b.getF32FloatAttr(1));
  auto infer = [&](StringRef name, ValueRange operands) {
    OperationName registered(name, &context);
    return registered.getInterface<InferTypeOpInterface>()->inferReturnTypes(
        &context, std::nullopt, operands, b.getDictionaryAttr({}),
        OpaqueProperties(nullptr), RegionRange(), types);
  };
  EXPECT_TRUE(failed(infer("tai.matmul", {number, number})));
  EXPECT_TRUE(failed(infer("tai.transpose", {number})));
  EXPECT_TRUE(failed(infer("tai.outer", {number, vector({2})})));
  EXPECT_TRUE(failed(infer("tai.sym_eig", {number})));
  EXPECT_TRUE(succeeded(infer("tai.transpose", {vector({1, 2})})));
}
