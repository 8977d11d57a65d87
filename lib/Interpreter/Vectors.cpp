//===- Vectors.cpp - Numbers, vectors and small matrices ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Components are stored row-major. Sums run over them in that order.
//
//===----------------------------------------------------------------------===//

#include "Decompositions.h"
#include "Handlers.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;
using llvm::APFloat;
using llvm::APInt;

static int64_t getRows(Value matrix) {
  return cast<VectorType>(matrix.getType()).getDimSize(0);
}
static int64_t getColumns(Value matrix) {
  auto type = cast<VectorType>(matrix.getType());
  return type.getRank() == 2 ? type.getDimSize(1) : 1;
}
static int64_t getCount(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector ? vector.getNumElements() : 1;
}

//===----------------------------------------------------------------------===//
// Components
//===----------------------------------------------------------------------===//

static LogicalResult runConstant(Run &run, Operation *op) {
  Attribute value = cast<arith::ConstantOp>(op).getValue();
  Datum datum;
  if (auto elements = dyn_cast<DenseElementsAttr>(value)) {
    for (Attribute element : elements.getValues<Attribute>())
      datum.numbers.push_back(interpreter::getNumber(element));
  } else {
    datum.numbers.push_back(interpreter::getNumber(value));
  }
  run.set(op->getResult(0), std::move(datum));
  return success();
}

static const Undefined *findUndefined(const Datum &datum, size_t i) {
  if (!datum.undefined)
    return nullptr;
  auto found = datum.undefined->find(i);
  return found == datum.undefined->end() ? nullptr : &found->second;
}

static void setUndefined(Run &run, Datum &datum, size_t i, Undefined why) {
  run.hasUndefined = true;
  if (!datum.undefined)
    datum.undefined = std::make_shared<std::map<size_t, Undefined>>();
  datum.undefined->emplace(i, std::move(why));
}

/// True if a select may discard the result of the operation.
static bool mayBeLeftAside(Run &run, Operation *op) {
  return !op->use_empty() && llvm::all_of(op->getUsers(), [&](Operation *user) {
    return isa<arith::SelectOp>(user) || run.program.getScalarFunction(user);
  });
}

LogicalResult interpreter::runScalars(Run &run, Operation *op) {
  ScalarFunction function = run.program.getScalarFunction(op);
  Type type = op->getResult(0).getType();
  Datum result;
  for (int64_t i = 0; i != getCount(type); ++i) {
    SmallVector<Number, 3> operands;
    const Undefined *undefined = nullptr;
    for (Value operand : op->getOperands()) {
      const Datum &datum = run.get(operand);
      operands.push_back(datum.numbers[i]);
      undefined = undefined ? undefined : findUndefined(datum, i);
    }
    if (undefined) {
      setUndefined(run, result, i, *undefined);
      result.numbers.push_back(getZero(getElementTypeOrSelf(type)));
      continue;
    }
    Outcome outcome = function(op, operands, getElementTypeOrSelf(type));
    if (!outcome.number) {
      if (!mayBeLeftAside(run, op))
        return run.fail(op, outcome.problem);
      setUndefined(run, result, i, {op, outcome.problem});
      outcome.number = getZero(getElementTypeOrSelf(type));
    }
    if (outcome.isTolerated && run.program.getOptions().debug)
      run.report(op, outcome.problem, {}, TAI_FAIL_ASSERT);
    result.numbers.push_back(std::move(*outcome.number));
  }
  run.set(op->getResult(0), std::move(result));
  return success();
}

static LogicalResult runSinCos(Run &run, Operation *op) {
  Datum sine, cosine;
  Type type = getElementTypeOrSelf(op->getOperand(0).getType());
  for (const Number &number : run.get(op->getOperand(0)).numbers) {
    long double x = toDouble(number);
    sine.numbers.push_back(fromDouble(std::sin(x), type));
    cosine.numbers.push_back(fromDouble(std::cos(x), type));
  }
  run.set(op->getResult(0), std::move(sine));
  run.set(op->getResult(1), std::move(cosine));
  return success();
}

