//===- MeshDialect.cpp - The dialect of meshes ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/IR/DialectImplementation.h"
#include "tai/Dialect/Mesh/IR/Mesh.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Dialect/Mesh/IR/MeshDialect.cpp.inc"
#include "tai/Dialect/Mesh/IR/MeshEnums.cpp.inc"

#define GET_ATTRDEF_CLASSES
#include "tai/Dialect/Mesh/IR/MeshAttrs.cpp.inc"
#define GET_TYPEDEF_CLASSES
#include "tai/Dialect/Mesh/IR/MeshTypes.cpp.inc"
#define GET_OP_CLASSES
#include "tai/Dialect/Mesh/IR/MeshOps.cpp.inc"

void TaiMeshDialect::initialize() {
  addAttributes<
#define GET_ATTRDEF_LIST
#include "tai/Dialect/Mesh/IR/MeshAttrs.cpp.inc"
      >();
  addTypes<
#define GET_TYPEDEF_LIST
#include "tai/Dialect/Mesh/IR/MeshTypes.cpp.inc"
      >();
  addOperations<
#define GET_OP_LIST
#include "tai/Dialect/Mesh/IR/MeshOps.cpp.inc"
      >();
}

//===----------------------------------------------------------------------===//
// Shards
//===----------------------------------------------------------------------===//

StringRef ShardType::getKind() const { return "shard"; }
CellActivity ShardType::getActivity() const { return CellActivity::All; }
ArrayRef<unsigned> ShardType::getAxes() const { return {}; }
ArrayRef<int64_t> ShardType::getShape() const { return {}; }

Type ShardType::parse(AsmParser &parser) {
  SmallVector<unsigned> axes;
  SmallVector<int64_t> ranks;
  SmallVector<Type> children;
  SMLoc loc = parser.getCurrentLocation();
  if (parser.parseLess() || parseLevelAxes(parser, axes, ranks) ||
      parser.parseComma() || parseLevelChildren(parser, children) ||
      parser.parseGreater())
    return {};
  if (axes.size() != 1) {
    parser.emitError(loc, "expects one axis, but got ") << axes.size();
    return {};
  }
  return getChecked([&] { return parser.emitError(loc); }, parser.getContext(),
                    axes.front(), ranks.front(), children);
}

void ShardType::print(AsmPrinter &printer) const {
  printer << "<";
  printLevelAxes(printer, getAxis(), getRanks());
  printLevelChildren(printer, getChildren());
  printer << ">";
}

/// Verifies the levels below a shard. `isDivided`: a level above divides the
/// shard's axis already.
static LogicalResult verifyBelow(function_ref<InFlightDiagnostic()> emitError,
                                 unsigned axis, int64_t ranks,
                                 ArrayRef<Type> children, bool isDivided) {
  char letter = getAxisLetter(axis);
  for (Type child : children) {
    auto level = dyn_cast<SNodeTypeInterface>(child);
    if (!level) {
      if (isDivided)
        continue;
      return emitError() << "expects a level below that divides axis '"
                         << letter << "', along which it is sharded";
    }
    if (!isa<DenseType>(child))
      return emitError() << "expects 'dense' levels below, but got '"
                         << level.getKind() << "'";
    bool divides = false;
    for (auto [own, extent] : llvm::zip(level.getAxes(), level.getShape())) {
      if (own != axis)
        continue;
      if (isDivided)
        return emitError() << "expects one level below that divides axis '"
                           << letter << "', but got two";
      if (extent % ranks != 0)
        return emitError() << "has " << ranks << " ranks, which do not divide "
                           << "the extent " << extent << " of axis '" << letter
                           << "'";
      divides = true;
    }
    if (failed(verifyBelow(emitError, axis, ranks, level.getChildren(),
                           isDivided || divides)))
      return failure();
  }
  return success();
}

LogicalResult ShardType::verify(function_ref<InFlightDiagnostic()> emitError,
                                unsigned axis, int64_t ranks,
                                ArrayRef<Type> children) {
  if (axis >= kMaxAxes)
    return emitError() << "expects an axis below " << kMaxAxes << ", but got "
                       << axis;
  if (ranks <= 0)
    return emitError() << "expects a positive number of ranks, but got "
                       << ranks;
  if (children.empty())
    return emitError() << "expects at least one child";
  return verifyBelow(emitError, axis, ranks, children, /*isDivided=*/false);
}

