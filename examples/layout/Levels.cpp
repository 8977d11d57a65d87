//===- Levels.cpp - Two kinds of levels that tai does not have ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A dialect outside of tai's tree with two types that implement the interface
// of levels. Kernels, loops over fields and gradients work on them as on tai's
// own levels; no pass refers to them.
//
//   !demo.padded<[i: 5, j: 6], 8, {x: f64}>   rows of 8 cells, of which 6 are
//                                             used: all are active
//   !demo.columns<[i: 5, j: 6], {x: f64}>     cells of a column side by side,
//                                             each with a bit
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/DialectImplementation.h"
#include "mlir/Tools/Plugins/DialectPlugin.h"
#include "tai/Dialect/Tai/IR/Layout.h"

using namespace mlir;

namespace demo {
/// Axes, extents, cells in a row (0 for `columns`), and children.
struct LevelStorage : TypeStorage {
  using KeyTy = std::tuple<ArrayRef<unsigned>, ArrayRef<int64_t>, int64_t,
                           ArrayRef<Type>>;
  explicit LevelStorage(const KeyTy &key) : key(key) {}
  bool operator==(const KeyTy &other) const { return key == other; }
  static LevelStorage *construct(TypeStorageAllocator &allocator,
                                 const KeyTy &key) {
    auto [axes, shape, pitch, children] = key;
    return new (allocator.allocate<LevelStorage>())
        LevelStorage(KeyTy(allocator.copyInto(axes), allocator.copyInto(shape),
                           pitch, allocator.copyInto(children)));
  }
  KeyTy key;
};

/// The parts that both kinds share.
template <typename Derived>
struct LevelType : Type::TypeBase<Derived, Type, LevelStorage,
                                  tai::SNodeTypeInterface::Trait> {
  using Base = LevelType;
  using Type::TypeBase<Derived, Type, LevelStorage,
                       tai::SNodeTypeInterface::Trait>::TypeBase;

  ArrayRef<unsigned> getAxes() const { return std::get<0>(key()); }
  ArrayRef<int64_t> getShape() const { return std::get<1>(key()); }
  int64_t getPitch() const { return std::get<2>(key()); }
  ArrayRef<Type> getChildren() const { return std::get<3>(key()); }
  StringRef getKind() const { return Derived::getMnemonic(); }

private:
  const LevelStorage::KeyTy &key() const { return this->getImpl()->key; }
};

struct PaddedType : LevelType<PaddedType> {
  using LevelType::LevelType;
  static constexpr StringLiteral name = "demo.padded";
  static StringRef getMnemonic() { return "padded"; }

  tai::CellActivity getActivity() const { return tai::CellActivity::All; }
  SmallVector<uint64_t> getCellStrides(const DataLayout &layout) const {
    SmallVector<int64_t> shape(getShape());
    shape.back() = getPitch();
    return tai::computeRowMajorStrides(
        shape, tai::computeCellSize(getChildren(), layout));
  }
  uint64_t getPoolSize(const DataLayout &layout) const {
    return getCellStrides(layout).front() * getShape().front();
  }
};

struct ColumnsType : LevelType<ColumnsType> {
  using LevelType::LevelType;
  static constexpr StringLiteral name = "demo.columns";
  static StringRef getMnemonic() { return "columns"; }

  tai::CellActivity getActivity() const { return tai::CellActivity::Bits; }
  SmallVector<uint64_t> getCellStrides(const DataLayout &layout) const {
    SmallVector<uint64_t> strides;
    uint64_t stride = tai::computeCellSize(getChildren(), layout);
    for (int64_t extent : getShape()) {
      strides.push_back(stride);
      stride *= extent;
    }
    return strides;
  }
};

struct DemoDialect : Dialect {
  static StringRef getDialectNamespace() { return "demo"; }
  explicit DemoDialect(MLIRContext *context)
      : Dialect(getDialectNamespace(), context, TypeID::get<DemoDialect>()) {
    addTypes<PaddedType, ColumnsType>();
  }

  Type parseType(DialectAsmParser &parser) const override;
  void printType(Type type, DialectAsmPrinter &printer) const override;
};
} // namespace demo

MLIR_DECLARE_EXPLICIT_TYPE_ID(demo::DemoDialect)
MLIR_DEFINE_EXPLICIT_TYPE_ID(demo::DemoDialect)
MLIR_DECLARE_EXPLICIT_TYPE_ID(demo::PaddedType)
MLIR_DEFINE_EXPLICIT_TYPE_ID(demo::PaddedType)
MLIR_DECLARE_EXPLICIT_TYPE_ID(demo::ColumnsType)
MLIR_DEFINE_EXPLICIT_TYPE_ID(demo::ColumnsType)

Type demo::DemoDialect::parseType(DialectAsmParser &parser) const {
  StringRef kind;
  SmallVector<unsigned> axes;
  SmallVector<int64_t> shape;
  SmallVector<Type> children;
  int64_t pitch = 0;
  SMLoc loc = parser.getCurrentLocation();
  if (parser.parseKeyword(&kind))
    return {};
  bool isPadded = kind == PaddedType::getMnemonic();
  if (!isPadded && kind != ColumnsType::getMnemonic()) {
    parser.emitError(loc, "there is no level '") << kind << "'";
    return {};
  }
  if (parser.parseLess() || tai::parseLevelAxes(parser, axes, shape) ||
      parser.parseComma() ||
      (isPadded && (parser.parseInteger(pitch) || parser.parseComma())) ||
      tai::parseLevelChildren(parser, children) || parser.parseGreater())
    return {};
  if (axes.empty() || (isPadded && pitch < shape.back())) {
    parser.emitError(loc, "expects rows of at least the last extent");
    return {};
  }
  if (isPadded)
    return PaddedType::get(parser.getContext(), axes, shape, pitch, children);
  return ColumnsType::get(parser.getContext(), axes, shape, pitch, children);
}

void demo::DemoDialect::printType(Type type, DialectAsmPrinter &printer) const {
  auto level = cast<tai::SNodeTypeInterface>(type);
  printer << level.getKind() << "<";
  tai::printLevelAxes(printer, level.getAxes(), level.getShape());
  if (auto padded = dyn_cast<PaddedType>(type))
    printer << ", " << padded.getPitch();
  tai::printLevelChildren(printer, level.getChildren());
  printer << ">";
}

extern "C" LLVM_ATTRIBUTE_WEAK DialectPluginLibraryInfo
mlirGetDialectPluginInfo() {
  return {
      MLIR_PLUGIN_API_VERSION, "Levels", "0.1",
      [](DialectRegistry *registry) { registry->insert<demo::DemoDialect>(); }};
}
