//===- TransposeColumns.cpp - Rows in the place of columns ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A layer of a small network multiplies a matrix by a vector, in a loop over
// rows that is unrolled along each row. Vectorised over rows, the loop gathers
// every column, and its adjoint scatters to every column of the gradient, one
// element at a time; per clock, a CPU loads two or three elements, and stores
// one. Adjacent pieces of rows are instead loaded or stored at once, and
// transposed in registers, with half a shuffle for each element.
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/Passes/TransposeColumns.h"
#include "llvm/Analysis/AliasAnalysis.h"
#include "llvm/Analysis/VectorUtils.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/IntrinsicInst.h"
#include "llvm/IR/PatternMatch.h"
#include <map>

using namespace llvm;
using namespace mlir::tai;

/// Returns, for a vector of integers or pointers, the difference between
/// consecutive lanes, if it is the same for all lanes.
static std::optional<int64_t> findStep(Value *value, const DataLayout &layout,
                                       unsigned depth = 0) {
  using namespace PatternMatch;
  if (!value->getType()->isVectorTy())
    return 0;
  if (getSplatValue(value))
    return 0;
  if (depth > 6)
    return std::nullopt;
  auto inner = [&](Value *operand) {
    return findStep(operand, layout, depth + 1);
  };
  auto both = [&](Value *a, Value *b) -> std::optional<int64_t> {
    std::optional<int64_t> first = inner(a), second = inner(b);
    return first && second ? std::optional(*first + *second) : std::nullopt;
  };
  if (auto *constant = dyn_cast<ConstantDataVector>(value)) {
    if (!constant->getElementType()->isIntegerTy(64))
      return std::nullopt;
    auto at = [&](unsigned i) {
      return constant->getElementAsAPInt(i).getSExtValue();
    };
    int64_t step = at(1) - at(0);
    for (unsigned i = 2; i < constant->getNumElements(); ++i)
      if (at(i) - at(i - 1) != step)
        return std::nullopt;
    return step;
  }
  Value *a = nullptr, *b = nullptr;
  const APInt *factor = nullptr;
  if (auto *phi = dyn_cast<PHINode>(value)) {
    // The lanes of a phi differ by as much as those of its start value, if the
    // loop adds the same number to all lanes.
    if (phi->getNumIncomingValues() != 2)
      return std::nullopt;
    for (unsigned i : {0u, 1u})
      if (match(phi->getIncomingValue(i), m_c_Add(m_Specific(phi), m_Value(a))))
        return inner(a) == 0 ? inner(phi->getIncomingValue(1 - i))
                             : std::nullopt;
    return std::nullopt;
  }
  if (!value->getType()->getScalarType()->isPointerTy() &&
      !value->getType()->getScalarType()->isIntegerTy(64))
    return std::nullopt;
  if (match(value, m_Add(m_Value(a), m_Value(b))) ||
      match(value, m_DisjointOr(m_Value(a), m_Value(b))))
    return both(a, b);
  std::optional<int64_t> step;
  if (match(value, m_Mul(m_Value(a), m_APInt(factor))) && (step = inner(a)) &&
      factor->isSignedIntN(31))
    return *step * factor->getSExtValue();
  if (match(value, m_Shl(m_Value(a), m_APInt(factor))) && (step = inner(a)) &&
      factor->ult(31))
    return *step * (int64_t(1) << factor->getZExtValue());
  if (auto *address = dyn_cast<GetElementPtrInst>(value)) {
    if (address->getNumIndices() != 1 ||
        !address->getOperand(1)->getType()->getScalarType()->isIntegerTy(64))
      return std::nullopt;
    std::optional<int64_t> base = inner(address->getPointerOperand());
    step = inner(address->getOperand(1));
    if (!base || !step)
      return std::nullopt;
    auto size = static_cast<int64_t>(
        layout.getTypeAllocSize(address->getSourceElementType()));
    return *base + *step * size;
  }
  return std::nullopt;
}

namespace {
/// The addresses at which the rows of a matrix start: the lanes of a vector of
/// pointers; or one pointer plus `scale` times the lanes of a vector of
/// indices; or the lanes of a vector of pointers plus `scale` times one index.
struct Rows {
  Value *pointer = nullptr;
  Value *index = nullptr;
  int64_t scale = 0;

