//===- Memory.cpp - Fields, arrays and locals -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Program.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;

static int64_t countNumbers(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? vector.getNumElements() : 1;
}

static Numbers readNumbers(const char *from, Type type) {
  Type scalar = getElementTypeOrSelf(type);
  Numbers numbers;
  for (int64_t i = 0; i != countNumbers(type); ++i)
    numbers.push_back(readNumber(from + i * getByteSize(scalar), scalar));
  return numbers;
}

static void writeNumbers(const Numbers &numbers, Type type, char *to) {
  int64_t size = getByteSize(getElementTypeOrSelf(type));
  for (auto [i, number] : llvm::enumerate(numbers))
    writeNumber(number, to + i * size);
}

static std::string describeIndices(ArrayRef<int64_t> indices) {
  std::string text;
  llvm::raw_string_ostream stream(text);
  stream << '[';
  llvm::interleaveComma(indices, stream);
  stream << ']';
  return text;
}

//===----------------------------------------------------------------------===//
// Locals and stacks
//===----------------------------------------------------------------------===//

LogicalResult Run::runAlloca(Operation *op) {
  Datum datum;
  datum.variable = std::make_shared<Variable>();
  if (auto local = dyn_cast<LocalType>(op->getResult(0).getType())) {
    Type type = local.getElementType();
    datum.variable->value.assign(countNumbers(type),
                                 getZero(getElementTypeOrSelf(type)));
  }
  set(op->getResult(0), std::move(datum));
  return success();
}

LogicalResult Run::runLocalLoad(Operation *op) {
  auto load = cast<LocalLoadOp>(op);
  set(load.getValue(), Datum(get(load.getLocal()).variable->value));
  return success();
}

LogicalResult Run::runLocalStore(Operation *op) {
  auto store = cast<LocalStoreOp>(op);
  get(store.getLocal()).variable->value = get(store.getValue()).numbers;
  return success();
}

LogicalResult Run::runStackPush(Operation *op) {
  auto push = cast<StackPushOp>(op);
  get(push.getStack()).variable->value.push_back(getNumber(push.getValue()));
  return success();
}

LogicalResult Run::runStackPop(Operation *op) {
  auto pop = cast<StackPopOp>(op);
  Numbers &stack = get(pop.getStack()).variable->value;
  if (stack.empty())
    return fail(op, "the stack is empty");
  Number last = stack.pop_back_val();
  set(pop.getValue(), Datum(last));
  return success();
}

//===----------------------------------------------------------------------===//
// Arrays
//===----------------------------------------------------------------------===//

LogicalResult Run::runAlloc(Operation *op) {
  auto type = cast<MemRefType>(op->getResult(0).getType());
  auto array = std::make_shared<Array>();
  array->element = type.getElementType();
  unsigned next = 0;
  int64_t bytes = countNumbers(array->element) *
                  getByteSize(getElementTypeOrSelf(array->element));
  for (int64_t extent : type.getShape()) {
    if (ShapedType::isDynamic(extent))
      extent = toIndex(getNumber(op->getOperand(next++)));
    if (extent < 0 || (extent > 0 && bytes > (int64_t(1) << 40) / extent))
      return fail(op, "there is no array of that size", TAI_FAIL_MEMORY);
    array->extents.push_back(extent);
    bytes *= extent;
  }
  array->owned = std::make_unique<char[]>(bytes);
  array->data = array->owned.get();
  Datum datum;
  datum.array = std::move(array);
  set(op->getResult(0), std::move(datum));
  return success();
}

LogicalResult Run::runDim(Operation *op) {
  auto dim = cast<memref::DimOp>(op);
  ArrayRef<int64_t> extents = get(dim.getSource()).array->extents;
  int64_t at = toIndex(getNumber(dim.getIndex()));
  if (at < 0 || at >= static_cast<int64_t>(extents.size()))
    return fail(op, "the array has no dimension " + Twine(at), TAI_FAIL_INDEX);
  set(dim, Datum(fromIndex(extents[at])));
  return success();
}

FailureOr<char *> Run::locate(Operation *op, Value array, ValueRange indices) {
  Array &memory = *get(array).array;
  SmallVector<int64_t> at = getIndices(indices);
  int64_t position = 0;
  for (auto [index, extent] : llvm::zip_equal(at, memory.extents)) {
    if (index < 0 || index >= extent)
      return fail(op,
                  "index " + describeIndices(at) +
                      " is out of range for an array of shape " +
                      describeIndices(memory.extents),
                  TAI_FAIL_INDEX);
    position = position * extent + index;
  }
  int64_t size = countNumbers(memory.element) *
                 getByteSize(getElementTypeOrSelf(memory.element));
  return memory.data + position * size;
}

