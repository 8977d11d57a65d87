//===- FieldAccess.h - Interface of accesses to fields ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// FieldAccessOpInterface and its kinds of accesses.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_INTERFACES_FIELDACCESS_H
#define TAI_INTERFACES_FIELDACCESS_H

#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/IR/OpDefinition.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"

namespace mlir::tai {

/// The kind of an access to a field.
enum class FieldAccess {
  Read,       ///< reads an element
  Write,      ///< replaces an element
  Combine,    ///< replaces an element by its combination with a value
  ReadCells,  ///< reads which cells are active
  WriteCells, ///< activates or deactivates cells
  Append,     ///< appends an element to a list, and returns its position
};

inline bool isElementAccess(FieldAccess access) {
  return access == FieldAccess::Read || access == FieldAccess::Write ||
         access == FieldAccess::Combine;
}
inline bool readsField(FieldAccess access) {
  return access != FieldAccess::Write && access != FieldAccess::WriteCells;
}
inline bool writesField(FieldAccess access) {
  return access != FieldAccess::Read && access != FieldAccess::ReadCells;
}

/// The effects of accesses to fields; an effect names the field by symbol.
struct FieldResource : SideEffects::Resource::Base<FieldResource> {
  StringRef getName() final { return "tai.field"; }
};

/// Adds the memory effects of an access of kind `access` to `field`.
inline void
addFieldEffects(SmallVectorImpl<MemoryEffects::EffectInstance> &effects,
                FieldAccess access, FlatSymbolRefAttr field) {
  if (readsField(access))
    effects.emplace_back(MemoryEffects::Read::get(), field,
                         FieldResource::get());
  if (writesField(access))
    effects.emplace_back(MemoryEffects::Write::get(), field,
                         FieldResource::get());
}

} // namespace mlir::tai

#include "tai/Interfaces/FieldAccessInterface.h.inc"

#endif // TAI_INTERFACES_FIELDACCESS_H
