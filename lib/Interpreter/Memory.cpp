//===- Memory.cpp - Fields, arrays and locals -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Handlers.h"
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

static LogicalResult runAlloca(Run &run, Operation *op) {
  Datum datum;
  datum.variable = std::make_shared<Variable>();
  if (auto local = dyn_cast<LocalType>(op->getResult(0).getType())) {
    Type type = local.getElementType();
    datum.variable->value.assign(countNumbers(type),
                                 getZero(getElementTypeOrSelf(type)));
  }
  run.set(op->getResult(0), std::move(datum));
  return success();
}

static LogicalResult runLocalLoad(Run &run, Operation *op) {
  auto load = cast<LocalLoadOp>(op);
  run.set(load.getValue(), Datum(run.get(load.getLocal()).variable->value));
  return success();
}

static LogicalResult runLocalStore(Run &run, Operation *op) {
  auto store = cast<LocalStoreOp>(op);
  run.get(store.getLocal()).variable->value = run.get(store.getValue()).numbers;
  return success();
}

static LogicalResult runStackPush(Run &run, Operation *op) {
  auto push = cast<StackPushOp>(op);
  run.get(push.getStack())
      .variable->value.push_back(run.getNumber(push.getValue()));
  return success();
}

static LogicalResult runStackPop(Run &run, Operation *op) {
  auto pop = cast<StackPopOp>(op);
  Numbers &stack = run.get(pop.getStack()).variable->value;
  if (stack.empty())
    return run.fail(op, "the stack is empty");
  Number last = stack.pop_back_val();
  run.set(pop.getValue(), Datum(last));
  return success();
}

//===----------------------------------------------------------------------===//
// Arrays
//===----------------------------------------------------------------------===//

static LogicalResult runAlloc(Run &run, Operation *op) {
  auto type = cast<MemRefType>(op->getResult(0).getType());
  auto array = std::make_shared<Array>();
  array->element = type.getElementType();
  unsigned next = 0;
  int64_t bytes = countNumbers(array->element) *
                  getByteSize(getElementTypeOrSelf(array->element));
  for (int64_t extent : type.getShape()) {
    if (ShapedType::isDynamic(extent))
      extent = toIndex(run.getNumber(op->getOperand(next++)));
    if (extent < 0 || (extent > 0 && bytes > (int64_t(1) << 40) / extent))
      return run.fail(op, "there is no array of that size", TAI_FAIL_MEMORY);
    array->extents.push_back(extent);
    bytes *= extent;
  }
  array->owned = std::make_unique<char[]>(bytes);
  array->data = array->owned.get();
  Datum datum;
  datum.array = std::move(array);
  run.set(op->getResult(0), std::move(datum));
  return success();
}

static LogicalResult runDim(Run &run, Operation *op) {
  auto dim = cast<memref::DimOp>(op);
  ArrayRef<int64_t> extents = run.get(dim.getSource()).array->extents;
  int64_t at = toIndex(run.getNumber(dim.getIndex()));
  if (at < 0 || at >= static_cast<int64_t>(extents.size()))
    return run.fail(op, "the array has no dimension " + Twine(at),
                    TAI_FAIL_INDEX);
  run.set(dim, Datum(fromIndex(extents[at])));
  return success();
}

