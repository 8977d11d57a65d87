//===- IndexBounds.h - Indices and the loops around them --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether the indices of an access lie in its field or array: always, or if the
// numbers that the launch is given fulfil some inequalities, or nobody knows.
//
// An index is a linear sum of loop indices and of launch values: what follows
// from the arguments of the kernel and the extents of its arrays alone. Loops
// and conditions around an access bound them. All of that and "the index is
// beyond the end" is a linear system; without the loop indices, it says when a
// launch goes out of range. Products of loop indices and launch values are
// looked at in the first and the last iterations of their loops.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEXBOUNDS_H
#define TAI_ANALYSIS_INDEXBOUNDS_H

#include "tai/Analysis/LinearSystem.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/DenseMap.h"
#include <optional>

namespace mlir::tai {

/// Values that a number can have, both ends included. The ends of int64_t stand
/// for no bound.
struct NumberRange {
  int64_t low = INT64_MIN, high = INT64_MAX;

  bool isBounded() const { return low != INT64_MIN && high != INT64_MAX; }
  bool isWithin(NumberRange other) const {
    return low >= other.low && high <= other.high;
  }
};

/// The number of an extent, which for an array may be known to the launch only.
struct Extent {
  int64_t number = 0;
  /// If not null: dimension `number` of this argument.
  Value array = {};
};

/// An access that has indices, taken apart.
struct IndexedAccess {
  Operation *op;
  /// "field '@x' of shape [4, 8]".
  std::string what;
  /// As the program gives them. Those of components of an element follow those
  /// of the element.
  SmallVector<OpOperand *> indices;
  SmallVector<int64_t> first;
  SmallVector<Extent> extents;
  /// How many of them are those of the element.
  size_t rank = 0;

  /// Nothing for an operation that is no access, or of a kind that has no box.
  static std::optional<IndexedAccess> get(Operation *op);
};

/// "field '@x' of shape [4, 8]", with the first index where it is not zero.
std::string describeField(const FieldLayout &layout);
/// "an array of f32 of shape [?, 3]".
std::string describeArray(MemRefType type);

/// A number of which the host knows the value before the kernel runs: a value
/// that can be computed then, the extent of an array, or the product of two
/// sums of launch values.
struct LaunchValue {
  Value value, array;
  int64_t dimension = 0;
  SmallVector<LinearSum, 0> factors = {};
};

/// A way in which an access leaves its field.
struct Violation {
  /// It happens if all of these hold, which are sums of launch values.
  LinearSystem launch;
  /// The first iteration in which it happens, outermost loop first: each is the
  /// least number for which its system holds, with the values before it given.
  struct Step {
    unsigned variable;
    LinearSystem system;
  };
  SmallVector<Step> iteration;
};

struct BoundsAnswer {
  /// The index lies in its range whenever the access runs.
  bool isInRange = false;
  /// It does in all launches that none of `violations` happens in.
  bool isDecided = false;
  /// Each is certain to be an error of the program.
  SmallVector<Violation, 1> violations;
};

class IndexBounds {
public:
  explicit IndexBounds(KernelOp kernel) : kernel(kernel) {}

  /// Looks at index `number` of an access. `proves`: also at numbers that
  /// depend on data, which conditions may keep in range.
  BoundsAnswer check(const IndexedAccess &access, size_t number, bool proves);