  Value *getLanes() const {
    return pointer->getType()->isVectorTy() ? pointer : index;
  }
  /// Returns the distance in bytes between the starts of consecutive rows of a
  /// matrix, if it is the same for all rows.
  std::optional<int64_t> findStep(const DataLayout &layout) const {
    Value *lanes = getLanes();
    std::optional<int64_t> step = ::findStep(lanes, layout);
    if (step && lanes == index)
      *step *= scale;
    return step;
  }

  bool operator==(const Rows &other) const {
    return pointer == other.pointer && index == other.index &&
           scale == other.scale;
  }
  bool operator<(const Rows &other) const {
    return std::tie(pointer, index, scale) <
           std::tie(other.pointer, other.index, other.scale);
  }
};

/// The bytes that an access touches in each row of a matrix: `bytes` bytes,
/// starting `offset` bytes after the start of the row.
struct Columns {
  Rows rows;
  int64_t offset, bytes;
};

/// A gather from a single column, or a scatter to a single column.
struct Column {
  CallBase *call;
  int64_t offset;
};

class Transposer {
public:
  Transposer(BasicBlock &block, AAResults &aliases)
      : block(block), aliases(aliases), layout(block.getDataLayout()) {}

  bool run() {
    bool changed = replaceAll(Intrinsic::masked_gather);
    changed |= replaceAll(Intrinsic::masked_scatter);
    return changed;
  }

private:
  /// Identifies a matrix by its rows and by the vector type of a column.
  using Matrix = std::pair<Rows, FixedVectorType *>;

  bool replaceAll(Intrinsic::ID id);
  std::optional<Matrix> findColumn(CallBase &call, Column &column) const;
  void number();
  bool replace(const Matrix &matrix, ArrayRef<Column> run, bool stores);
  bool canMove(ArrayRef<Column> run, Instruction *to) const;
  bool mayAlias(const Columns &a, Instruction *first,
                Instruction *second) const;
  void emitLoads(const Matrix &matrix, ArrayRef<Column> run,
                 IRBuilder<> &builder, const AAMDNodes &nodes);
  void emitStores(const Matrix &matrix, ArrayRef<Column> run,
                  IRBuilder<> &builder, const AAMDNodes &nodes);
  Value *findRow(const Matrix &matrix, unsigned lane, int64_t offset,
                 IRBuilder<> &builder);

  BasicBlock &block;
  AAResults &aliases;
  const DataLayout &layout;
  /// All instructions of the block that access memory, in order; and for each,
  /// its position in this list.
  SmallVector<Instruction *> memory;
  DenseMap<Instruction *, size_t> places;
  /// For each gather or scatter, and for each row access that has replaced some
  /// of them: the columns that it accesses.
  DenseMap<Instruction *, Columns> known;
  /// For each matrix: the distance in bytes between the starts of consecutive
  /// rows, if it is constant.
  std::map<Rows, std::optional<int64_t>> steps;
  /// For each matrix, the value that is the address of its first row.
  std::map<Rows, Value *> firstRows;
};
} // namespace

/// The number of elements in 16 bytes, within which a CPU shuffles fast.
static unsigned getChunk(FixedVectorType *type) {
  unsigned bits = type->getScalarSizeInBits();
  unsigned chunk = bits == 32 || bits == 64 ? 128 / bits : 0;
  unsigned lanes = type->getNumElements();
  return chunk && lanes % chunk == 0 && lanes <= 4 * chunk ? chunk : 0;
}

static int64_t getElementBytes(FixedVectorType *type) {
  return type->getScalarSizeInBits() / 8;
}

std::optional<Transposer::Matrix> Transposer::findColumn(CallBase &call,
                                                         Column &column) const {
  bool stores = call.getIntrinsicID() == Intrinsic::masked_scatter;
  auto *type = dyn_cast<FixedVectorType>(
      stores ? call.getArgOperand(0)->getType() : call.getType());
  auto *mask = dyn_cast<Constant>(call.getArgOperand(stores ? 2 : 1));
  if (!type || !mask || !mask->isAllOnesValue() || !getChunk(type))
    return std::nullopt;
  // Terms of the address that are equal in all lanes are added to the offset.
  auto sizeOf = [&](GetElementPtrInst *address) {
    return static_cast<int64_t>(
        layout.getTypeAllocSize(address->getSourceElementType()));
  };
  Rows rows{call.getArgOperand(stores ? 1 : 0)};
  int64_t offset = 0;
  while (auto *address = dyn_cast<GetElementPtrInst>(rows.pointer)) {
    if (address->getNumIndices() != 1)
      break;
    Value *index = address->getOperand(1);
    Value *splat =
        index->getType()->isVectorTy() ? getSplatValue(index) : index;
    if (auto *constant = dyn_cast_or_null<ConstantInt>(splat)) {
      offset += constant->getSExtValue() * sizeOf(address);
      rows.pointer = address->getPointerOperand();
      continue;
    }
    // Vectors of pointers with vectors of indices are not supported as rows.
    bool hasPointers = address->getPointerOperand()->getType()->isVectorTy();
    if ((hasPointers && !splat) ||
        !index->getType()->getScalarType()->isIntegerTy(64))
      break;
    rows = {address->getPointerOperand(), hasPointers ? splat : index,
            sizeOf(address)};
    Value *rest = nullptr;
    const APInt *added = nullptr;
    using namespace PatternMatch;
    while (match(rows.index, m_Add(m_Value(rest), m_APInt(added))) ||
           match(rows.index, m_DisjointOr(m_Value(rest), m_APInt(added)))) {
      offset += added->getSExtValue() * rows.scale;
      rows.index = rest;
    }
    break;
  }
  column = {&call, offset};
  return Matrix{rows, type};
}

