//===- LayoutTest.cpp - Addresses of fields -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Every element of every field of a tree must have storage of its own, inside
// the tree and aligned, whatever the nesting.
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/Layout.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/IR/BuiltinOps.h"
#include "mlir/Parser/Parser.h"
#include "gtest/gtest.h"
#include <set>

using namespace mlir;
using namespace mlir::tai;

namespace {
class LayoutTest : public ::testing::Test {
protected:
  LayoutTest() { context.loadDialect<TaiDialect, arith::ArithDialect>(); }

  OwningOpRef<ModuleOp> parse(StringRef text) {
    return parseSourceString<ModuleOp>(text, &context);
  }

  /// Collects the bytes of the tree that elements of a field occupy.
  void claim(FieldOp field, std::set<uint64_t> &bytes) {
    FailureOr<FieldLayout> layout = getFieldLayout(field);
    ASSERT_TRUE(succeeded(layout));
    FieldStorage storage = getFieldStorage(*layout, dataLayout);
    uint64_t size = getValueSize(field.getType(), dataLayout);
    uint64_t total =
        getTreeSize(cast<RootType>(layout->tree.getLayout()), dataLayout).cells;
    SmallVector<int64_t> index(layout->shape.size(), 0);
    for (bool more = true; more;) {
      uint64_t address = storage.offset;
      for (const IndexDigit &digit : storage.digits)
        address += index[digit.dimension] / digit.divisor % digit.extent *
                   digit.stride;
      EXPECT_EQ(address % getValueAlignment(field.getType(), dataLayout), 0u);
      EXPECT_LE(address + size, total);
      for (uint64_t byte = 0; byte != size; ++byte)
        EXPECT_TRUE(bytes.insert(address + byte).second)
            << field.getSymName().str() << " shares byte " << address + byte;
      more = false;
      for (size_t d = index.size(); d-- > 0 && !more;) {
        more = ++index[d] != layout->shape[d];
        if (!more)
          index[d] = 0;
      }
    }
  }

  MLIRContext context;
  DataLayout dataLayout;
};
} // namespace

TEST_F(LayoutTest, ElementsHaveTheirOwnBytes) {
  OwningOpRef<ModuleOp> module = parse(R"(
    tai.tree @t : !tai.root<
      dense<[i: 3], dense<[i: 5, j: 2], {a: f32, b: vector<3xf64>}, {c: i1}>,
                    dense<[k: 7], {d: f16}>>,
      dense<[j: 4, i: 6], {e: vector<2x2xi16>}>, {f: f64, g: i8}>
    tai.field @a = @t["a"] : f32, rank 2
    tai.field @b = @t["b"] : vector<3xf64>, rank 2
    tai.field @c = @t["c"] : i1, rank 2
    tai.field @d = @t["d"] : f16, rank 2
    tai.field @e = @t["e"] : vector<2x2xi16>, rank 2
    tai.field @f = @t["f"] : f64, rank 0
    tai.field @g = @t["g"] : i8, rank 0)");
  ASSERT_TRUE(module);
  std::set<uint64_t> bytes;
  size_t expected = 0;
  for (FieldOp field : module->getOps<FieldOp>()) {
    claim(field, bytes);
    FailureOr<FieldLayout> layout = getFieldLayout(field);
    size_t elements = 1;
    for (int64_t extent : layout->shape)
      elements *= extent;
    expected += elements * getValueSize(field.getType(), dataLayout);
  }
  EXPECT_EQ(bytes.size(), expected);
}

TEST_F(LayoutTest, ShapeFollowsAxesAndOrder) {
  OwningOpRef<ModuleOp> module = parse(R"(
    tai.tree @t : !tai.root<dense<[k: 9], dense<[i: 4], dense<[i: 2], {x: f32}>>>>
    tai.field @x = @t["x"] : f32, rank 2, order [2, 0], offset [-1, 5])");
  ASSERT_TRUE(module);
  FieldOp field = *module->getOps<FieldOp>().begin();
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  ASSERT_TRUE(succeeded(layout));
  EXPECT_EQ(layout->shape, (SmallVector<int64_t>{9, 8}));
  EXPECT_EQ(layout->offset, (SmallVector<int64_t>{-1, 5}));
  FieldStorage storage = getFieldStorage(*layout, dataLayout);
  ASSERT_EQ(storage.digits.size(), 3u);
  EXPECT_TRUE(storage.digits[0].isWhole);
  EXPECT_EQ(storage.digits[0].stride, 32u);
  EXPECT_FALSE(storage.digits[1].isWhole);
  EXPECT_EQ(storage.digits[1].divisor, 2);
  EXPECT_EQ(storage.digits[1].stride, 8u);
  EXPECT_EQ(storage.digits[2].divisor, 1);
  EXPECT_EQ(storage.digits[2].stride, 4u);
}

TEST_F(LayoutTest, SparseCellsAreWhereDenseOnesWouldBe) {
  OwningOpRef<ModuleOp> module = parse(R"(
    tai.tree @t : !tai.root<dense<[i: 3], {s: f32}>,
        pointer<[i: 4], bitmasked<[i: 2], dense<[i: 5], {x: f32}>>,
                        dynamic<[j: 7], chunk 1, {y: f64}>>>
    tai.field @x = @t["x"] : f32, rank 1
    tai.field @y = @t["y"] : f64, rank 2)");
  ASSERT_TRUE(module);
  auto tree = *module->getOps<TreeOp>().begin();
  auto fields = llvm::to_vector(module->getOps<FieldOp>());
  SmallVector<SparseNode> nodes = getSparseNodes(tree.getLayout(), dataLayout);
  ASSERT_EQ(nodes.size(), 3u);
  EXPECT_EQ(nodes[0].getNumCells(), 4);
  EXPECT_EQ(nodes[1].getNumCells(), 8);
  EXPECT_EQ(nodes[1].parent, 0u);
  EXPECT_TRUE(nodes[2].type.isList());
  EXPECT_EQ(nodes[2].getNumCells(), 28);
  EXPECT_EQ(nodes[2].parent, 0u);
  TreeSize size = getTreeSize(tree.getLayout(), dataLayout);
  EXPECT_EQ(size.cells, 64u + 4 * (2 * 5 * 4 + 7 * 8));
  EXPECT_EQ(nodes[0].activityOffset % 4096, 0u);
  EXPECT_GE(nodes[0].activityOffset, size.cells);
  EXPECT_EQ(nodes[2].activityOffset, nodes[1].activityOffset + 64);

  std::set<uint64_t> bytes;
  for (FieldOp field : fields)
    claim(field, bytes);
  FailureOr<FieldLayout> layout = getFieldLayout(fields[0]);
  ASSERT_TRUE(succeeded(layout));
  EXPECT_EQ(layout->path.getFirstSparse().getKind(), "pointer");
  FieldStorage storage = getFieldStorage(*layout, dataLayout);
  ASSERT_EQ(storage.sparse.size(), 2u);
  EXPECT_EQ(storage.sparse[1].level, 1u);
  EXPECT_EQ(storage.sparse[1].node, 1u);
}