std::optional<Sharding> tai::getSharding(const FieldLayout &layout) {
  for (const PathLevel &level : layout.path.levels) {
    auto shard = dyn_cast<ShardType>(level.type);
    if (!shard)
      continue;
    unsigned dimension = llvm::find(layout.axisOfIndex, shard.getAxis()) -
                         layout.axisOfIndex.begin();
    return Sharding{dimension, shard.getRanks(),
                    layout.shape[dimension] / shard.getRanks(),
                    layout.offset[dimension]};
  }
  return std::nullopt;
}

std::optional<Sharding> tai::findSharding(Operation *user,
                                          FlatSymbolRefAttr name) {
  FieldOp field = name ? lookupField(user, name) : FieldOp();
  if (!field)
    return std::nullopt;
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout))
    return std::nullopt;
  return getSharding(*layout);
}

bool tai::hasShards(TreeOp tree) {
  return tree.getLayout()
      .walk([](ShardType) { return WalkResult::interrupt(); })
      .wasInterrupted();
}

static LogicalResult verifyAbove(TreeOp tree, ArrayRef<Type> children,
                                 const SmallVector<unsigned> &divided,
                                 StringRef sparse) {
  for (Type child : children) {
    auto level = dyn_cast<SNodeTypeInterface>(child);
    if (!level)
      continue;
    if (auto shard = dyn_cast<ShardType>(child)) {
      if (!sparse.empty())
        return tree.emitOpError()
               << "expects 'dense' levels above a 'shard' level, but got '"
               << sparse << "'";
      if (llvm::is_contained(divided, shard.getAxis()))
        return tree.emitOpError()
               << "has a level above a 'shard' level that divides axis '"
               << getAxisLetter(shard.getAxis()) << "', too";
      continue;
    }
    SmallVector<unsigned> below = divided;
    llvm::append_range(below, level.getAxes());
    if (failed(verifyAbove(tree, level.getChildren(), below,
                           level.isSparse() ? level.getKind() : sparse)))
      return failure();
  }
  return success();
}

LogicalResult tai::verifyShards(TreeOp tree) {
  return verifyAbove(tree, cast<RootType>(tree.getLayout()).getChildren(),
                     /*divided=*/{}, /*sparse=*/{});
}

//===----------------------------------------------------------------------===//
// Exchanges
//===----------------------------------------------------------------------===//

/// True for the kinds about the rows of a sharded field.
static bool isAboutRows(ExchangeKind kind) {
  return llvm::is_contained({ExchangeKind::Fetch, ExchangeKind::Clear,
                             ExchangeKind::Collect, ExchangeKind::Gather,
                             ExchangeKind::Stale},
                            kind);
}

LogicalResult ExchangeOp::verifySymbolUses(SymbolTableCollection &symbols) {
  // (exchange_c1)
  auto field = symbols.lookupNearestSymbolFrom<FieldOp>(*this, getFieldAttr());
  if (!field)
    return emitOpError() << "names '" << getFieldAttr()
                         << "', which is not a field";
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout))
    return success(); // reported for the field
  if (SNodeTypeInterface sparse = layout->path.getFirstSparse())
    return emitOpError() << "expects a field without sparse levels, but '"
                         << getFieldAttr() << "' is below a '"
                         << sparse.getKind() << "' level";
  // (exchange_c2)
  std::optional<Sharding> sharding = getSharding(*layout);
  bool isEither =
      llvm::is_contained({ExchangeKind::Open, ExchangeKind::Sum}, getKind());
  if (!isEither && isAboutRows(getKind()) != sharding.has_value())
    return emitOpError() << "'" << stringifyExchangeKind(getKind())
                         << "' expects a field that is "
                         << (sharding ? "not " : "") << "below a 'shard' level";
  // (exchange_c3)
  auto most = static_cast<uint64_t>(sharding ? sharding->block : 0);
  if (getBefore() > most || getAfter() > most)
    return emitOpError() << "expects halos of 0 to " << most
                         << " rows, but got " << int64_t(getBefore()) << " and "
                         << int64_t(getAfter());
  // (exchange_c4)
  ArrayRef<int64_t> dims = getDims();
  if (dims.size() != getAt().size())
    return emitOpError() << "expects a dimension for each index, but got "
                         << dims.size() << " and " << getAt().size();
  for (auto [position, dim] : llvm::enumerate(dims))
    if (dim < 0 || dim >= int64_t(layout->shape.size()) ||
        (position && dims[position - 1] >= dim) ||
        (sharding && dim == sharding->dimension))
      return emitOpError() << "expects ascending dimensions of '"
                           << getFieldAttr()
                           << "' without the sharded one, but got " << dim;
  return success();
}
