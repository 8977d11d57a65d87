//===- SpectralForms.cpp - Matrix functions of an SVD ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// R = U M Vᵀ, with the factors of A = U Σ Vᵀ and a diagonal M. In the frame of
// the factors, with P = Uᵀ dA V and for i ≠ j,
//   (Uᵀ dR V)ᵢⱼ = Dᵢⱼ (Pᵢⱼ + Pⱼᵢ) / 2 + Tᵢⱼ (Pᵢⱼ - Pⱼᵢ) / 2,
//   Dᵢⱼ = (mⱼ - mᵢ) / (σⱼ - σᵢ),  Tᵢⱼ = (mⱼ + mᵢ) / (σⱼ + σᵢ),
// and dmᵢ on the diagonal. For a function M = f(Σ) both quotients have limits
// where the divisors vanish: the derivatives of the numerators by the divisors.
// If R were differentiated through U and V, whose rotation is proportional to 1
// / (σⱼ - σᵢ), D would be a difference of large numbers, and undefined at equal
// values.
//
// So R is differentiated by that form: linear in A and M, with U, V, D and T
// constant. The value of the form is meaningless. U, V, D and T are constant
// for this derivative only: in second derivatives they are differentiated as
// functions of A.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Prepare/SpectralForms.h"
#include "Slopes.h"
#include "mlir/IR/Iterators.h"
#include "mlir/IR/Matchers.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/AD/Rules/MatrixFormulas.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// A matrix in a product, or the transpose of one.
struct Factor {
  Value matrix;
  bool isTransposed;
};

/// A chain of matrix products, and the scalars that it is multiplied by. No
/// product is taken apart once there are 64 factors: a power computed by
/// repeated squaring would have too many.
struct Chain {
  SmallVector<Factor> factors;
  SmallVector<Value> scales;
};

/// The positions, in a chain of matrix products, of the two factors (U, V or
/// their transposes) of one decomposition.
struct Span {
  size_t first, last;
};

struct FormBuilder : DerivativeBuilder {
  using DerivativeBuilder::DerivativeBuilder;
  Value getPrimal(Value value) override { return value; }
};

class FormMaker {
public:
  explicit FormMaker(FunctionOpInterface function)
      : function(function), b(function) {}

  void make(MatmulOp product);

private:
  Value createCore(ArrayRef<Factor> factors, Value known);
  Value createMiddle(Operation *decomposition, ArrayRef<Factor> factors,
                     ArrayRef<Value> diagonal);
  S createQuotient(S numerator, S divisor, S slope, S noise, S floor);

  FunctionOpInterface function;
  FormBuilder b;
};
} // namespace

static Operation *getDecomposition(Value factor) {
  Operation *op = factor.getDefiningOp();
  if (auto svd = dyn_cast_if_present<SvdOp>(op))
    return factor == svd.getSigma() ? nullptr : op;
  if (auto eig = dyn_cast_if_present<SymEigOp>(op))
    return factor == eig.getVectors() ? op : nullptr;
  return nullptr;
}

/// Returns the scalar that all components of a vector equal, or null.
static Value getSplat(OpBuilder &builder, Value vector) {
  if (auto broadcast = vector.getDefiningOp<vector::BroadcastOp>())
    return isa<VectorType>(broadcast.getSourceType()) ? Value()
                                                      : broadcast.getSource();
  SplatElementsAttr splat;
  if (!matchPattern(vector, m_Constant(&splat)))
    return {};
  return arith::ConstantOp::create(builder, vector.getLoc(),
                                   splat.getSplatValue<TypedAttr>());
}

static void flatten(OpBuilder &builder, Value value, bool isTransposed,
                    Chain &chain) {
  Operation *op = value.getDefiningOp();
  constexpr size_t most = 64;
  if (auto product = dyn_cast_if_present<MatmulOp>(op);
      product && chain.factors.size() < most) {
    Value first = product.getLhs(), second = product.getRhs();
    if (isTransposed)
      std::swap(first, second);
    flatten(builder, first, isTransposed, chain);
    return flatten(builder, second, isTransposed, chain);
  }
  if (auto transpose = dyn_cast_if_present<TransposeOp>(op))
    return flatten(builder, transpose.getMatrix(), !isTransposed, chain);
  if (auto scaled = dyn_cast_if_present<arith::MulFOp>(op))
    for (auto [matrix, other] : {std::pair(scaled.getLhs(), scaled.getRhs()),
                                 std::pair(scaled.getRhs(), scaled.getLhs())})
      if (isa_and_present<MatmulOp, TransposeOp>(matrix.getDefiningOp()) ||
          getDecomposition(matrix))
        if (Value scale = getSplat(builder, other)) {
          chain.scales.push_back(scale);
          return flatten(builder, matrix, isTransposed, chain);
        }
  chain.factors.push_back({value, isTransposed});
}