void Transposer::number() {
  memory.clear();
  places.clear();
  for (Instruction &instruction : block)
    if (instruction.mayReadOrWriteMemory()) {
      places[&instruction] = memory.size();
      memory.push_back(&instruction);
    }
}

/// True if two memory accesses possibly conflict, that is, touch the same
/// memory while one of them writes. The first access is to `columns`.
bool Transposer::mayAlias(const Columns &columns, Instruction *first,
                          Instruction *second) const {
  if (!first->mayWriteToMemory() && !second->mayWriteToMemory())
    return false;
  auto other = known.find(second);
  if (other != known.end() && other->second.rows == columns.rows) {
    // Two accesses to columns do not conflict if their bytes are disjoint in
    // every row, and no row overlaps the next row.
    const Columns &there = other->second;
    std::optional<int64_t> step = steps.find(columns.rows)->second;
    int64_t begin = std::min(columns.offset, there.offset);
    int64_t end =
        std::max(columns.offset + columns.bytes, there.offset + there.bytes);
    if (step && end - begin <= std::abs(*step) &&
        (columns.offset + columns.bytes <= there.offset ||
         there.offset + there.bytes <= columns.offset))
      return false;
  }
  auto *call = dyn_cast<CallBase>(first);
  return !call || isModOrRefSet(aliases.getModRefInfo(second, call));
}

/// True if the accesses of a run of neighbouring columns can all be moved to
/// the place of one of them, `to`.
bool Transposer::canMove(ArrayRef<Column> run, Instruction *to) const {
  for (const Column &column : run) {
    size_t from = places.lookup(column.call), end = places.lookup(to);
    const Columns &columns = known.find(column.call)->second;
    for (size_t i = std::min(from, end) + 1; i < std::max(from, end); ++i)
      if (mayAlias(columns, column.call, memory[i]))
        return false;
  }
  return true;
}

Value *Transposer::findRow(const Matrix &matrix, unsigned lane, int64_t offset,
                           IRBuilder<> &builder) {
  const Rows &rows = matrix.first;
  auto emitLane = [&](Value *value, unsigned lane) -> Value * {
    if (!value->getType()->isVectorTy())
      return value;
    // If the vector was built from scalars, the scalar itself is used.
    Value *scalar = findScalarElement(value, lane);
    return scalar ? scalar
                  : builder.CreateExtractElement(value, uint64_t(lane));
  };
  auto emitStart = [&](unsigned lane) {
    Value *pointer = emitLane(rows.pointer, lane);
    if (!rows.index)
      return pointer;
    Value *index = emitLane(rows.index, lane);
    return builder.CreatePtrAdd(
        pointer, builder.CreateMul(index, builder.getInt64(rows.scale)));
  };
  std::optional<int64_t> step = steps.find(rows)->second;
  Value *row = nullptr;
  if (step) {
    offset += *step * lane;
    Value *&first = firstRows[rows];
    if (!first) {
      IRBuilder<>::InsertPointGuard guard(builder);
      SmallVector<Instruction *> here;
      for (Value *value : {rows.pointer, rows.index})
        if (auto *made = dyn_cast_or_null<Instruction>(value);
            made && made->getParent() == &block)
          here.push_back(made);
      // The address of the first row is computed as early as possible, because
      // accesses to other columns of the matrix use it too.
      if (here.size() > 1)
        return builder.CreatePtrAdd(emitStart(lane),
                                    builder.getInt64(offset - *step * lane));
      if (here.empty())
        builder.SetInsertPoint(&block, block.getFirstInsertionPt());
      else
        builder.SetInsertPoint(*here.front()->getInsertionPointAfterDef());
      first = emitStart(0);
    }
    row = first;
  } else {
    row = emitStart(lane);
  }
  return builder.CreatePtrAdd(row, builder.getInt64(offset));
}

