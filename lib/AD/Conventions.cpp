//===- Conventions.cpp - Choices of derivatives at kinks ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Conventions.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

static constexpr llvm::StringLiteral kAttribute = "conventions";

static bool isString(Attribute attr, StringRef text) {
  auto string = dyn_cast<StringAttr>(attr);
  return string && string.getValue() == text;
}

Conventions Conventions::of(Operation *op) {
  Conventions result;
  auto function = dyn_cast<FunctionOpInterface>(op);
  if (!function)
    function = op->getParentOfType<FunctionOpInterface>();
  auto chosen = function->getAttrOfType<DictionaryAttr>(
      getFunctionAttrName(function, kAttribute));
  if (!chosen)
    return result;
  if (Attribute ties = chosen.get("ties"))
    result.splitTies = isString(ties, "split");
  if (Attribute arcs = chosen.get("arcs"))
    result.clampArcs = isString(arcs, "clamp");
  if (auto guards = chosen.getAs<BoolAttr>("guards"))
    result.guards = guards.getValue();
  return result;
}

LogicalResult Conventions::verify(Operation *function) {
  StringAttr attribute = getFunctionAttrName(function, kAttribute);
  Attribute attr = function->getAttr(attribute);
  if (!attr)
    return success();
  auto chosen = dyn_cast<DictionaryAttr>(attr);
  if (!chosen)
    return function->emitError() << "'" << attribute.strref()
                                 << "' is a dictionary, but got " << attr;
  for (NamedAttribute entry : chosen) {
    StringRef name = entry.getName();
    Attribute value = entry.getValue();
    bool good = name == "ties"   ? isString(value, "split")
                : name == "arcs" ? isString(value, "clamp")
                                 : name == "guards" && isa<BoolAttr>(value);
    if (!good)
      return function->emitError()
             << "'" << attribute.strref() << "' has no choice '" << name
             << " = " << value
             << "'; there are 'ties = \"split\"', 'arcs = \"clamp\"' and "
                "'guards = false'";
  }
  return success();
}
