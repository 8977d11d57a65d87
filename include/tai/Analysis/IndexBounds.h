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

#include "tai/Analysis/IndexedAccess.h"
#include "tai/Analysis/IterationDomains.h"

namespace mlir::tai {

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
  explicit IndexBounds(KernelOp kernel)
      : forms(kernel), domains(kernel, forms) {}
  IndexBounds(const IndexBounds &) = delete;

  /// Looks at index `number` of an access. `proves`: also at numbers that
  /// depend on data, which conditions may keep in range.
  BoundsAnswer check(const IndexedAccess &access, size_t number, bool proves);

  /// What the variables of a system stand for.
  const IndexForms &getForms() const { return forms; }
  /// The index as a sum, if it is one of loop indices and launch values.
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

/// Whether accesses of the kernel around `op` are checked as they run, so that
/// it is to stay as it was written.
bool checksIndices(Operation *op);

} // namespace mlir::tai

#endif // TAI_ANALYSIS_INDEXBOUNDS_H