static LogicalResult runSelect(Run &run, Operation *op) {
  auto select = cast<arith::SelectOp>(op);
  const Datum &condition = run.get(select.getCondition());
  if (condition.undefined) {
    const Undefined &first = condition.undefined->begin()->second;
    return run.fail(first.op, first.problem);
  }
  const Datum &ifTrue = run.get(select.getTrueValue());
  const Datum &ifFalse = run.get(select.getFalseValue());
  Datum result;
  if (condition.numbers.size() == 1) {
    // A scalar condition selects all components, or a handle such as an array.
    result = isTrue(condition.numbers.front()) ? ifTrue : ifFalse;
  } else {
    for (auto [i, holds] : llvm::enumerate(condition.numbers)) {
      const Datum &chosen = isTrue(holds) ? ifTrue : ifFalse;
      result.numbers.push_back(chosen.numbers[i]);
      if (const Undefined *undefined = findUndefined(chosen, i))
        setUndefined(run, result, i, *undefined);
    }
  }
  run.set(select, std::move(result));
  return success();
}

static LogicalResult runForward(Run &run, Operation *op) {
  run.set(op->getResult(0), run.get(op->getOperand(0)));
  return success();
}

static LogicalResult runBroadcast(Run &run, Operation *op) {
  auto broadcast = cast<vector::BroadcastOp>(op);
  const Numbers &source = run.get(broadcast.getSource()).numbers;
  VectorType type = broadcast.getResultVectorType();
  auto from = dyn_cast<VectorType>(broadcast.getSourceType());
  ArrayRef<int64_t> shape = from ? from.getShape() : ArrayRef<int64_t>();
  Datum result;
  for (int64_t i = 0; i != type.getNumElements(); ++i) {
    // A broadcast matches dimensions from the right, and repeats dimensions of
    // extent 1.
    int64_t rest = i, at = 0, weight = 1;
    for (size_t d = 0; d != shape.size(); ++d) {
      int64_t extent = type.getShape()[type.getRank() - 1 - d];
      int64_t own = shape[shape.size() - 1 - d];
      at += (own == 1 ? 0 : rest % extent) * weight;
      rest /= extent;
      weight *= own;
    }
    result.numbers.push_back(source[at]);
  }
  run.set(broadcast, std::move(result));
  return success();
}

/// Returns the offset at which the part of a vector at `position` begins; -1 if
/// the position is out of range.
static int64_t getOffset(VectorType type, ArrayRef<int64_t> position) {
  int64_t offset = 0;
  for (auto [i, extent] : llvm::enumerate(type.getShape())) {
    int64_t at = i < position.size() ? position[i] : 0;
    if (at < 0 || at >= extent)
      return -1;
    offset = offset * extent + at;
  }
  return offset;
}

/// Returns the position of an extract or insert; `evaluate` returns the value
/// of a dynamic index.
template <typename Op>
static SmallVector<int64_t> getPosition(Op op,
                                        function_ref<int64_t(Value)> evaluate) {
  SmallVector<int64_t> position;
  for (OpFoldResult at : op.getMixedPosition())
    position.push_back(isa<Attribute>(at)
                           ? cast<IntegerAttr>(cast<Attribute>(at)).getInt()
                           : evaluate(cast<Value>(at)));
  return position;
}

static LogicalResult runExtract(Run &run, Operation *op) {
  auto extract = cast<vector::ExtractOp>(op);
  SmallVector<int64_t> position = getPosition(
      extract, [&](Value at) { return toIndex(run.getNumber(at)); });
  int64_t offset = getOffset(extract.getSourceVectorType(), position);
  if (llvm::is_contained(extract.getStaticPosition(),
                         vector::ExtractOp::kPoisonIndex)) {
    Datum poison;
    for (int64_t i = 0; i != getCount(extract.getType()); ++i) {
      poison.numbers.push_back(
          getZero(getElementTypeOrSelf(extract.getType())));
      setUndefined(run, poison, i, {op, "the position -1 is poison"});
    }
    run.set(extract, std::move(poison));
    return success();
  }
  if (offset < 0)
    return run.fail(op, "the vector has no such component", TAI_FAIL_INDEX);
  const Numbers &source = run.get(extract.getSource()).numbers;
  Datum result;
  for (int64_t i = 0; i != getCount(extract.getType()); ++i)
    result.numbers.push_back(source[offset + i]);
  run.set(extract, std::move(result));
  return success();
}

static LogicalResult runInsert(Run &run, Operation *op) {
  auto insert = cast<vector::InsertOp>(op);
  SmallVector<int64_t> position =
      getPosition(insert, [&](Value at) { return toIndex(run.getNumber(at)); });
  int64_t offset = getOffset(insert.getDestVectorType(), position);
  if (offset < 0)
    return run.fail(op, "the vector has no such component", TAI_FAIL_INDEX);
  Datum result = run.get(insert.getDest());
  for (auto [i, number] :
       llvm::enumerate(run.get(insert.getValueToStore()).numbers))
    result.numbers[offset + i] = number;
  run.set(insert, std::move(result));
  return success();
}