namespace {
/// Answers whether square matrices are diagonal; each matrix is analyzed once.
class DiagonalMatrices {
public:
  bool contains(Value matrix) {
    constexpr size_t most = 64;
    if (auto it = known.find(matrix); it != known.end())
      return it->second;
    if (known.size() == most)
      return false;
    known[matrix] = false;
    return known[matrix] = find(matrix);
  }

private:
  bool find(Value matrix);

  DenseMap<Value, bool> known;
};
} // namespace

bool DiagonalMatrices::find(Value matrix) {
  auto type = dyn_cast<VectorType>(matrix.getType());
  Operation *op = matrix.getDefiningOp();
  if (!op || !type || type.getRank() != 2)
    return false;
  int64_t n = type.getDimSize(0);
  auto isOff = [&](int64_t i) { return i / n != i % n; };
  if (DenseFPElementsAttr constant;
      matchPattern(matrix, m_Constant(&constant))) {
    for (auto [i, entry] : llvm::enumerate(constant.getValues<APFloat>()))
      if (isOff(i) && !entry.isZero())
        return false;
    return true;
  }
  return llvm::TypeSwitch<Operation *, bool>(op)
      .Case([&](SvdOp svd) { return matrix == svd.getSigma(); })
      .Case([&](vector::FromElementsOp made) {
        for (auto [i, entry] : llvm::enumerate(made.getElements()))
          if (isOff(i) && !matchPattern(entry, m_AnyZeroFloat()))
            return false;
        return true;
      })
      .Case([&](vector::InsertOp insert) {
        ArrayRef<int64_t> at = insert.getStaticPosition();
        return !insert.hasDynamicPosition() && at.size() == 2 &&
               (at[0] == at[1] ||
                matchPattern(insert.getValueToStore(), m_AnyZeroFloat())) &&
               contains(insert.getDest());
      })
      .Case([&](arith::SelectOp select) {
        return contains(select.getTrueValue()) &&
               contains(select.getFalseValue());
      })
      .Case([&](arith::MulFOp product) {
        return contains(product.getLhs()) || contains(product.getRhs());
      })
      .Case<arith::AddFOp, arith::SubFOp, MatmulOp>([&](auto pair) {
        return contains(pair.getLhs()) && contains(pair.getRhs());
      })
      .Case<arith::DivFOp, arith::NegFOp, TransposeOp, InverseOp>(
          [&](Operation *inner) { return contains(inner->getOperand(0)); })
      .Default(false);
}

/// Finds in `factors`, from `begin` on, the first product F M Hᵀ where F and H
/// are factors of one decomposition and M, which may be missing, is diagonal.
static std::optional<Span> findFrame(ArrayRef<Factor> factors, size_t begin) {
  DiagonalMatrices diagonal;
  for (size_t first = begin; first != factors.size(); ++first) {
    Operation *op = getDecomposition(factors[first].matrix);
    if (!op || factors[first].isTransposed)
      continue;
    for (size_t last = first + 1; last != factors.size(); ++last) {
      if (getDecomposition(factors[last].matrix) == op &&
          factors[last].isTransposed)
        return Span{first, last};
      if (!diagonal.contains(factors[last].matrix))
        break;
    }
  }
  return std::nullopt;
}

Value mlir::tai::createConstantForm(ImplicitLocOpBuilder &builder,
                                    Value value) {
  Type type = value.getType();
  Value zero = arith::ConstantOp::create(
      builder, cast<TypedAttr>(builder.getZeroAttr(type)));
  return DeriveAsOp::create(builder, type, value, zero);
}

/// Emits numerator / divisor; or, where the result is more accurate, `slope`,
/// the derivative of the numerator by the divisor. For two values at a distance
/// δ, the error of the quotient is ε/δ, and the error of `slope` is δ².
S FormMaker::createQuotient(S numerator, S divisor, S slope, S noise, S floor) {
  Value isSmooth =
      arith::CmpFOp::create(b, arith::CmpFPredicate::OLE,
                            abs(numerator - slope * divisor).v, noise.v);
  S quotient = divideAbove(numerator, divisor, floor);
  return {&b, arith::SelectOp::create(b, isSmooth, slope.v, quotient.v)};
}

