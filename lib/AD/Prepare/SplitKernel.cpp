//===- SplitKernel.cpp - Loop fission into kernels ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Splits a kernel whose loops need several versions of one field. This is known
// only when the adjoint is built, so it is built on trial, for kernels of
// several loops of which one writes a field that another one accesses.
//
//===----------------------------------------------------------------------===//

#include "../SelectedFunctionsPass.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/AD/Reverse/AdjointBuilder.h"
#include "tai/Analysis/Accesses.h"
#include "tai/Analysis/SkipScope.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Support/SilencedDiagnostics.h"

namespace mlir::tai {
#define GEN_PASS_DEF_SPLITKERNEL
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

/// The segment number of an op at the top level of the kernel that has no side
/// effects, so that several parts may repeat it.
constexpr int kShared = -1;

/// True if an op inside of `op` has a side effect other than a read.
static bool hasEffect(Operation *op) {
  WalkResult result = op->walk([](Operation *inner) {
    bool isHarmless = inner->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
                      isMemoryEffectFree(inner) ||
                      hasSingleEffect<MemoryEffects::Read>(inner);
    return isHarmless ? WalkResult::advance() : WalkResult::interrupt();
  });
  return result.wasInterrupted();
}

static bool holdsParallelLoop(Operation *op) {
  return op
      ->walk([](ParallelForOp loop) {
        return isSerialLoop(loop) ? WalkResult::advance()
                                  : WalkResult::interrupt();
      })
      .wasInterrupted();
}

/// Numbers the segments of a kernel: returns the segment of each op at its top
/// level. Consecutive serial ops form one segment.
static SmallVector<int> findSegments(KernelOp kernel, int &count) {
  SmallVector<int> segments;
  count = 0;
  bool inSerial = false;
  for (Operation &op : kernel.getBody().front().without_terminator()) {
    if (!hasEffect(&op)) {
      segments.push_back(kShared);
      continue;
    }
    bool isParallel = holdsParallelLoop(&op);
    if (isParallel || !inSerial)
      ++count;
    inSerial = !isParallel;
    segments.push_back(count - 1);
  }
  return segments;
}

/// Returns the ops at the top level of a kernel, by position.
static SmallVector<Operation *> getTopLevel(KernelOp kernel) {
  return llvm::map_to_vector(kernel.getBody().front().without_terminator(),
                             [](Operation &op) { return &op; });
}

/// True if some storage is written in one segment and accessed in another.
static bool sharesStorage(KernelOp kernel, ArrayRef<int> segments) {
  struct Use {
    int first = kShared;
    bool inSeveral = false, written = false;
  };
  DenseMap<const void *, Use> uses;
  for (auto [op, segment] : llvm::zip(getTopLevel(kernel), segments))
    op->walk([&, segment = segment](DifferentiableAccessInterface access) {
      auto [it, isNew] = uses.try_emplace(getStorageKey(access));
      Use &use = it->second;
      if (isNew)
        use.first = segment;
      use.inSeveral |= use.first != segment;
      use.written |= access.getAccessKind() != AccessKind::Read;
    });
  return llvm::any_of(uses, [](auto &entry) {
    return entry.second.inSeveral && entry.second.written;
  });
}

/// True if no adjoint can be made of the kernel as a whole, but possibly of its
/// parts.
static bool needsParts(KernelOp kernel) {
  SilencedDiagnostics silence(kernel.getContext());
  OpBuilder builder(kernel);
  // In this trial adjoint, array arguments of the kernel have no adjoints.
  FailureOr<AdjointSignature> signature =
      AdjointSignature::get(kernel, /*arrays=*/false);
  if (failed(signature))
    return false;
  SmallVector<Type> inputs(kernel.getArgumentTypes());
  llvm::append_range(inputs, signature->getShadowTypes(kernel));
  auto shell = KernelOp::create(
      builder, kernel.getLoc(), (kernel.getSymName() + ".trial").str(),
      FunctionType::get(kernel.getContext(), inputs, {}));
  bool result = false;
  SkipScope unheard;
  bool failing =
      failed(fillAdjoint(kernel, shell, *signature, AdjointOptions(), &result));
  shell.erase();
  return failing && result;
}

namespace {
/// Splits one kernel.
class Splitter {
public:
  Splitter(KernelOp kernel, ArrayRef<int> segments, int count)
      : kernel(kernel), ops(getTopLevel(kernel)), segments(segments),
        count(count) {
    for (auto [i, op] : llvm::enumerate(ops))
      position[op] = i;
  }

  LogicalResult check();
  void split();

private:
  LogicalResult checkUse(Operation *shared, int segment, Operation *user,
                         DenseSet<Operation *> &visited);