  /// What a variable of a system stands for, if the launch knows it.
  const LaunchValue *getLaunchValue(unsigned variable) const;
  /// The two factors, where a variable stands for a product that changes in a
  /// loop; the first is of launch values. Empty for others.
  ArrayRef<LinearSum> getFactors(unsigned variable) const;
  /// The index as a sum, if it is one of loop indices and launch values.
  std::optional<LinearSum> getSum(Value index);

private:
  struct Variable {
    enum class Kind { Launch, Loop, Quotient, Product, Data } kind;
    NumberRange range;
    LaunchValue launch = {};
    /// Of a product.
    SmallVector<LinearSum, 0> factors = {};
  };
  /// A value as a sum, and what holds for the variables in it.
  struct Form {
    LinearSum sum;
    SmallVector<LinearSum, 2> facts;
    /// The sum is the value for certain, and follows from the iteration.
    bool isCertain = true;
    /// `facts` hold always. If not, they are assumptions.
    bool isComplete = true;
  };
  /// The iterations in which a block runs, as a union of systems.
  struct Domain {
    SmallVector<SmallVector<LinearSum>, 1> pieces;
    /// Loop indices, from the outermost to the innermost.
    SmallVector<unsigned> loops;
    /// Each point is an iteration that runs.
    bool isCertain = true;
    /// Each iteration that runs is a point.
    bool isComplete = true;
  };

  Form formOf(Value value);
  Form makeForm(Value value);
  Form makeLoopForm(BlockArgument argument);
  std::optional<Form> makeLinear(Operation *op);
  std::optional<Form> makeQuotient(Operation *op);
  std::optional<Form> makeExtreme(Operation *op);
  std::optional<Form> makeProduct(Operation *op);
  Form makeLaunchForm(LaunchValue launch, NumberRange range);
  Form makeVariable(Variable::Kind kind, NumberRange range);
  Form combine(const Form &a, const Form &b, int64_t scale) const;
  /// Adds what must hold for `value`, given as a sum, not to have wrapped.
  void assumeFits(Form &form, Type type) const;

  bool isLaunchValue(Value value);
  NumberRange rangeOf(Value value);
  NumberRange computeRange(Value value);
  NumberRange rangeOfSum(const LinearSum &sum) const;

  Domain domainOf(Block *block);
  void addLoop(Domain &domain, ParallelForOp loop);
  void addLoop(Domain &domain, BlockArgument iv, Value lower, Value upper);
  void addCondition(Domain &domain, Value condition, bool holds);
  void addComparison(Domain &domain, Value lhs, Value rhs, int64_t gap);
  void addEither(Domain &domain, function_ref<void(Domain &)> first,
                 function_ref<void(Domain &)> second);
  static void addRow(Domain &domain, const LinearSum &row);
  void addFacts(Domain &domain, const Form &form);

  void checkSide(const Domain &domain, const LinearSum &beyond,
                 BoundsAnswer &answer, bool &isExact);
  void checkPiece(const Domain &domain, LinearSystem system,
                  BoundsAnswer &answer, bool &isExact);
  void eliminateLoops(const Domain &domain, LinearSystem system,
                      Violation violation, BoundsAnswer &answer, bool &isExact);

  /// Sums by which loop indices are replaced: an iteration.
  using Corner = llvm::SmallDenseMap<unsigned, LinearSum, 4>;
  bool isOfLaunch(const LinearSum &sum) const;
  bool hasProduct(const LinearSum &sum) const;
  void collectLoopsOfProducts(const LinearSum &sum, bool isInProduct,
                              SmallVectorImpl<unsigned> &loops) const;
  LinearSum multiply(const LinearSum &a, const LinearSum &b,
                     SmallVectorImpl<LinearSum> &facts);
  LinearSum substitute(const LinearSum &sum, const Corner &corner,
                       SmallVectorImpl<LinearSum> &facts);
  void checkCorners(const Domain &domain, ArrayRef<LinearSum> piece,
                    const LinearSum &beyond, BoundsAnswer &answer,
                    bool &isExact);

  KernelOp kernel;
  std::vector<Variable> variables;
  llvm::DenseMap<Value, Form> forms;
  llvm::DenseMap<Value, NumberRange> ranges;
  llvm::DenseMap<Value, bool> launchValues;
  llvm::DenseMap<Block *, Domain> domains;
  llvm::DenseMap<Value, unsigned> launchVariables;
  llvm::DenseMap<std::pair<Value, int64_t>, unsigned> extentVariables;
};

/// Whether accesses of the kernel around `op` are checked as they run, so that
/// it is to stay as it was written.
bool checksIndices(Operation *op);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXBOUNDS_H