/// Emits Uᵀ dR V as a function that is linear in A and M; null if no such form
/// is found.
Value FormMaker::createMiddle(Operation *decomposition,
                              ArrayRef<Factor> factors,
                              ArrayRef<Value> diagonal) {
  auto stop = [&](Value value) { return createConstantForm(b, value); };
  auto svd = dyn_cast<SvdOp>(decomposition);
  Value a = decomposition->getOperand(0);
  auto type = cast<VectorType>(a.getType());
  int64_t n = type.getDimSize(0);
  Value spectrum = decomposition->getResult(svd ? 1 : 0);
  SmallVector<int64_t> positions;
  for (int64_t i = 0; i != n; ++i)
    positions.push_back(svd ? i * (n + 1) : i);
  auto slopes = createSlopes(b, function, spectrum, positions, diagonal);
  if (failed(slopes))
    return {};
  S zero{&b, b.createZero(type.getElementType())};
  auto slope = [&](int64_t i, int64_t by) -> S {
    Value value = (*slopes)[by][i];
    return value ? S{&b, value} : zero;
  };
  SmallVector<S> m, sigma;
  Value stopped = stop(spectrum);
  for (int64_t i = 0; i != n; ++i) {
    m.push_back({&b, stop(diagonal[i])});
    sigma.push_back({&b, b.createExtract(stopped, positions[i])});
  }

  Value left = factors.front().matrix, right = factors.back().matrix;
  bool leftIsU = !svd || left == svd.getU();
  bool rightIsU = !svd || right == svd.getU();
  Value u = svd ? svd.getU() : left, v = svd ? svd.getV() : left;
  if (!svd) {
    SmallVector<Value> entries;
    for (int64_t i = 0; i != n; ++i)
      for (int64_t j = 0; j != n; ++j)
        entries.push_back(
            b.createExtract(a, std::max(i, j) * n + std::min(i, j)));
    a = vector::FromElementsOp::create(b, type, entries);
  }
  M p{&b, createMatmul(b, createTranspose(b, stop(u)),
                       createMatmul(b, a, stop(v)))};

  S greatest = abs(sigma[0]);
  for (S other : sigma)
    greatest = max(greatest, abs(other));
  S least{&b, b.createConstant(type.getElementType(), getLeast(type))};
  S even = getTolerance(type) * greatest + least;
  S odd = getJumpTolerance(type) * greatest + least;
  double epsilon = 4 * getEpsilon(type);
  SmallVector<Value> entries(n * n);
  for (int64_t i = 0; i != n; ++i) {
    entries[i * n + i] = diagonal[i];
    for (int64_t j = i + 1; j != n; ++j) {
      S sizes = abs(m[i]) + abs(m[j]);
      S both = abs(sigma[i]) + abs(sigma[j]);
      auto makeQuotient = [&](S numerator, S divisor, S by, S floor) {
        S noise = epsilon * (sizes + abs(by) * both);
        return createQuotient(numerator, divisor, by, noise, floor);
      };
      // A derivative by the difference or the sum of two singular values is
      // half of the difference or sum of the partial derivatives by the two.
      S own = slope(j, j) + slope(i, i), other = slope(j, i) + slope(i, j);
      S difference = makeQuotient(m[j] - m[i], sigma[j] - sigma[i],
                                  0.5 * (own - other), even);
      S symmetric = 0.5 * (p(i, j) + p(j, i));
      S upper = symmetric * difference, lower = upper;
      if (svd) {
        // U turns by O and V by -O: U M Uᵀ changes by O M - M O, U M Vᵀ by O M
        // + M O.
        S skew = 0.5 * (p(i, j) - p(j, i));
        bool isEqual = leftIsU == rightIsU;
        S along = slope(j, i) - slope(i, j);
        S turn =
            isEqual
                ? makeQuotient(m[j] - m[i], sigma[j] + sigma[i],
                               0.5 * (slope(j, j) - slope(i, i) + along), odd)
                : makeQuotient(m[j] + m[i], sigma[j] + sigma[i],
                               0.5 * (own + other), odd);
        S term = leftIsU ? skew * turn : -(skew * turn);
        upper = upper + term;
        lower = isEqual ? lower + term : lower - term;
      }
      entries[i * n + j] = upper.v;
      entries[j * n + i] = lower.v;
    }
  }
  return vector::FromElementsOp::create(b, type, entries);
}

