//===- DiscardableAttrs.cpp - Discardable `tai.*` attributes --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The table of `tai.*` attributes that may be on an op of any dialect. An
// unknown attribute would be ignored silently, so it is rejected: a misspelt
// `tai.differentiate` must not lead to a missing gradient.
//
//===----------------------------------------------------------------------===//

#include "DiscardableAttrs.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
enum class Kind { Unit, Integer, Float, Symbol, List, Numbers, Register, Any };

/// A discardable attribute that users write, or by which passes communicate.
struct KnownAttr {
  StringLiteral name;
  Kind kind;
  /// True if only functions and kernels may have the attribute.
  bool ofFunctions = false;
};
} // namespace

// Attributes that affect results are not in this table but are attributes of
// the ops themselves; docs/decisions/0028-ir-level.md lists both kinds.
static constexpr KnownAttr kKnown[] = {
    // Attributes that users write, or that are on functions of other dialects.
    {"tai.adjoint", Kind::Symbol, true},
    {"tai.check_updates", Kind::Unit, true},
    {"tai.conventions", Kind::Any, true},
    {"tai.differentiate", Kind::Unit, true},
    {"tai.gradients", Kind::Any, true},
    {"tai.prepared_for", Kind::Symbol, true},
    {"tai.reads_before", Kind::Any, true},
    {"tai.reexecutes", Kind::Unit, true},
    {"tai.split", Kind::Any, true},
    {"tai.tangent", Kind::Symbol, true},
    {"tai.trace_bytes", Kind::Integer, true},
    {"tai.saved", Kind::Any},
    // Attributes that only make a program faster.
    {"tai.access_group", Kind::Any},
    {"tai.accesses", Kind::Numbers},
    {"tai.active", Kind::Unit},
    {"tai.adjoint_access", Kind::Unit},
    {"tai.guard_versions", Kind::Unit},
    {"tai.digits", Kind::Numbers},
    {"tai.in_range", Kind::Unit},
    {"tai.independent", Kind::Unit},
    {"tai.index_bits", Kind::Integer},
    {"tai.interior", Kind::Numbers},
    {"tai.apart", Kind::Unit},
    {"tai.fallback", Kind::Unit},
    {"tai.tiles", Kind::Any},
    // Attributes on which the meaning of a program does not depend.
    {"tai.accumulate", Kind::Register},
    {"tai.adjoint_branch", Kind::Unit},
    {"tai.guard", Kind::Unit},
    {"tai.guard_infinite", Kind::Unit},
    // Attributes that a single pass sets and reads.
    {"tai.alignment", Kind::Integer},
    {"tai.device_slot", Kind::Unit},
    {"tai.keeps_order", Kind::Unit},
    {"tai.ordered_scope", Kind::Any},
    {"tai.rerun_read", Kind::Integer},
    {"tai.site", Kind::Integer},
    {"tai.stores_first", Kind::List},
    {"tai.sum_target", Kind::Integer},
};

static constexpr RenamedAttr kRenamed[] = {
    {"tai.before", "reads_before"},  {"tai.conventions", "conventions"},
    {"tai.gradients", "gradients"},  {"tai.keeps_activity", "keeps_activity"},
    {"tai.modes", "modes"},          {"tai.part_of", "part_of"},
    {"tai.reruns", "reexecutes"},    {"tai.stored_form", "stored_form"},
    {"tai.takes", "zeroes_adjoint"}, {"tai.tangent", "tangent"},
};

ArrayRef<RenamedAttr> tai::getRenamedKernelAttrs() { return kRenamed; }

StringAttr tai::getFunctionAttrName(Operation *op, StringRef name) {
  return isa<KernelOp>(op) ? StringAttr::get(op->getContext(), name)
                           : StringAttr::get(op->getContext(), "tai." + name);
}

/// Name of the only discardable attribute of function arguments.
static constexpr StringLiteral kElementRank = "tai.element_rank";

static bool isOfKind(Attribute attr, Kind kind) {
  switch (kind) {
  case Kind::Unit:
    return isa<UnitAttr>(attr);
  case Kind::Integer:
    return isa<IntegerAttr>(attr);
  case Kind::Float:
    return isa<FloatAttr>(attr);
  case Kind::Symbol:
    return isa<FlatSymbolRefAttr>(attr);
  case Kind::List:
    return isa<ArrayAttr>(attr);
  case Kind::Numbers:
    return isa<DenseI64ArrayAttr>(attr);
  case Kind::Register: {
    auto reduction = dyn_cast<ReductionAttr>(attr);
    return reduction && reduction.getForm() == ReductionForm::Register;
  }
  case Kind::Any:
    return true;
  }
  llvm_unreachable("unknown kind of attribute");
}