static LogicalResult runFromElements(Run &run, Operation *op) {
  Datum result;
  for (Value element : op->getOperands())
    result.numbers.push_back(run.getNumber(element));
  run.set(op->getResult(0), std::move(result));
  return success();
}

static LogicalResult runToElements(Run &run, Operation *op) {
  Numbers source = run.get(op->getOperand(0)).numbers;
  for (auto [result, number] : llvm::zip_equal(op->getResults(), source))
    run.set(result, Datum(number));
  return success();
}

/// Interprets a shuffle: selects rows (leading slices) of two vectors by their
/// numbers in the concatenation of both.
static LogicalResult runShuffle(Run &run, Operation *op) {
  auto shuffle = cast<vector::ShuffleOp>(op);
  Numbers both = run.get(shuffle.getV1()).numbers;
  llvm::append_range(both, Numbers(run.get(shuffle.getV2()).numbers));
  VectorType type = shuffle.getResultVectorType();
  int64_t size =
      type.getRank() == 0 ? 1 : type.getNumElements() / type.getDimSize(0);
  Datum result;
  for (int64_t row : shuffle.getMask())
    for (int64_t i = 0; i != size; ++i) {
      // An index of -1 in the shuffle's mask means that the row of the result
      // is undefined.
      if (row < 0)
        return run.fail(op, "the mask leaves a component undefined");
      result.numbers.push_back(both[row * size + i]);
    }
  run.set(shuffle, std::move(result));
  return success();
}

static LogicalResult runReduction(Run &run, Operation *op) {
  auto reduction = cast<vector::ReductionOp>(op);
  using Kind = vector::CombiningKind;
  auto combineTwo = [&](const Number &a, const Number &b) -> Number {
    auto real = [](const Number &n) { return std::get<APFloat>(n); };
    auto whole = [](const Number &n) { return std::get<APInt>(n); };
    switch (reduction.getKind()) {
    case Kind::ADD:
      return add(a, b);
    case Kind::MUL:
      return multiply(a, b);
    case Kind::AND:
      return whole(a) & whole(b);
    case Kind::OR:
      return whole(a) | whole(b);
    case Kind::XOR:
      return whole(a) ^ whole(b);
    case Kind::MINSI:
      return llvm::APIntOps::smin(whole(a), whole(b));
    case Kind::MAXSI:
      return llvm::APIntOps::smax(whole(a), whole(b));
    case Kind::MINUI:
      return llvm::APIntOps::umin(whole(a), whole(b));
    case Kind::MAXUI:
      return llvm::APIntOps::umax(whole(a), whole(b));
    case Kind::MINIMUMF:
      return llvm::minimum(real(a), real(b));
    case Kind::MAXIMUMF:
      return llvm::maximum(real(a), real(b));
    case Kind::MINNUMF:
      return llvm::minnum(real(a), real(b));
    case Kind::MAXNUMF:
      return llvm::maxnum(real(a), real(b));
    }
    llvm_unreachable("unknown kind");
  };
  std::optional<Number> total;
  if (reduction.getAcc())
    total = run.getNumber(reduction.getAcc());
  for (const Number &number : run.get(reduction.getVector()).numbers)
    total = total ? combineTwo(*total, number) : number;
  run.set(reduction, Datum(*total));
  return success();
}

//===----------------------------------------------------------------------===//
// Matrices
//===----------------------------------------------------------------------===//

/// Returns the sum of n products, added in their order.
static Number
sumProducts(int64_t n, function_ref<std::pair<Number, Number>(int64_t)> get) {
  std::optional<Number> sum;
  for (int64_t i = 0; i != n; ++i) {
    auto [a, b] = get(i);
    Number product = multiply(a, b);
    sum = sum ? add(*sum, product) : product;
  }
  return *sum;
}

static LogicalResult runMatmul(Run &run, Operation *op) {
  auto matmul = cast<MatmulOp>(op);
  const Numbers &a = run.get(matmul.getLhs()).numbers;
  const Numbers &b = run.get(matmul.getRhs()).numbers;
  int64_t rows = getRows(matmul.getLhs()), inner = getColumns(matmul.getLhs());
  int64_t columns = getColumns(matmul.getRhs());
  Datum result;
  for (int64_t i = 0; i != rows; ++i)
    for (int64_t j = 0; j != columns; ++j)
      result.numbers.push_back(sumProducts(inner, [&](int64_t l) {
        return std::pair(a[i * inner + l], b[l * columns + j]);
      }));
  run.set(matmul.getResult(), std::move(result));
  return success();
}