LogicalResult Run::runArrayLoad(Operation *op) {
  auto load = cast<memref::LoadOp>(op);
  FailureOr<char *> at = locate(op, load.getMemRef(), load.getIndices());
  if (failed(at))
    return failure();
  set(load, Datum(readNumbers(*at, load.getType())));
  return success();
}

LogicalResult Run::runArrayStore(Operation *op) {
  auto store = cast<memref::StoreOp>(op);
  FailureOr<char *> at = locate(op, store.getMemRef(), store.getIndices());
  if (failed(at))
    return failure();
  Value value = store.getValueToStore();
  writeNumbers(get(value).numbers, value.getType(), *at);
  return success();
}

static Number combineArray(arith::AtomicRMWKind kind, const Number &a,
                           const Number &b) {
  using Kind = arith::AtomicRMWKind;
  auto real = [](const Number &n) { return std::get<llvm::APFloat>(n); };
  auto whole = [](const Number &n) { return std::get<llvm::APInt>(n); };
  switch (kind) {
  case Kind::addf:
  case Kind::addi:
    return add(a, b);
  case Kind::mulf:
  case Kind::muli:
    return multiply(a, b);
  case Kind::assign:
    return b;
  case Kind::maximumf:
    return llvm::maximum(real(a), real(b));
  case Kind::minimumf:
    return llvm::minimum(real(a), real(b));
  case Kind::maxnumf:
    return llvm::maxnum(real(a), real(b));
  case Kind::minnumf:
    return llvm::minnum(real(a), real(b));
  case Kind::maxs:
    return llvm::APIntOps::smax(whole(a), whole(b));
  case Kind::mins:
    return llvm::APIntOps::smin(whole(a), whole(b));
  case Kind::maxu:
    return llvm::APIntOps::umax(whole(a), whole(b));
  case Kind::minu:
    return llvm::APIntOps::umin(whole(a), whole(b));
  case Kind::andi:
    return whole(a) & whole(b);
  case Kind::ori:
    return whole(a) | whole(b);
  case Kind::xori:
    return whole(a) ^ whole(b);
  }
  llvm_unreachable("unknown kind");
}

LogicalResult Run::runArrayAtomic(Operation *op) {
  auto atomic = cast<memref::AtomicRMWOp>(op);
  FailureOr<char *> at = locate(op, atomic.getMemref(), atomic.getIndices());
  if (failed(at))
    return failure();
  Type type = atomic.getResult().getType();
  Numbers old = readNumbers(*at, type), combined;
  for (auto [a, b] : llvm::zip_equal(old, get(atomic.getValue()).numbers))
    combined.push_back(combineArray(atomic.getKind(), a, b));
  writeNumbers(combined, type, *at);
  set(atomic.getResult(), Datum(old));
  return success();
}

//===----------------------------------------------------------------------===//
// Fields
//===----------------------------------------------------------------------===//

const FieldPlace &Run::getField(Operation *op) {
  return program.getField(
      op->getAttrOfType<FlatSymbolRefAttr>("field").getAttr());
}

LogicalResult Run::checkIndices(Operation *op, const FieldPlace &field,
                                SmallVector<int64_t> &indices) {
  SmallVector<int64_t> given = indices;
  bool inRange = true;
  for (auto [index, first, extent] :
       llvm::zip_equal(indices, field.layout.offset, field.layout.shape)) {
    index -= first;
    inRange &= index >= 0 && index < extent;
  }
  if (inRange)
    return success();
  std::string offset =
      llvm::all_of(field.layout.offset, [](int64_t x) { return x == 0; })
          ? ""
          : ", which begins at " + describeIndices(field.layout.offset);
  return fail(op,
              "index " + describeIndices(given) +
                  " is out of range for field '@" +
                  FieldOp(field.layout.field).getSymName() + "' of shape " +
                  describeIndices(field.layout.shape) + offset,
              TAI_FAIL_INDEX);
}

/// The cell of a level, counted row-major, level below level.
int64_t Run::getCell(const FieldPlace &field, unsigned level,
                     ArrayRef<int64_t> indices) {
  int64_t cell = 0;
  for (unsigned l = 0; l <= level; ++l) {
    cell *= field.layout.path.levels[l].type.getNumCells();
    for (const IndexDigit &digit : field.storage.digits)
      if (digit.level == l)
        cell += indices[digit.dimension] / digit.divisor % digit.extent *
                digit.weight;
  }
  return cell;
}