static FailureOr<char *> locate(Run &run, Operation *op, Value array,
                                ValueRange indices) {
  Array &memory = *run.get(array).array;
  SmallVector<int64_t> at = run.getIndices(indices);
  int64_t position = 0;
  for (auto [index, extent] : llvm::zip_equal(at, memory.extents)) {
    if (index < 0 || index >= extent)
      return run.fail(op,
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

static LogicalResult runArrayLoad(Run &run, Operation *op) {
  auto load = cast<memref::LoadOp>(op);
  FailureOr<char *> at = locate(run, op, load.getMemRef(), load.getIndices());
  if (failed(at))
    return failure();
  run.set(load, Datum(readNumbers(*at, load.getType())));
  return success();
}

static LogicalResult runArrayStore(Run &run, Operation *op) {
  auto store = cast<memref::StoreOp>(op);
  FailureOr<char *> at = locate(run, op, store.getMemRef(), store.getIndices());
  if (failed(at))
    return failure();
  Value value = store.getValueToStore();
  writeNumbers(run.get(value).numbers, value.getType(), *at);
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

static LogicalResult runArrayAtomic(Run &run, Operation *op) {
  auto atomic = cast<memref::AtomicRMWOp>(op);
  FailureOr<char *> at =
      locate(run, op, atomic.getMemref(), atomic.getIndices());
  if (failed(at))
    return failure();
  Type type = atomic.getResult().getType();
  Numbers old = readNumbers(*at, type), combined;
  for (auto [a, b] : llvm::zip_equal(old, run.get(atomic.getValue()).numbers))
    combined.push_back(combineArray(atomic.getKind(), a, b));
  writeNumbers(combined, type, *at);
  run.set(atomic.getResult(), Datum(old));
  return success();
}

//===----------------------------------------------------------------------===//
// Fields
//===----------------------------------------------------------------------===//

/// Fails the launch unless the indices are in range; subtracts the first index
/// of each dimension, so that they count from zero.
static LogicalResult checkIndices(Run &run, Operation *op,
                                  const FieldPlace &field,
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
  return run.fail(op,
                  "index " + describeIndices(given) +
                      " is out of range for field '@" +
                      FieldOp(field.layout.field).getSymName() + "' of shape " +
                      describeIndices(field.layout.shape) + offset,
                  TAI_FAIL_INDEX);
}

/// Returns the number of the cell with these indices in a level. Cells are
/// numbered row-major within a cell of the level above, one such cell after
/// another.
static int64_t getCell(const FieldPlace &field, unsigned level,
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

static int64_t getListLength(Run &run, const FieldPlace &field, unsigned node,
                             int64_t list) {
  int32_t length;
  std::memcpy(&length,
              run.getTree(field) + field.nodes[node].activityOffset + 4 * list,
              4);
  return length;
}

static bool isActive(Run &run, const FieldPlace &field,
                     FieldStorage::SparseLevel level, int64_t cell) {
  const SparseNode &node = field.nodes[level.node];
  if (node.type.isList()) {
    int64_t capacity = node.type.getNumCells();
    return cell % capacity <
           getListLength(run, field, level.node, cell / capacity);
  }
  uint64_t word;
  std::memcpy(&word, run.getTree(field) + node.activityOffset + cell / 64 * 8,
              8);
  return word >> cell % 64 & 1;
}

/// Finds the address of an element, or of one of its components; fails the
/// launch if an index is out of range.
static FailureOr<char *> locate(Run &run, Operation *op,
                                const FieldPlace &field,
                                SmallVector<int64_t> indices,
                                ValueRange components, bool activates,
                                bool &exists) {
  exists = true;
  if (failed(checkIndices(run, op, field, indices)))
    return failure();
  int64_t component = 0;
  SmallVector<int64_t> at = run.getIndices(components);
  for (auto [index, extent] : llvm::zip(at, field.elementShape)) {
    if (index < 0 || index >= extent)
      return run.fail(op,
                      "index " + describeIndices(at) +
                          " is out of range for an element of shape " +
                          describeIndices(field.elementShape) + " of field '@" +
                          FieldOp(field.layout.field).getSymName() + "'",
                      TAI_FAIL_INDEX);
    component = component * extent + index;
  }
  if (!field.storage.sparse.empty()) {
    FieldStorage::SparseLevel level = field.storage.sparse.back();
    int64_t cell = getCell(field, level.level, indices);
    exists = isActive(run, field, level, cell);
    if (!exists && activates && !run.keepsActivity)
      exists = tai_rt_activate(run.frame, run.getTree(field), level.node, cell,
                               describePlace(op->getLoc()).c_str()) != 0;
  }
  uint64_t offset =
      field.storage.offset + component * getByteSize(field.scalar);
  for (const IndexDigit &digit : field.storage.digits)
    offset +=
        indices[digit.dimension] / digit.divisor % digit.extent * digit.stride;
  return run.getTree(field) + offset;
}

static LogicalResult runLoad(Run &run, Operation *op) {
  auto load = cast<LoadOp>(op);
  bool exists;
  FailureOr<char *> at =
      locate(run, op, run.getField(op), run.getIndices(load.getIndices()),
             load.getComponents(), /*activates=*/false, exists);
  if (failed(at))
    return failure();
  Type type = load.getValue().getType();
  run.set(load.getValue(),
          exists ? Datum(readNumbers(*at, type))
                 : Datum(Numbers(countNumbers(type),
                                 getZero(getElementTypeOrSelf(type)))));
  return success();
}

static LogicalResult runStore(Run &run, Operation *op) {
  auto store = cast<StoreOp>(op);
  bool exists;
  FailureOr<char *> at =
      locate(run, op, run.getField(op), run.getIndices(store.getIndices()),
             store.getComponents(), /*activates=*/true, exists);
  if (failed(at))
    return failure();
  if (exists)
    writeNumbers(run.get(store.getValue()).numbers, store.getValue().getType(),
                 *at);
  return success();
}

static LogicalResult runAtomic(Run &run, Operation *op) {
  auto atomic = cast<AtomicOp>(op);
  bool exists;
  FailureOr<char *> at =
      locate(run, op, run.getField(op), run.getIndices(atomic.getIndices()),
             atomic.getComponents(), /*activates=*/true, exists);
  if (failed(at))
    return failure();
  Type type = atomic.getOld().getType();
  Numbers old(countNumbers(type), getZero(getElementTypeOrSelf(type)));
  if (exists) {
    old = readNumbers(*at, type);
    Numbers combined;
    for (auto [a, b] : llvm::zip_equal(old, run.get(atomic.getValue()).numbers))
      combined.push_back(combine(atomic.getKind(), a, b));
    writeNumbers(combined, type, *at);
  }
  run.set(atomic.getOld(), Datum(old));
  return success();
}

//===----------------------------------------------------------------------===//
// Topology
//===----------------------------------------------------------------------===//

/// Returns the sparse level to which a topology operation applies, or null: the
/// level that is `up` levels up, where 1 is the innermost level, or the nearest
/// sparse level above it.
static const FieldStorage::SparseLevel *findLevel(const FieldPlace &field,
                                                  int64_t up) {
  int64_t level = static_cast<int64_t>(field.layout.path.levels.size()) - up;
  for (const auto &sparse : llvm::reverse(field.storage.sparse))
    if (static_cast<int64_t>(sparse.level) <= level)
      return &sparse;
  return nullptr;
}

static LogicalResult runActivate(Run &run, Operation *op) {
  const FieldPlace &field = run.getField(op);
  SmallVector<int64_t> indices = run.getIndices(op->getOperands());
  if (failed(checkIndices(run, op, field, indices)))
    return failure();
  if (auto *level = findLevel(field, cast<ActivateOp>(op).getLevel()))
    tai_rt_activate(run.frame, run.getTree(field), level->node,
                    getCell(field, level->level, indices),
                    describePlace(op->getLoc()).c_str());
  return success();
}

static LogicalResult runDeactivate(Run &run, Operation *op) {
  const FieldPlace &field = run.getField(op);
  SmallVector<int64_t> indices = run.getIndices(op->getOperands());
  if (failed(checkIndices(run, op, field, indices)))
    return failure();
  if (auto *level = findLevel(field, cast<DeactivateOp>(op).getLevel()))
    tai_rt_deactivate(run.frame, run.getTree(field), level->node,
                      getCell(field, level->level, indices),
                      describePlace(op->getLoc()).c_str());
  return success();
}

static LogicalResult runIsActive(Run &run, Operation *op) {
  const FieldPlace &field = run.getField(op);
  SmallVector<int64_t> indices = run.getIndices(op->getOperands());
  if (failed(checkIndices(run, op, field, indices)))
    return failure();
  auto *level = findLevel(field, cast<IsActiveOp>(op).getLevel());
  bool active = !level || isActive(run, field, *level,
                                   getCell(field, level->level, indices));
  run.set(op->getResult(0), Datum(Number(llvm::APInt(1, active))));
  return success();
}

static LogicalResult runVisitsAll(Run &run, Operation *op) {
  const FieldPlace &field = run.getField(op);
  bool all = field.storage.sparse.empty() ||
             tai_rt_list_is_current(run.frame, run.getTree(field),
                                    field.storage.sparse.back().node);
  run.set(op->getResult(0), Datum(Number(llvm::APInt(1, all))));
  return success();
}

/// Finds the list that `append` or `length` refers to, and the dimension along
/// it.
static FailureOr<FieldStorage::SparseLevel> findList(Run &run, Operation *op,
                                                     const FieldPlace &field,
                                                     unsigned &dimension) {
  for (const auto &sparse : llvm::reverse(field.storage.sparse))
    if (field.nodes[sparse.node].type.isList()) {
      for (const IndexDigit &digit : field.storage.digits)
        if (digit.level == sparse.level)
          dimension = digit.dimension;
      return sparse;
    }
  return run.fail(op, "the field lies below no 'dynamic' level");
}

static LogicalResult runLength(Run &run, Operation *op) {
  const FieldPlace &field = run.getField(op);
  unsigned dimension = 0;
  auto list = findList(run, op, field, dimension);
  if (failed(list))
    return failure();
  SmallVector<int64_t> indices = run.getIndices(op->getOperands());
  indices.insert(indices.begin() + dimension, field.layout.offset[dimension]);
  if (failed(checkIndices(run, op, field, indices)))
    return failure();
  int64_t number = getCell(field, list->level, indices) /
                   field.nodes[list->node].type.getNumCells();
  run.set(op->getResult(0),
          Datum(fromIndex(getListLength(run, field, list->node, number))));
  return success();
}

static LogicalResult runAppend(Run &run, Operation *op) {
  auto append = cast<AppendOp>(op);
  const FieldPlace &field = run.getField(op);
  unsigned dimension = 0;
  auto list = findList(run, op, field, dimension);
  if (failed(list))
    return failure();
  if (list->level != field.storage.sparse.back().level)
    return run.fail(op, "the field is not directly below a 'dynamic' level");
  SmallVector<int64_t> given = run.getIndices(append.getIndices());
  given.insert(given.begin() + dimension, field.layout.offset[dimension]);
  SmallVector<int64_t> indices = given;
  if (failed(checkIndices(run, op, field, indices)))
    return failure();
  int64_t number = getCell(field, list->level, indices) /
                   field.nodes[list->node].type.getNumCells();
  int64_t at = tai_rt_append(run.frame, run.getTree(field), list->node, number,
                             describePlace(op->getLoc()).c_str());
  // If the position is negative, tai_rt_append has failed the launch.
  if (at < 0)
    return failure();
  given[dimension] += at;
  bool exists;
  FailureOr<char *> place =
      locate(run, op, field, given, {}, /*activates=*/false, exists);
  if (failed(place))
    return failure();
  writeNumbers(run.get(append.getValue()).numbers, append.getValue().getType(),
               *place);
  run.set(append.getAt(), Datum(fromIndex(at)));
  return success();
}

/// Handles operations that need no action in an interpreter.
static LogicalResult runNothing(Run &run, Operation *op) { return success(); }

void interpreter::addMemoryHandlers(Handlers &handlers) {
  handlers["memref.alloc"] = runAlloc;
  handlers["memref.alloca"] = runAlloc;
  handlers["memref.atomic_rmw"] = runArrayAtomic;
  handlers["memref.dealloc"] = runNothing;
  handlers["memref.dim"] = runDim;
  handlers["memref.load"] = runArrayLoad;
  handlers["memref.store"] = runArrayStore;
  handlers["tai.activate"] = runActivate;
  handlers["tai.alloca"] = runAlloca;
  handlers["tai.append"] = runAppend;
  handlers["tai.atomic"] = runAtomic;
  handlers["tai.deactivate"] = runDeactivate;
  handlers["tai.is_active"] = runIsActive;
  handlers["tai.length"] = runLength;
  handlers["tai.load"] = runLoad;
  handlers["tai.local_load"] = runLocalLoad;
  handlers["tai.local_store"] = runLocalStore;
  handlers["tai.precondition"] = runNothing;
  handlers["tai.stack_create"] = runAlloca;
  handlers["tai.stack_destroy"] = runNothing;
  handlers["tai.stack_pop"] = runStackPop;
  handlers["tai.stack_push"] = runStackPush;
  handlers["tai.store"] = runStore;
  handlers["tai.visits_all"] = runVisitsAll;
}