static LogicalResult runTranspose(Run &run, Operation *op) {
  auto transpose = cast<TransposeOp>(op);
  const Numbers &from = run.get(transpose.getMatrix()).numbers;
  int64_t rows = getRows(transpose.getMatrix());
  int64_t columns = getColumns(transpose.getMatrix());
  Datum result;
  for (int64_t j = 0; j != columns; ++j)
    for (int64_t i = 0; i != rows; ++i)
      result.numbers.push_back(from[i * columns + j]);
  run.set(transpose.getResult(), std::move(result));
  return success();
}

static LogicalResult runDot(Run &run, Operation *op) {
  const Numbers &a = run.get(op->getOperand(0)).numbers;
  const Numbers &b = run.get(op->getOperand(1)).numbers;
  run.set(op->getResult(0), Datum(sumProducts(a.size(), [&](int64_t i) {
            return std::pair(a[i], b[i]);
          })));
  return success();
}

static LogicalResult runSum(Run &run, Operation *op) {
  const Numbers &a = run.get(op->getOperand(0)).numbers;
  Number sum = a.front();
  for (const Number &number : llvm::drop_begin(a))
    sum = add(sum, number);
  run.set(op->getResult(0), Datum(sum));
  return success();
}

static LogicalResult runCross(Run &run, Operation *op) {
  const Numbers &a = run.get(op->getOperand(0)).numbers;
  const Numbers &b = run.get(op->getOperand(1)).numbers;
  Datum result;
  for (int i = 0; i != 3; ++i) {
    int j = (i + 1) % 3, k = (i + 2) % 3;
    result.numbers.push_back(
        subtract(multiply(a[j], b[k]), multiply(a[k], b[j])));
  }
  run.set(op->getResult(0), std::move(result));
  return success();
}

static LogicalResult runOuter(Run &run, Operation *op) {
  Datum result;
  for (const Number &a : run.get(op->getOperand(0)).numbers)
    for (const Number &b : run.get(op->getOperand(1)).numbers)
      result.numbers.push_back(multiply(a, b));
  run.set(op->getResult(0), std::move(result));
  return success();
}

static LogicalResult runTrace(Run &run, Operation *op) {
  const Numbers &a = run.get(op->getOperand(0)).numbers;
  int64_t n = getRows(op->getOperand(0));
  Number sum = a.front();
  for (int64_t i = 1; i != n; ++i)
    sum = add(sum, a[i * n + i]);
  run.set(op->getResult(0), Datum(sum));
  return success();
}

// The algorithms below compute in long double and round once: the result is the
// nearest number, except for the last place of f64.

static SmallVector<long double> widen(const Numbers &numbers) {
  SmallVector<long double> result;
  for (const Number &number : numbers)
    result.push_back(toDouble(number));
  return result;
}

static Datum narrow(ArrayRef<long double> numbers, Type type) {
  Datum result;
  for (long double number : numbers)
    result.numbers.push_back(fromDouble(number, getElementTypeOrSelf(type)));
  return result;
}

static LogicalResult runNorm(Run &run, Operation *op) {
  auto norm = cast<NormOp>(op);
  // The sum of squares of f64 is in the range of long double. With `fast`,
  // squares are rounded to the type of the vector.
  long double sum = 0;
  for (long double a : widen(run.get(norm.getVector()).numbers))
    sum += a * a;
  if (norm.getFast()) {
    const Numbers &a = run.get(norm.getVector()).numbers;
    sum = toDouble(sumProducts(
        a.size(), [&](int64_t i) { return std::pair(a[i], a[i]); }));
  }
  run.set(norm.getResult(),
          narrow({std::sqrt(sum)}, norm.getResult().getType()));
  return success();
}

static LogicalResult runDeterminant(Run &run, Operation *op) {
  Value matrix = op->getOperand(0);
  run.set(op->getResult(0),
          narrow({determinant(widen(run.get(matrix).numbers), getRows(matrix))},
                 op->getResult(0).getType()));
  return success();
}

static LogicalResult runInverse(Run &run, Operation *op) {
  Value matrix = op->getOperand(0);
  int64_t n = getRows(matrix);
  SmallVector<long double> a = widen(run.get(matrix).numbers), result;
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = 0; j != n; ++j)
      result.push_back(cofactor(a, n, j, i) / determinant(a, n));
  run.set(op->getResult(0), narrow(result, op->getResult(0).getType()));
  return success();
}

