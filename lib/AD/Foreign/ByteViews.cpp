//===- ByteViews.cpp - Arrays in memory of bytes --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A compiler that plans memory allocates bytes, and places arrays in them. The
// adjoint of an array is another array, but bytes have no adjoint.
//
//===----------------------------------------------------------------------===//

#include "ByteViews.h"
#include "TraceBytes.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The bytes of an array.
struct PlacedArray {
  memref::ViewOp view;
  int64_t begin, end;
};
} // namespace

/// Returns the range of a view whose place and size are constants.
static std::optional<PlacedArray> getRange(memref::ViewOp view) {
  std::optional<int64_t> begin = getConstant(view.getByteShift());
  MemRefType type = view.getType();
  if (!begin || !type.hasStaticShape() || !hasBytes(type.getElementType()))
    return std::nullopt;
  int64_t bytes = static_cast<int64_t>(getBytes(type.getElementType()));
  return PlacedArray{view, *begin, *begin + type.getNumElements() * bytes};
}

static LogicalResult refuse(memref::ViewOp view, const Twine &note,
                            Location place) {
  InFlightDiagnostic diag =
      view.emitError("cannot differentiate an array in these bytes");
  diag.attachNote(place) << note;
  return diag;
}

/// Gives each array in the bytes that `maker` allocates memory of its own.
static LogicalResult split(Operation *maker) {
  SmallVector<PlacedArray> ranges;
  SmallVector<Operation *> deallocs;
  for (Operation *user : maker->getUsers()) {
    if (isa<memref::DeallocOp>(user)) {
      deallocs.push_back(user);
      continue;
    }
    auto view = dyn_cast<memref::ViewOp>(user);
    std::optional<PlacedArray> range = view ? getRange(view) : std::nullopt;
    if (!range) {
      auto other = view ? view : ranges.empty() ? view : ranges.front().view;
      if (!other)
        return success(); // bytes, and no array
      return refuse(other,
                    "the place and the size of each array in the bytes must be "
                    "constants; allocate the array by 'memref.alloc'",
                    user->getLoc());
    }
    for (PlacedArray &known : ranges)
      if (range->begin < known.end && known.begin < range->end &&
          (range->begin != known.begin ||
           known.view.getType() != range->view.getType()))
        return refuse(range->view,
                      "another array is in the same bytes; allocate both by "
                      "'memref.alloc'",
                      known.view.getLoc());
    ranges.push_back(*range);
  }
  if (ranges.empty())
    return success();
  OpBuilder b(maker);
  SmallVector<std::pair<int64_t, Value>> made;
  for (PlacedArray &range : ranges) {
    auto *known = llvm::find_if(
        made, [&](const auto &entry) { return entry.first == range.begin; });
    Value array;
    if (known != made.end()) {
      array = known->second;
    } else {
      array =
          memref::AllocOp::create(b, range.view.getLoc(), range.view.getType());
      made.emplace_back(range.begin, array);
      for (Operation *dealloc : deallocs) {
        OpBuilder end(dealloc);
        memref::DeallocOp::create(end, dealloc->getLoc(), array);
      }
    }
    range.view.replaceAllUsesWith(array);
    range.view.erase();
  }
  for (Operation *dealloc : deallocs)
    dealloc->erase();
  maker->erase();
  return success();
}

LogicalResult mlir::tai::splitByteViews(func::FuncOp function) {
  SmallVector<Operation *> makers;
  SmallVector<memref::ViewOp> others;
  function.walk([&](memref::ViewOp view) {
    Operation *maker = view.getSource().getDefiningOp();
    if (!isa_and_nonnull<memref::AllocOp, memref::AllocaOp>(maker))
      others.push_back(view);
    else if (!llvm::is_contained(makers, maker))
      makers.push_back(maker);
  });
  for (memref::ViewOp view : others)
    if (hasBytes(view.getType().getElementType()) &&
        isa<FloatType>(getElementTypeOrSelf(view.getType().getElementType())))
      return refuse(view,
                    "bytes of the caller have no adjoint; take the array as an "
                    "argument",
                    view.getSource().getLoc());
  for (Operation *maker : makers)
    if (failed(split(maker)))
      return failure();
  return success();
}
