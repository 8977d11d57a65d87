//===- Differentiable.h - Interfaces of differentiable ops ------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The interfaces of DifferentiableInterfaces.td, the types in their methods,
// and the registration of external models for upstream dialects and for tai.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INTERFACES_DIFFERENTIABLE_H
#define TAI_INTERFACES_DIFFERENTIABLE_H

#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/BuiltinTypes.h"
#include "mlir/IR/OpDefinition.h"
#include "llvm/ADT/Hashing.h"
#include "llvm/ADT/PointerUnion.h"

namespace mlir {
class DialectRegistry;
class OpBuilder;
} // namespace mlir

namespace mlir::tai {
class AdjointBuilder;
class TangentBuilder;

/// The kind of an access to an element of memory. `Update` is any combination
/// with the old value that is not a sum.
enum class AccessKind { Read, Write, Accumulate, Update };

/// The target of a memory access: a field, by symbol, or a memref, by value.
struct Storage {
  FlatSymbolRefAttr field;
  Value memref;

  Storage() = default;
  Storage(FlatSymbolRefAttr field) : field(field) {}
  Storage(Value memref) : memref(memref) {}
  explicit operator bool() const { return field || memref; }
  bool operator==(const Storage &other) const {
    return field == other.field && memref == other.memref;
  }
  bool operator!=(const Storage &other) const { return !(*this == other); }
  const void *getOpaque() const {
    return field ? field.getAsOpaquePointer() : memref.getAsOpaquePointer();
  }
};

/// True for floats and vectors of floats: the types that carry derivatives.
inline bool isFloatOrVector(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return isa<FloatType>(vector.getElementType());
  return isa<FloatType>(type);
}

/// True for a vector whose number of components is known only at run time. Its
/// components cannot be taken one by one, which adjoints require.
inline bool isScalableVector(Type type) {
  auto vector = dyn_cast<VectorType>(type);
  return vector && vector.isScalable();
}

/// The default limit of the values that the reverse of a serial loop records at
/// once, in bytes for each thread: part of a core's L2 cache.
constexpr int64_t kDefaultHistoryBytes = 256 * 1024;

/// Reports that `op` has no rule for tangents; for default implementations of
/// the interfaces.
LogicalResult refuseTangent(Operation *op, TangentBuilder &builder);
/// Extends the regions of an op whose results have no tangents; reports an
/// error if a result would need a tangent.
LogicalResult extendRegions(Operation *op, TangentBuilder &builder);

/// Attaches the interfaces to the ops of arith, math, scf, vector, memref and
/// tai, when these dialects are loaded.
void registerDifferentiableModels(DialectRegistry &registry);

} // namespace mlir::tai

#include "tai/Interfaces/DifferentiableInterfaces.h.inc"

#endif // TAI_INTERFACES_DIFFERENTIABLE_H