static LogicalResult runSolve(Run &run, Operation *op) {
  auto solve = cast<SolveOp>(op);
  int64_t n = getRows(solve.getMatrix());
  SmallVector<long double> a = widen(run.get(solve.getMatrix()).numbers);
  SmallVector<long double> b = widen(run.get(solve.getRhs()).numbers), result;
  // Cramer's rule.
  for (int64_t k = 0; k != n; ++k) {
    SmallVector<long double> replaced = a;
    for (int64_t i = 0; i != n; ++i)
      replaced[i * n + k] = b[i];
    result.push_back(determinant(replaced, n) / determinant(a, n));
  }
  run.set(solve.getResult(), narrow(result, solve.getResult().getType()));
  return success();
}

static LogicalResult runPolar(Run &run, Operation *op) {
  auto polar = cast<PolarOp>(op);
  int64_t n = getRows(polar.getMatrix());
  // The factors of the polar decomposition follow from the singular values: A =
  // U Σ Vᵀ = (U Vᵀ) (V Σ Vᵀ).
  Decomposition parts =
      decomposeSingular(widen(run.get(polar.getMatrix()).numbers), n);
  SmallVector<long double> rotation(n * n), stretch(n * n);
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = 0; j != n; ++j)
      for (int64_t k = 0; k != n; ++k) {
        rotation[i * n + j] += parts.left[i * n + k] * parts.right[j * n + k];
        stretch[i * n + j] +=
            parts.right[i * n + k] * parts.values[k] * parts.right[j * n + k];
      }
  Type type = polar.getRotation().getType();
  run.set(polar.getRotation(), narrow(rotation, type));
  run.set(polar.getStretch(), narrow(stretch, type));
  return success();
}

static LogicalResult runSvd(Run &run, Operation *op) {
  auto svd = cast<SvdOp>(op);
  int64_t n = getRows(svd.getMatrix());
  Decomposition parts =
      decomposeSingular(widen(run.get(svd.getMatrix()).numbers), n);
  SmallVector<long double> sigma(n * n);
  for (int64_t i = 0; i != n; ++i)
    sigma[i * n + i] = parts.values[i];
  Type type = svd.getU().getType();
  run.set(svd.getU(), narrow(parts.left, type));
  run.set(svd.getSigma(), narrow(sigma, type));
  run.set(svd.getV(), narrow(parts.right, type));
  return success();
}

static LogicalResult runSymEig(Run &run, Operation *op) {
  auto eig = cast<SymEigOp>(op);
  int64_t n = getRows(eig.getMatrix());
  SmallVector<long double> a = widen(run.get(eig.getMatrix()).numbers);
  // Only the lower triangle of the symmetric matrix counts, and is copied to
  // the upper one.
  for (int64_t i = 0; i != n; ++i)
    for (int64_t j = i + 1; j != n; ++j)
      a[i * n + j] = a[j * n + i];
  Decomposition parts = decomposeSymmetric(a, n);
  run.set(eig.getValues(), narrow(parts.values, eig.getValues().getType()));
  run.set(eig.getVectors(), narrow(parts.right, eig.getVectors().getType()));
  return success();
}

void interpreter::addVectorHandlers(Handlers &handlers) {
  handlers["arith.constant"] = runConstant;
  handlers["arith.select"] = runSelect;
  handlers["math.sincos"] = runSinCos;
  handlers["tai.cross"] = runCross;
  handlers["tai.derive_as"] = runForward;
  handlers["tai.determinant"] = runDeterminant;
  handlers["tai.dot"] = runDot;
  handlers["tai.inverse"] = runInverse;
  handlers["tai.matmul"] = runMatmul;
  handlers["tai.norm"] = runNorm;
  handlers["tai.outer"] = runOuter;
  handlers["tai.polar"] = runPolar;
  handlers["tai.solve"] = runSolve;
  handlers["tai.stop_gradient"] = runForward;
  handlers["tai.sum"] = runSum;
  handlers["tai.svd"] = runSvd;
  handlers["tai.sym_eig"] = runSymEig;
  handlers["tai.trace"] = runTrace;
  handlers["tai.transpose"] = runTranspose;
  handlers["vector.broadcast"] = runBroadcast;
  handlers["vector.extract"] = runExtract;
  handlers["vector.from_elements"] = runFromElements;
  handlers["vector.insert"] = runInsert;
  handlers["vector.reduction"] = runReduction;
  handlers["vector.shape_cast"] = runForward;
  handlers["vector.shuffle"] = runShuffle;
  handlers["vector.to_elements"] = runToElements;
}