int64_t Run::getListLength(const FieldPlace &field, unsigned node,
                           int64_t list) {
  int32_t length;
  std::memcpy(&length,
              getTree(field) + field.nodes[node].activityOffset + 4 * list, 4);
  return length;
}

bool Run::isActive(const FieldPlace &field, FieldStorage::SparseLevel level,
                   int64_t cell) {
  const SparseNode &node = field.nodes[level.node];
  if (node.type.isList()) {
    int64_t capacity = node.type.getNumCells();
    return cell % capacity < getListLength(field, level.node, cell / capacity);
  }
  uint64_t word;
  std::memcpy(&word, getTree(field) + node.activityOffset + cell / 64 * 8, 8);
  return word >> cell % 64 & 1;
}

FailureOr<char *> Run::locate(Operation *op, const FieldPlace &field,
                              SmallVector<int64_t> indices,
                              ValueRange components, bool activates,
                              bool &exists) {
  exists = true;
  if (failed(checkIndices(op, field, indices)))
    return failure();
  int64_t component = 0;
  SmallVector<int64_t> at = getIndices(components);
  for (auto [index, extent] : llvm::zip(at, field.elementShape)) {
    if (index < 0 || index >= extent)
      return fail(op,
                  "index " + describeIndices(at) +
                      " is out of range for an element of field '@" +
                      FieldOp(field.layout.field).getSymName() + "'",
                  TAI_FAIL_INDEX);
    component = component * extent + index;
  }
  if (!field.storage.sparse.empty()) {
    FieldStorage::SparseLevel level = field.storage.sparse.back();
    int64_t cell = getCell(field, level.level, indices);
    exists = isActive(field, level, cell);
    if (!exists && activates && !keepsActivity)
      exists = tai_rt_activate(frame, getTree(field), level.node, cell,
                               describePlaceOf(op).c_str()) != 0;
  }
  uint64_t offset =
      field.storage.offset + component * getByteSize(field.scalar);
  for (const IndexDigit &digit : field.storage.digits)
    offset +=
        indices[digit.dimension] / digit.divisor % digit.extent * digit.stride;
  return getTree(field) + offset;
}

LogicalResult Run::runLoad(Operation *op) {
  auto load = cast<LoadOp>(op);
  bool exists;
  FailureOr<char *> at =
      locate(op, getField(op), getIndices(load.getIndices()),
             load.getComponents(), /*activates=*/false, exists);
  if (failed(at))
    return failure();
  Type type = load.getValue().getType();
  set(load.getValue(),
      exists ? Datum(readNumbers(*at, type))
             : Datum(Numbers(countNumbers(type),
                             getZero(getElementTypeOrSelf(type)))));
  return success();
}

LogicalResult Run::runStore(Operation *op) {
  auto store = cast<StoreOp>(op);
  bool exists;
  FailureOr<char *> at =
      locate(op, getField(op), getIndices(store.getIndices()),
             store.getComponents(), /*activates=*/true, exists);
  if (failed(at))
    return failure();
  if (exists)
    writeNumbers(get(store.getValue()).numbers, store.getValue().getType(),
                 *at);
  return success();
}

LogicalResult Run::runAtomic(Operation *op) {
  auto atomic = cast<AtomicOp>(op);
  bool exists;
  FailureOr<char *> at =
      locate(op, getField(op), getIndices(atomic.getIndices()),
             atomic.getComponents(), /*activates=*/true, exists);
  if (failed(at))
    return failure();
  Type type = atomic.getOld().getType();
  Numbers old(countNumbers(type), getZero(getElementTypeOrSelf(type)));
  if (exists) {
    old = readNumbers(*at, type);
    Numbers combined;
    for (auto [a, b] : llvm::zip_equal(old, get(atomic.getValue()).numbers))
      combined.push_back(combine(atomic.getKind(), a, b));
    writeNumbers(combined, type, *at);
  }
  set(atomic.getOld(), Datum(old));
  return success();
}

//===----------------------------------------------------------------------===//
// Topology
//===----------------------------------------------------------------------===//

/// That `up` levels up, 1 being the innermost, or the nearest above it.
const FieldStorage::SparseLevel *Run::findLevel(const FieldPlace &field,
                                                int64_t up) {
  int64_t level = static_cast<int64_t>(field.layout.path.levels.size()) - up;
  for (const auto &sparse : llvm::reverse(field.storage.sparse))
    if (static_cast<int64_t>(sparse.level) <= level)
      return &sparse;
  return nullptr;
}

