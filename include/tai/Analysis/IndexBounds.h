//===- IndexBounds.h - Indices and the loops around them --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Whether the indices of an access are in bounds: always, or under inequalities
// on the arguments of the launch, or unknown.
//
// An index is a linear sum of loop indices and of launch values, which depend
// on the arguments of the kernel and the extents of its arrays alone. Loops and
// conditions around an access bound the index. These bounds together with "the
// index is out of range" are a linear system; eliminating the loop indices
// leaves the launches that go out of range. Products of loop indices and launch
// values are checked at the first and the last iterations of their loops.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ANALYSIS_INDEXBOUNDS_H
#define TAI_ANALYSIS_INDEXBOUNDS_H

#include "tai/Analysis/IndexedAccess.h"
#include "tai/Analysis/IterationDomains.h"

namespace mlir::tai {

/// A condition under which an access is out of range.
struct Violation {
  /// The access goes out of range if this system over launch values holds.
  LinearSystem launch;
  /// The first iteration in which the access goes out of range, outermost loop
  /// first: each index is the least number for which its system holds, given
  /// the indices of the loops around.
  struct Step {
    unsigned variable;
    LinearSystem system;
  };
  SmallVector<Step> iteration;
};

struct BoundsAnswer {
  /// True if the index is in range in every launch.
  bool isInRange = false;
  /// True if `violations` is complete: in a launch for which no violation
  /// holds, the index is in range.
  bool isDecided = false;
  /// The conditions under which the index is out of range. Each is exact: a
  /// launch for which a condition holds has an out-of-range access.
  SmallVector<Violation, 1> violations;
};

class IndexBounds {
public:
  explicit IndexBounds(KernelOp kernel)
      : forms(kernel), domains(kernel, forms) {}
  IndexBounds(const IndexBounds &) = delete;

  /// Checks whether index number `number` of an access is in range. With
  /// `proves`, also tries an index that depends on data, since conditions in
  /// the program can keep it in range.
  BoundsAnswer check(const IndexedAccess &access, size_t number, bool proves);

  /// The table of the loop indices and launch values that variables stand for.
  const IndexForms &getForms() const { return forms; }
  /// The index as a linear sum of loop indices and launch values; none if it is
  /// not one.
  std::optional<LinearSum> getSum(Value index);

private:
  void checkSide(const IterationDomain &domain, const LinearSum &beyond,
                 BoundsAnswer &answer, bool &isExact);
  void checkPiece(const IterationDomain &domain, LinearSystem system,
                  BoundsAnswer &answer, bool &isExact);
  void eliminateLoops(const IterationDomain &domain, LinearSystem system,
                      Violation violation, BoundsAnswer &answer, bool &isExact);
  void checkCorners(const IterationDomain &domain, ArrayRef<LinearSum> piece,
                    const LinearSum &beyond, BoundsAnswer &answer,
                    bool &isExact);

  IndexForms forms;
  IterationDomains domains;
};

/// Whether accesses of the kernel around `op` are checked at run time, so that
/// the kernel must not be restructured.
bool checksIndices(Operation *op);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXBOUNDS_H
