//===- Layout.cpp - Paths and addresses in layouts ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/TreeLayout.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

char tai::getAxisLetter(unsigned axis) { return static_cast<char>('i' + axis); }

std::optional<unsigned> tai::parseAxisLetter(StringRef letter) {
  if (letter.size() != 1 || letter[0] < 'i' ||
      letter[0] >= static_cast<char>('i' + kMaxAxes))
    return std::nullopt;
  return letter[0] - 'i';
}

//===----------------------------------------------------------------------===//
// Sizes
//===----------------------------------------------------------------------===//

/// Returns the size of a component in bytes; an i1 takes one byte.
static uint64_t getScalarSize(Type type) {
  return llvm::divideCeil(type.getIntOrFloatBitWidth(), 8);
}

uint64_t tai::getValueSize(Type type, const DataLayout &) {
  if (auto vector = dyn_cast<VectorType>(type))
    return getScalarSize(vector.getElementType()) * vector.getNumElements();
  return getScalarSize(type);
}

uint64_t tai::getValueAlignment(Type type, const DataLayout &) {
  return getScalarSize(getElementTypeOrSelf(type));
}

SmallVector<uint64_t> tai::computeRowMajorStrides(ArrayRef<int64_t> shape,
                                                  uint64_t cellSize) {
  SmallVector<uint64_t> strides(shape.size());
  for (size_t i = shape.size(); i-- > 0;) {
    strides[i] = cellSize;
    cellSize *= shape[i];
  }
  return strides;
}

static uint64_t getChildSize(Type child, const DataLayout &layout) {
  if (auto places = dyn_cast<PlacesType>(child))
    return llvm::alignTo(
        getPlaceOffset(places, places.getTypes().size(), layout),
        computeCellAlignment(child, layout));
  auto level = cast<SNodeTypeInterface>(child);
  return level.getPoolSize(layout);
}

uint64_t tai::computeCellAlignment(ArrayRef<Type> children,
                                   const DataLayout &layout) {
  uint64_t alignment = 1;
  for (Type child : children) {
    if (auto places = dyn_cast<PlacesType>(child)) {
      for (Type type : places.getTypes())
        alignment = std::max(alignment, getValueAlignment(type, layout));
    } else {
      alignment = std::max(
          alignment, cast<SNodeTypeInterface>(child).getCellAlignment(layout));
    }
  }
  return alignment;
}

uint64_t tai::getChildOffset(ArrayRef<Type> children, unsigned index,
                             const DataLayout &layout) {
  uint64_t offset = 0;
  for (unsigned i = 0; i <= index && i < children.size(); ++i) {
    offset = llvm::alignTo(offset, computeCellAlignment(children[i], layout));
    if (i < index)
      offset += getChildSize(children[i], layout);
  }
  return offset;
}

uint64_t tai::computeCellSize(ArrayRef<Type> children,
                              const DataLayout &layout) {
  return llvm::alignTo(getChildOffset(children, children.size(), layout),
                       computeCellAlignment(children, layout));
}

uint64_t tai::getPlaceOffset(PlacesType places, unsigned index,
                             const DataLayout &layout) {
  uint64_t offset = 0;
  for (auto [i, type] : llvm::enumerate(places.getTypes())) {
    if (i > index)
      break;
    offset = llvm::alignTo(offset, getValueAlignment(type, layout));
    if (i < index)
      offset += getValueSize(type, layout);
  }
  return offset;
}

/// The children of the root are aligned to cache lines, so that two arrays do
/// not share a line.
static constexpr uint64_t kCacheLine = 64;

/// Returns the total size of the cells of a tree in bytes.
static uint64_t getCellsSize(RootType root, const DataLayout &layout) {
  uint64_t size = 0;
  for (Type child : root.getChildren())
    size = llvm::alignTo(size, kCacheLine) + getChildSize(child, layout);
  return size;
}

//===----------------------------------------------------------------------===//
// Paths
//===----------------------------------------------------------------------===//

SNodeTypeInterface PlacePath::getFirstSparse() const {
  for (const PathLevel &level : levels)
    if (level.type.isSparse())
      return level.type;
  return {};
}