  KernelOp kernel;
  SmallVector<Operation *> ops;
  ArrayRef<int> segments;
  int count;
  DenseMap<Operation *, size_t> position;
};
} // namespace

/// Checks that the part of `segment` can compute the value of `shared`, which
/// `user` uses, by itself.
LogicalResult Splitter::checkUse(Operation *shared, int segment,
                                 Operation *user,
                                 DenseSet<Operation *> &visited) {
  size_t at = position.lookup(shared);
  if (segments[at] == segment || !visited.insert(shared).second)
    return success();
  if (segments[at] != kShared) {
    InFlightDiagnostic diag = shared->emitError(
        "the gradient needs the loops of this kernel to be "
        "launched one by one, but a later one uses a value of "
        "this one");
    diag.attachNote(user->getLoc()) << "used here";
    diag.attachNote() << "store it to a field, or make two kernels";
    return diag;
  }
  Operation *write = nullptr;
  WalkResult result = shared->walk([&](DifferentiableAccessInterface read)
                                       -> WalkResult {
    for (auto [i, other] : llvm::enumerate(ops)) {
      if (i < at || segments[i] == kShared || segments[i] >= segment)
        continue;
      other->walk([&](DifferentiableAccessInterface access) {
        if (access.getAccessKind() != AccessKind::Read &&
            getStorageKey(access) == getStorageKey(read) &&
            mayReachLater(read, access))
          write = access;
      });
      if (write) {
        InFlightDiagnostic diag = read.emitError(
            "the gradient needs the loops of this kernel to be launched one "
            "by one, but the value read here is used by a later one");
        diag.attachNote(user->getLoc()) << "used here";
        diag.attachNote(write->getLoc()) << "overwritten here in between";
        diag.attachNote() << "store the new value to another element, or "
                             "make two kernels";
        return WalkResult::interrupt();
      }
    }
    return WalkResult::advance();
  });
  if (result.wasInterrupted())
    return failure();
  LogicalResult all = success();
  shared->walk([&](Operation *inner) {
    for (Value operand : inner->getOperands())
      if (Operation *owner = operand.getDefiningOp();
          owner && position.count(owner) && owner != shared &&
          failed(checkUse(owner, segment, user, visited)))
        all = failure();
  });
  return all;
}

LogicalResult Splitter::check() {
  SmallVector<DenseSet<Operation *>> visited(count);
  auto checkOperands = [&](Operation *user, int segment) {
    LogicalResult result = success();
    user->walk([&](Operation *inner) {
      for (Value operand : inner->getOperands())
        if (Operation *owner = operand.getDefiningOp();
            owner && position.count(owner) && owner != user &&
            failed(checkUse(owner, segment, user, visited[segment])))
          result = failure();
    });
    return result;
  };
  LogicalResult result = success();
  for (auto [op, segment] : llvm::zip(ops, segments))
    if (segment != kShared && failed(checkOperands(op, segment)))
      result = failure();
  if (failed(
          checkOperands(kernel.getBody().front().getTerminator(), count - 1)))
    result = failure();
  return result;
}

/// The parts of a split kernel have no results: removes results from the
/// positions by which `part` is differentiated.
static void dropResults(KernelOp part) {
  DenseI64ArrayAttr positions = part.getGradientsAttr();
  if (!positions)
    return;
  SmallVector<int64_t> kept;
  for (int64_t position : positions.asArrayRef())
    if (position < part.getNumArguments())
      kept.push_back(position);
  part.setGradients(kept);
}

void Splitter::split() {
  OpBuilder builder(kernel.getContext());
  Operation *after = kernel;
  for (int part = 0; part != count; ++part) {
    auto clone = cast<KernelOp>(kernel->clone());
    builder.setInsertionPointAfter(after);
    builder.insert(clone);
    after = clone;
    clone.setSymName((kernel.getSymName() + "." + Twine(part)).str());
    clone.setPartOfAttr(FlatSymbolRefAttr::get(kernel.getSymNameAttr()));
    if (part + 1 != count) {
      clone.getBody().front().getTerminator()->setOperands({});
      clone.setFunctionType(FunctionType::get(
          clone.getContext(), clone.getArgumentTypes(), TypeRange()));
      clone.removeResAttrsAttr();
      dropResults(clone);
    }
    SmallVector<Operation *> copies = getTopLevel(clone);
    for (size_t i = copies.size(); i-- > 0;) {
      bool isOther = segments[i] != kShared && segments[i] != part;
      if (isOther || (segments[i] == kShared && copies[i]->use_empty()))
        copies[i]->erase();
    }
  }
}

namespace {
struct SplitKernel
    : SelectedFunctionsPass<SplitKernel, tai::impl::SplitKernelBase> {
  using SelectedFunctionsPass::SelectedFunctionsPass;

  LogicalResult runOnFunction(FunctionOpInterface function) {
    auto kernel = dyn_cast<KernelOp>(function.getOperation());
    if (!kernel || kernel.getPartOf() || !kernel.getBody().hasOneBlock())
      return success();
    int count = 0;
    SmallVector<int> segments = findSegments(kernel, count);
    if (count < 2 || !sharesStorage(kernel, segments) || !needsParts(kernel))
      return success();
    Splitter splitter(kernel, segments, count);
    if (failed(splitter.check()))
      return failure();
    splitter.split();
    return success();
  }
};
} // namespace