/// Emits the product F M Hᵀ so that it is differentiated as a form that is
/// linear in A and M; null if that is impossible. `known` is the value of the
/// product, or null if it is not computed yet.
Value FormMaker::createCore(ArrayRef<Factor> factors, Value known) {
  Operation *decomposition = getDecomposition(factors.front().matrix);
  auto type = cast<VectorType>(factors.front().matrix.getType());
  int64_t n = type.getDimSize(0);
  SmallVector<Value> diagonal(n);
  for (int64_t i = 0; i != n; ++i) {
    for (Factor factor : factors.drop_front().drop_back()) {
      Value entry = b.createExtract(factor.matrix, i * (n + 1));
      diagonal[i] =
          diagonal[i] ? arith::MulFOp::create(b, diagonal[i], entry).getResult()
                      : entry;
    }
    if (!diagonal[i])
      diagonal[i] = b.createConstant(type.getElementType(), 1);
  }
  Value middle = createMiddle(decomposition, factors, diagonal);
  if (!middle)
    return {};
  Value left = factors.front().matrix, right = factors.back().matrix;
  auto enclose = [&](Value first, Value second, Value last) {
    return createMatmul(b, createMatmul(b, first, second),
                        createTranspose(b, last));
  };
  auto stop = [&](Value value) { return createConstantForm(b, value); };
  Value form = enclose(stop(left), middle, stop(right));
  if (!known)
    known = enclose(left,
                    b.createVector(type,
                                   [&] {
                                     SmallVector<Value> entries(n * n);
                                     for (int64_t i = 0; i != n; ++i)
                                       entries[i * (n + 1)] = diagonal[i];
                                     return entries;
                                   }()),
                    right);
  return DeriveAsOp::create(b, type, known, form);
}

void FormMaker::make(MatmulOp product) {
  b.setInsertionPointAfter(product);
  b.setLoc(product.getLoc());
  Chain chain;
  flatten(b, product, /*isTransposed=*/false, chain);
  Value whole = product.getResult(), result;
  bool isAll = false;
  auto append = [&](Value factor) {
    result = result ? createMatmul(b, result, factor) : factor;
  };
  ArrayRef<Factor> factors = chain.factors;
  bool isFound = false;
  for (size_t next = 0; next != factors.size();) {
    std::optional<Span> frame = findFrame(factors, next);
    size_t end = frame ? frame->first : factors.size();
    for (; next != end; ++next)
      append(factors[next].isTransposed
                 ? createTranspose(b, factors[next].matrix)
                 : factors[next].matrix);
    if (!frame)
      break;
    size_t count = frame->last - frame->first + 1;
    isAll = count == factors.size() && chain.scales.empty();
    Value core =
        createCore(factors.slice(frame->first, count), isAll ? whole : Value());
    if (!core)
      return;
    isFound = true;
    append(core);
    next += count;
  }
  if (!isFound)
    return;
  for (Value scale : chain.scales)
    result = createScaled(b, result, scale);
  if (!isAll)
    result = DeriveAsOp::create(b, whole.getType(), whole, result);
  Operation *last = result.getDefiningOp();
  whole.replaceUsesWithIf(
      result, [&](OpOperand &use) { return use.getOwner() != last; });
}

SpectralForms::SpectralForms(FunctionOpInterface function)
    : function(function) {
  SmallVector<MatmulOp> products;
  bool hasFactors = false;
  function.walk<WalkOrder::PreOrder>([&](Operation *op) {
    hasFactors |= isa<SvdOp, SymEigOp>(op);
    if (auto product = dyn_cast<MatmulOp>(op); product && hasFactors)
      products.push_back(product);
  });
  if (products.empty())
    return;
  FormMaker maker(function);
  for (MatmulOp product : products)
    maker.make(product);
}

SpectralForms::~SpectralForms() { dropForms(function); }

void mlir::tai::dropForms(FunctionOpInterface function) {
  SmallVector<Value> forms;
  function.walk([&](DeriveAsOp op) {
    forms.push_back(op.getForm());
    op.replaceAllUsesWith(op.getValue());
    op.erase();
  });
  if (forms.empty())
    return;
  // Dead ops are erased here, users before the ops that make their operands.
  function.walk<WalkOrder::PostOrder, mlir::ReverseIterator>([](Operation *op) {
    if (isOpTriviallyDead(op))
      op->erase();
  });
}

void mlir::tai::warnOfActiveFactors(FunctionOpInterface function,
                                    function_ref<bool(Value)> isActive) {
  function.walk([&](Operation *op) {
    if (!isa<SvdOp, SymEigOp>(op))
      return;
    bool isSvd = isa<SvdOp>(op);
    bool turns = isActive(op->getResult(isSvd ? 0 : 1)) ||
                 (isSvd && isActive(op->getResult(2)));
    if (!turns)
      return;
    InFlightDiagnostic diag =
        op->emitWarning()
        << (isSvd ? "where singular values are equal, the derivatives of U and "
                    "V by themselves do not exist and are taken as zero"
                  : "where eigenvalues are equal, the derivatives of the "
                    "eigenvectors do not exist and are taken as zero");
    diag.attachNote() << "products such as U f(Σ) Vᵀ written with '@' are "
                         "differentiated as functions of the matrix and are "
                         "right everywhere";
  });
}