/// Extends a path by one level: `level`, which is child number `child` of the
/// path's last level.
static void enter(PlacePath &path, SNodeTypeInterface level, unsigned child) {
  path.levels.push_back({level, child});
  for (auto [axis, extent] : llvm::zip(level.getAxes(), level.getShape())) {
    auto *at = llvm::lower_bound(path.axes, axis);
    size_t index = at - path.axes.begin();
    if (at != path.axes.end() && *at == axis) {
      path.shape[index] *= extent;
    } else {
      path.axes.insert(at, axis);
      path.shape.insert(path.shape.begin() + index, extent);
    }
  }
}

static void walkChildren(ArrayRef<Type> children, PlacePath &path,
                         function_ref<void(const PlacePath &)> callback) {
  for (auto [position, child] : llvm::enumerate(children)) {
    if (auto places = dyn_cast<PlacesType>(child)) {
      path.places = places;
      path.placesChild = position;
      for (unsigned place = 0, e = places.getNames().size(); place != e;
           ++place) {
        path.place = place;
        callback(path);
      }
      continue;
    }
    auto level = cast<SNodeTypeInterface>(child);
    PlacePath below = path;
    enter(below, level, position);
    walkChildren(level.getChildren(), below, callback);
  }
}

void tai::walkPlaces(RootType root,
                     function_ref<void(const PlacePath &)> callback) {
  PlacePath path;
  walkChildren(root.getChildren(), path, callback);
}

const PlaceIndex::Places &PlaceIndex::placesOf(RootType root) const {
  std::lock_guard<std::mutex> lock(mutex);
  std::unique_ptr<Places> &places = known[root];
  if (places)
    return *places;
  places = std::make_unique<Places>();
  walkPlaces(root, [&](const PlacePath &path) {
    Position position;
    for (const PathLevel &level : path.levels)
      position.push_back(level.child);
    position.push_back(path.placesChild);
    position.push_back(path.place);
    // The verifier rejects two places of the same name, so the first one is
    // kept.
    places->try_emplace(path.places.getNames()[path.place].getValue(),
                        std::move(position));
  });
  return *places;
}

std::optional<PlacePath> PlaceIndex::find(RootType root, StringRef name) const {
  const Places &places = placesOf(root);
  auto found = places.find(name);
  if (found == places.end())
    return std::nullopt;
  ArrayRef<unsigned> position = found->second;
  PlacePath path;
  ArrayRef<Type> children = root.getChildren();
  for (unsigned child : position.drop_back(2)) {
    auto level = cast<SNodeTypeInterface>(children[child]);
    enter(path, level, child);
    children = level.getChildren();
  }
  path.placesChild = position[position.size() - 2];
  path.place = position.back();
  path.places = cast<PlacesType>(children[path.placesChild]);
  return path;
}

std::optional<PlacePath> tai::findPlace(RootType root, StringRef name) {
  return root.getDialect().getRegisteredInterface<PlaceIndex>()->find(root,
                                                                      name);
}

//===----------------------------------------------------------------------===//
// Fields
//===----------------------------------------------------------------------===//

/// The child numbers on the path down to the innermost sparse level of a place.
static SmallVector<unsigned> getSparsePosition(const PlacePath &path) {
  SmallVector<unsigned> position;
  size_t count = 0;
  for (auto [number, level] : llvm::enumerate(path.levels)) {
    position.push_back(level.child);
    if (level.type.isSparse())
      count = number + 1;
  }
  position.truncate(count);
  return position;
}

bool mlir::tai::haveSameActivity(const FieldLayout &a, const FieldLayout &b) {
  return a.tree == b.tree && a.axisOfIndex == b.axisOfIndex &&
         a.shape == b.shape && a.offset == b.offset &&
         getSparsePosition(a.path) == getSparsePosition(b.path);
}

FlatSymbolRefAttr tai::getNamedField(Operation *op) {
  if (auto access = dyn_cast<FieldAccessOpInterface>(op))
    return access.getFieldAttr();
  if (auto loop = dyn_cast<ParallelForOp>(op))
    return loop.getFieldAttr();
  if (auto question = dyn_cast<VisitsAllOp>(op))
    return question.getFieldAttr();
  return {};
}

FieldOp tai::lookupField(Operation *from, FlatSymbolRefAttr name) {
  return SymbolTable::lookupNearestSymbolFrom<FieldOp>(from, name);
}