/// Transposes `chunk` vectors: in each group of 16 bytes, the `chunk` by
/// `chunk` elements of the vectors are a square that is transposed.
static SmallVector<Value *> transpose(IRBuilder<> &builder,
                                      ArrayRef<Value *> vectors) {
  auto *type = cast<FixedVectorType>(vectors.front()->getType());
  unsigned chunk = getChunk(type), lanes = type->getNumElements();
  auto shuffle = [&](Value *a, Value *b, ArrayRef<unsigned> pattern) {
    SmallVector<int> mask;
    for (unsigned from = 0; from < lanes; from += chunk)
      for (unsigned at : pattern)
        mask.push_back(static_cast<int>(
            at < chunk ? from + at : lanes + from + at - chunk));
    return builder.CreateShuffleVector(a, b, mask);
  };
  if (chunk == 2)
    return {shuffle(vectors[0], vectors[1], {0, 2}),
            shuffle(vectors[0], vectors[1], {1, 3})};
  Value *low01 = shuffle(vectors[0], vectors[1], {0, 4, 1, 5});
  Value *high01 = shuffle(vectors[0], vectors[1], {2, 6, 3, 7});
  Value *low23 = shuffle(vectors[2], vectors[3], {0, 4, 1, 5});
  Value *high23 = shuffle(vectors[2], vectors[3], {2, 6, 3, 7});
  return {shuffle(low01, low23, {0, 1, 4, 5}),
          shuffle(low01, low23, {2, 3, 6, 7}),
          shuffle(high01, high23, {0, 1, 4, 5}),
          shuffle(high01, high23, {2, 3, 6, 7})};
}

void Transposer::emitLoads(const Matrix &matrix, ArrayRef<Column> run,
                           IRBuilder<> &builder, const AAMDNodes &nodes) {
  FixedVectorType *type = matrix.second;
  unsigned chunk = getChunk(type), lanes = type->getNumElements();
  auto *rowType = FixedVectorType::get(type->getElementType(), chunk);
  Align alignment = run.front().call->getParamAlign(0).valueOrOne();
  // Vector number k holds pieces of the rows k, k + chunk, ...; each piece has
  // 16 bytes.
  SmallVector<Value *> vectors;
  for (unsigned k = 0; k < chunk; ++k) {
    SmallVector<Value *> rows;
    for (unsigned lane = k; lane < lanes; lane += chunk) {
      LoadInst *row = builder.CreateAlignedLoad(
          rowType, findRow(matrix, lane, run.front().offset, builder),
          alignment);
      row->setAAMetadata(nodes);
      known[row] = {matrix.first, run.front().offset, 16};
      rows.push_back(row);
    }
    vectors.push_back(rows.size() == 1 ? rows.front()
                                       : concatenateVectors(builder, rows));
  }
  for (auto [column, result] : zip(run, transpose(builder, vectors)))
    column.call->replaceAllUsesWith(result);
}

void Transposer::emitStores(const Matrix &matrix, ArrayRef<Column> run,
                            IRBuilder<> &builder, const AAMDNodes &nodes) {
  FixedVectorType *type = matrix.second;
  unsigned chunk = getChunk(type), lanes = type->getNumElements();
  Align alignment = run.front().call->getParamAlign(1).valueOrOne();
  SmallVector<Value *> vectors;
  for (const Column &column : run)
    vectors.push_back(column.call->getArgOperand(0));
  vectors = transpose(builder, vectors);
  for (unsigned lane = 0; lane < lanes; ++lane) {
    SmallVector<int> mask;
    for (unsigned i = 0; i < chunk; ++i)
      mask.push_back(static_cast<int>(lane / chunk * chunk + i));
    Value *row = vectors[lane % chunk];
    if (lanes > chunk)
      row = builder.CreateShuffleVector(row, mask);
    StoreInst *store = builder.CreateAlignedStore(
        row, findRow(matrix, lane, run.front().offset, builder), alignment);
    store->setAAMetadata(nodes);
    known[store] = {matrix.first, run.front().offset, 16};
  }
}