LogicalResult Run::runActivate(Operation *op) {
  const FieldPlace &field = getField(op);
  SmallVector<int64_t> indices = getIndices(op->getOperands());
  if (failed(checkIndices(op, field, indices)))
    return failure();
  if (auto *level = findLevel(field, cast<ActivateOp>(op).getLevel()))
    tai_rt_activate(frame, getTree(field), level->node,
                    getCell(field, level->level, indices),
                    describePlaceOf(op).c_str());
  return success();
}

LogicalResult Run::runDeactivate(Operation *op) {
  const FieldPlace &field = getField(op);
  SmallVector<int64_t> indices = getIndices(op->getOperands());
  if (failed(checkIndices(op, field, indices)))
    return failure();
  if (auto *level = findLevel(field, cast<DeactivateOp>(op).getLevel()))
    tai_rt_deactivate(frame, getTree(field), level->node,
                      getCell(field, level->level, indices),
                      describePlaceOf(op).c_str());
  return success();
}

LogicalResult Run::runIsActive(Operation *op) {
  const FieldPlace &field = getField(op);
  SmallVector<int64_t> indices = getIndices(op->getOperands());
  if (failed(checkIndices(op, field, indices)))
    return failure();
  auto *level = findLevel(field, cast<IsActiveOp>(op).getLevel());
  bool active =
      !level || isActive(field, *level, getCell(field, level->level, indices));
  set(op->getResult(0), Datum(Number(llvm::APInt(1, active))));
  return success();
}

LogicalResult Run::runVisitsAll(Operation *op) {
  const FieldPlace &field = getField(op);
  bool all = field.storage.sparse.empty() ||
             tai_rt_list_is_current(frame, getTree(field),
                                    field.storage.sparse.back().node);
  set(op->getResult(0), Datum(Number(llvm::APInt(1, all))));
  return success();
}

FailureOr<FieldStorage::SparseLevel>
Run::findList(Operation *op, const FieldPlace &field, unsigned &dimension) {
  for (const auto &sparse : llvm::reverse(field.storage.sparse))
    if (field.nodes[sparse.node].type.isList()) {
      for (const IndexDigit &digit : field.storage.digits)
        if (digit.level == sparse.level)
          dimension = digit.dimension;
      return sparse;
    }
  return fail(op, "the field lies below no 'dynamic' level");
}

LogicalResult Run::runLength(Operation *op) {
  const FieldPlace &field = getField(op);
  unsigned dimension = 0;
  auto list = findList(op, field, dimension);
  if (failed(list))
    return failure();
  SmallVector<int64_t> indices = getIndices(op->getOperands());
  indices.insert(indices.begin() + dimension, field.layout.offset[dimension]);
  if (failed(checkIndices(op, field, indices)))
    return failure();
  int64_t number = getCell(field, list->level, indices) /
                   field.nodes[list->node].type.getNumCells();
  set(op->getResult(0),
      Datum(fromIndex(getListLength(field, list->node, number))));
  return success();
}

LogicalResult Run::runAppend(Operation *op) {
  auto append = cast<AppendOp>(op);
  const FieldPlace &field = getField(op);
  unsigned dimension = 0;
  auto list = findList(op, field, dimension);
  if (failed(list))
    return failure();
  if (list->level != field.storage.sparse.back().level)
    return fail(op, "the field is not directly below a 'dynamic' level");
  SmallVector<int64_t> given = getIndices(append.getIndices());
  given.insert(given.begin() + dimension, field.layout.offset[dimension]);
  SmallVector<int64_t> indices = given;
  if (failed(checkIndices(op, field, indices)))
    return failure();
  int64_t number = getCell(field, list->level, indices) /
                   field.nodes[list->node].type.getNumCells();
  int64_t at = tai_rt_append(frame, getTree(field), list->node, number,
                             describePlaceOf(op).c_str());
  // The launch has failed, and says so.
  if (at < 0)
    return failure();
  given[dimension] += at;
  bool exists;
  FailureOr<char *> place =
      locate(op, field, given, {}, /*activates=*/false, exists);
  if (failed(place))
    return failure();
  writeNumbers(get(append.getValue()).numbers, append.getValue().getType(),
               *place);
  set(append.getAt(), Datum(fromIndex(at)));
  return success();
}