FailureOr<FieldLayout> tai::getFieldLayout(FieldOp field) {
  FieldLayout layout;
  layout.field = field;
  layout.tree = SymbolTable::lookupNearestSymbolFrom<TreeOp>(
      field->getParentOp(), field.getTreeAttr());
  if (!layout.tree)
    return failure();
  std::optional<PlacePath> path =
      findPlace(cast<RootType>(layout.tree.getLayout()), field.getPlace());
  if (!path)
    return failure();
  layout.path = std::move(*path);
  unsigned rank = layout.path.getRank();
  layout.axisOfIndex = layout.path.axes;
  if (std::optional<ArrayRef<int64_t>> order = field.getOrder())
    for (unsigned i = 0; i != rank; ++i)
      layout.axisOfIndex[i] = (*order)[i];
  for (unsigned axis : layout.axisOfIndex)
    layout.shape.push_back(
        layout.path.shape[llvm::find(layout.path.axes, axis) -
                          layout.path.axes.begin()]);
  layout.offset.assign(rank, 0);
  if (std::optional<ArrayRef<int64_t>> offset = field.getOffset())
    layout.offset.assign(offset->begin(), offset->end());
  return layout;
}

//===----------------------------------------------------------------------===//
// Storage
//===----------------------------------------------------------------------===//

int64_t SparseNode::getNumCells() const {
  int64_t count = 1;
  for (const Step &step : steps)
    count *= step.cells;
  return count;
}

/// Activity data start on a new page, so that the pages with cells can be
/// returned to the system one by one.
static constexpr uint64_t kPage = 4096;

static uint64_t getActivitySize(const SparseNode &node) {
  uint64_t cells = node.getNumCells();
  if (node.type.isList())
    return llvm::alignTo(cells / node.steps.back().cells * 4, 64);
  return llvm::alignTo(cells, 512) / 8;
}

/// Adds the steps of a level to a sparse level's address computation. Merges
/// axes whose cells are contiguous into one step.
void TreeLayout::addSteps(SNodeTypeInterface level, SparseNode &node) {
  size_t own = node.steps.size();
  for (auto [extent, stride] :
       llvm::zip(level.getShape(), level.getCellStrides(dataLayout))) {
    if (node.steps.size() > own && node.steps.back().stride == stride * extent)
      node.steps.back() = {node.steps.back().cells * extent, stride};
    else
      node.steps.push_back({extent, stride});
  }
  // The stride of the last step must be the size of a cell, because zeroing a
  // cell relies on it.
  uint64_t size = level.getCellSize(dataLayout);
  if (node.steps.empty() || node.steps.back().stride != size)
    node.steps.push_back({1, size});
}

void TreeLayout::findNodes(ArrayRef<Type> children, const SparseNode &above,
                           function_ref<uint64_t(unsigned)> offsetOf) {
  for (auto [number, child] : llvm::enumerate(children)) {
    auto level = dyn_cast<SNodeTypeInterface>(child);
    if (!level)
      continue;
    SparseNode node = above;
    node.type = level;
    node.position.push_back(number);
    node.offset += offsetOf(number);
    addSteps(level, node);
    SparseNode below = node;
    if (level.isSparse()) {
      below.parent = nodes->size();
      nodes->push_back(std::move(node));
    }
    ArrayRef<Type> inner = level.getChildren();
    findNodes(inner, below,
              [&](unsigned index) { return getOffset(inner, index); });
  }
}

ArrayRef<SparseNode> TreeLayout::getSparseNodes() {
  if (nodes)
    return *nodes;
  nodes.emplace();
  findNodes(root.getChildren(), SparseNode(),
            [&](unsigned index) { return getRootOffset(index); });
  uint64_t offset = llvm::alignTo(getCellsSize(root, dataLayout), kPage);
  for (auto [number, node] : llvm::enumerate(*nodes)) {
    node.activityOffset = offset;
    offset += getActivitySize(node);
    numberOfNode.try_emplace(node.position, number);
  }
  return *nodes;
}

TreeSize TreeLayout::getTreeSize() {
  uint64_t cells = getCellsSize(root, dataLayout);
  if (getSparseNodes().empty())
    return {cells, cells};
  const SparseNode &last = nodes->back();
  return {cells, last.activityOffset + getActivitySize(last)};
}