bool Transposer::replace(const Matrix &matrix, ArrayRef<Column> run,
                         bool stores) {
  // Loads are emitted at the first gather, where all addresses are available,
  // and stores at the last scatter, where all stored values are.
  auto isBefore = [&](const Column &a, const Column &b) {
    return places.lookup(a.call) < places.lookup(b.call);
  };
  CallBase *to = stores ? llvm::max_element(run, isBefore)->call
                        : llvm::min_element(run, isBefore)->call;
  if (!canMove(run, to))
    return false;
  // The row accesses cover the memory of all the columns, so the metadata of
  // the column accesses are merged.
  AAMDNodes nodes = run.front().call->getAAMetadata();
  for (const Column &column : run)
    nodes = nodes.merge(column.call->getAAMetadata());
  IRBuilder<> builder(to);
  if (stores)
    emitStores(matrix, run, builder, nodes);
  else
    emitLoads(matrix, run, builder, nodes);
  for (const Column &column : run) {
    known.erase(column.call);
    column.call->eraseFromParent();
  }
  return true;
}

bool Transposer::replaceAll(Intrinsic::ID id) {
  bool stores = id == Intrinsic::masked_scatter;
  // The matrices are ordered by their first access in the block, so that the
  // generated code does not depend on the values of pointers.
  SmallVector<std::pair<Matrix, SmallVector<Column>>> matrices;
  auto find = [&](const Matrix &matrix) -> SmallVector<Column> & {
    for (auto &[known, columns] : matrices)
      if (known == matrix)
        return columns;
    matrices.push_back({matrix, {}});
    return matrices.back().second;
  };
  for (Instruction &instruction : block) {
    auto *call = dyn_cast<IntrinsicInst>(&instruction);
    bool gathers = call && call->getIntrinsicID() == Intrinsic::masked_gather;
    bool scatters = call && call->getIntrinsicID() == Intrinsic::masked_scatter;
    Column column;
    std::optional<Matrix> matrix;
    if ((gathers || scatters) && (matrix = findColumn(*call, column))) {
      known[call] = {matrix->first, column.offset,
                     getElementBytes(matrix->second)};
      const Rows &rows = matrix->first;
      steps[rows] = rows.findStep(layout);
      if (stores ? scatters : gathers)
        find(*matrix).push_back(column);
    }
  }
  if (matrices.empty())
    return false;
  number();
  // Blocks with very many memory accesses are left as they are, because the
  // time of the steps below grows with the square of their number.
  constexpr size_t most = 8000;
  if (memory.size() > most)
    return false;
  bool changed = false;
  for (auto &[matrix, columns] : matrices) {
    unsigned chunk = getChunk(matrix.second);
    int64_t bytes = getElementBytes(matrix.second);
    // If rows overlap, scatters must store their lanes in order, and are left
    // alone.
    std::optional<int64_t> step = steps.find(matrix.first)->second;
    if (stores && (!step || std::abs(*step) < 16))
      continue;
    llvm::sort(columns, [&](const Column &a, const Column &b) {
      return std::pair(a.offset, places.lookup(a.call)) <
             std::pair(b.offset, places.lookup(b.call));
    });
    // A column may be accessed several times, with writes in between. The first
    // accesses of neighbouring columns are combined, then the second accesses,
    // and so on.
    SmallVector<SmallVector<Column>> layers;
    size_t times = 0;
    for (size_t i = 0; i < columns.size(); ++i) {
      times = i && columns[i].offset == columns[i - 1].offset ? times + 1 : 0;
      if (times == layers.size())
        layers.emplace_back();
      layers[times].push_back(columns[i]);
    }
    for (ArrayRef<Column> layer : layers) {
      for (size_t i = 0; i + chunk <= layer.size();) {
        ArrayRef<Column> run = layer.slice(i, chunk);
        bool isRun = true;
        for (unsigned k = 1; k < chunk; ++k)
          isRun &= run[k].offset == run[k - 1].offset + bytes;
        if (isRun && replace(matrix, run, stores)) {
          changed = true;
          i += chunk;
          number();
        } else {
          ++i;
        }
      }
    }
  }
  return changed;
}

PreservedAnalyses TransposeColumns::run(Function &function,
                                        FunctionAnalysisManager &analyses) {
  bool changed = false;
  for (BasicBlock &block : function)
    changed |= Transposer(block, analyses.getResult<AAManager>(function)).run();
  if (!changed)
    return PreservedAnalyses::all();
  PreservedAnalyses preserved;
  preserved.preserveSet<CFGAnalyses>();
  return preserved;
}