static StringRef describe(Kind kind) {
  switch (kind) {
  case Kind::Unit:
    return "to stand alone, without a value";
  case Kind::Integer:
    return "an integer";
  case Kind::Float:
    return "a float";
  case Kind::Symbol:
    return "the name of a function, such as @f";
  case Kind::List:
    return "a list";
  case Kind::Numbers:
    return "numbers, such as array<i64: 0, 2>";
  case Kind::Register:
    return "a #tai.reduction in a register";
  case Kind::Any:
    break;
  }
  return "a value";
}

/// Rejects an unknown `tai.*` name, and suggests known ones.
static LogicalResult refuseUnknown(Operation *op, StringRef name) {
  if (name == "tai.modes")
    return op->emitError("'")
           << name << "' stands on kernels, not on '" << op->getName()
           << "', where it would say nothing";
  constexpr unsigned farthest = 4;
  InFlightDiagnostic diag = op->emitError()
                            << "there is no attribute '" << name << "'";
  StringRef closest;
  unsigned least = farthest;
  for (const KnownAttr &known : kKnown) {
    unsigned distance = name.edit_distance(known.name, true, least);
    if (distance < least) {
      least = distance;
      closest = known.name;
    }
  }
  if (!closest.empty())
    diag << "; did you mean '" << closest << "'?";
  return diag;
}

/// Verifies that a function with `tai.differentiate` can have a gradient.
static LogicalResult verifyDifferentiate(Operation *op) {
  StringRef name = op->getName().getStringRef();
  auto function = cast<FunctionOpInterface>(op);
  if (function.isExternal())
    return op->emitError("cannot differentiate '@")
           << function.getName() << "', which has no body here";
  // The function of the gradient may have been converted to another dialect
  // since.
  bool isDone = op->hasAttr("tai.adjoint") ||
                isa_and_present<ArrayAttr>(op->getAttr("tai.split")) ||
                op->hasAttr(getFunctionAttrName(op, "tangent"));
  if (!isDone && name != "func.func" && !isa<KernelOp>(op))
    return op->emitError("cannot differentiate a '")
           << name << "'; expects a 'func.func' or a 'tai.kernel'";
  return success();
}

LogicalResult tai::verifyDiscardableAttr(Operation *op,
                                         NamedAttribute attribute) {
  StringRef name = attribute.getName();
  if (isa<KernelOp>(op))
    for (const RenamedAttr &renamed : kRenamed)
      if (renamed.old == name)
        return op->emitError("expects '")
               << renamed.name << "', an attribute of the op itself, where '"
               << name << "' was written";
  const KnownAttr *known = llvm::find_if(
      kKnown, [&](const KnownAttr &entry) { return entry.name == name; });
  if (known == std::end(kKnown))
    return refuseUnknown(op, name);
  if (!isOfKind(attribute.getValue(), known->kind))
    return op->emitError("expects '")
           << name << "' " << (known->kind == Kind::Unit ? "" : "to be ")
           << describe(known->kind) << ", but got " << attribute.getValue();
  if (known->ofFunctions && !isa<FunctionOpInterface>(op))
    return op->emitError("'")
           << name << "' stands on functions and kernels, not on '"
           << op->getName() << "'";
  if (name == "tai.differentiate")
    return verifyDifferentiate(op);
  if (name == "tai.split" && (!isa<UnitAttr, ArrayAttr>(attribute.getValue()) ||
                              !op->hasAttr("tai.differentiate")))
    return op->emitError(
        "'tai.split' stands beside 'tai.differentiate', and is "
        "a unit attribute until the functions are made");
  // `tai.gradients` needs `tai.differentiate`, except on kernels, which have
  // gradients without it.
  if (name == "tai.gradients" && !op->hasAttr("tai.differentiate"))
    return op->emitError(
        "has 'tai.gradients', but not 'tai.differentiate', so that no gradient "
        "would be made; add it, or remove 'tai.gradients'");
  return success();
}

LogicalResult tai::verifyArgumentAttr(Operation *op, unsigned index,
                                      NamedAttribute attribute) {
  if (attribute.getName() != kElementRank)
    return op->emitError("argument ")
           << index << " has an attribute '" << attribute.getName().strref()
           << "', which there is not";
  if (!isa<IntegerAttr>(attribute.getValue()))
    return op->emitError("expects '") << kElementRank << "' to be an integer";
  return success();
}

LogicalResult tai::verifyResultAttr(Operation *op, unsigned index,
                                    NamedAttribute attribute) {
  return op->emitError("result ")
         << index << " has an attribute '" << attribute.getName().strref()
         << "', which there is not";
}