uint64_t TreeLayout::getRootOffset(unsigned index) {
  if (rootOffsets.empty()) {
    uint64_t size = 0;
    for (Type child : root.getChildren()) {
      size = llvm::alignTo(size, kCacheLine);
      rootOffsets.push_back(size);
      size += getChildSize(child, dataLayout);
    }
  }
  return rootOffsets[index];
}

uint64_t TreeLayout::getOffset(ArrayRef<Type> children, unsigned index) {
  SmallVector<uint64_t> &known = offsets[children.data()];
  if (known.empty()) {
    uint64_t offset = 0;
    for (Type child : children) {
      offset = llvm::alignTo(offset, computeCellAlignment(child, dataLayout));
      known.push_back(offset);
      offset += getChildSize(child, dataLayout);
    }
  }
  return known[index];
}

uint64_t TreeLayout::getOffsetOfPlace(PlacesType places, unsigned index) {
  SmallVector<uint64_t> &known = placeOffsets[places];
  if (known.empty()) {
    uint64_t offset = 0;
    for (Type type : places.getTypes()) {
      offset = llvm::alignTo(offset, getValueAlignment(type, dataLayout));
      known.push_back(offset);
      offset += getValueSize(type, dataLayout);
    }
  }
  return known[index];
}

ArrayRef<uint64_t> TreeLayout::getCellStrides(SNodeTypeInterface level) {
  auto [at, isNew] = cellStrides.try_emplace(level);
  if (isNew)
    at->second = level.getCellStrides(dataLayout);
  return at->second;
}

FieldStorage TreeLayout::getFieldStorage(const FieldLayout &layout) {
  const PlacePath &path = layout.path;
  FieldStorage storage;
  ArrayRef<Type> children = root.getChildren();
  bool isSparse = static_cast<bool>(path.getFirstSparse());
  if (isSparse)
    (void)getSparseNodes();

  // For each axis: the number of cells along it below the current level, and in
  // all levels together.
  SmallVector<int64_t> below(kMaxAxes, 1), whole(kMaxAxes, 1);
  for (auto [axis, extent] : llvm::zip(path.axes, path.shape))
    below[axis] = whole[axis] = extent;

  auto offsetOf = [&](size_t depth, unsigned child) {
    return depth == 0 ? getRootOffset(child) : getOffset(children, child);
  };
  SmallVector<unsigned> position;
  for (auto [number, level] : llvm::enumerate(path.levels)) {
    position.push_back(level.child);
    if (level.type.isSparse())
      storage.sparse.push_back({static_cast<unsigned>(number),
                                numberOfNode.lookup(ArrayRef(position))});
    storage.offset += offsetOf(number, level.child);
    ArrayRef<uint64_t> strides = getCellStrides(level.type);
    int64_t weight = 1;
    SmallVector<IndexDigit> digits;
    for (size_t i = level.type.getAxes().size(); i-- > 0;) {
      unsigned axis = level.type.getAxes()[i];
      int64_t extent = level.type.getShape()[i];
      below[axis] /= extent;
      unsigned dimension =
          llvm::find(layout.axisOfIndex, axis) - layout.axisOfIndex.begin();
      digits.push_back({dimension, static_cast<unsigned>(number), below[axis],
                        extent, strides[i], weight, extent == whole[axis]});
      weight *= extent;
    }
    storage.digits.append(digits.rbegin(), digits.rend());
    children = level.type.getChildren();
  }
  storage.offset += offsetOf(path.levels.size(), path.placesChild);
  storage.offset += getOffsetOfPlace(path.places, path.place);
  return storage;
}

SmallVector<SparseNode> tai::getSparseNodes(RootType root,
                                            const DataLayout &dataLayout) {
  return SmallVector<SparseNode>(TreeLayout(root, dataLayout).getSparseNodes());
}

TreeSize tai::getTreeSize(RootType root, const DataLayout &dataLayout) {
  return TreeLayout(root, dataLayout).getTreeSize();
}

FieldStorage tai::getFieldStorage(const FieldLayout &layout,
                                  const DataLayout &dataLayout) {
  TreeOp tree = layout.tree;
  auto root = cast<RootType>(tree.getLayout());
  return TreeLayout(root, dataLayout).getFieldStorage(layout);
}
