//===- StoresFirst.cpp - Adjoints that a kernel may store first -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/StoresFirst.h"
#include "mlir/IR/Builders.h"
#include "mlir/IR/Operation.h"

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kPassthrough = "passthrough";

void tai::setStoresFirst(Operation *function, ArrayAttr fields) {
  Builder builder(function->getContext());
  std::string names;
  for (auto name : fields.getAsRange<StringAttr>())
    names += (names.empty() ? "" : ",") + name.str();
  SmallVector<Attribute> entries;
  if (auto others = function->getAttrOfType<ArrayAttr>(kPassthrough))
    llvm::append_range(entries, others);
  entries.push_back(builder.getStrArrayAttr({kStoresFirst, names}));
  function->setAttr(kPassthrough, builder.getArrayAttr(entries));
}

std::vector<std::string> tai::getStoresFirst(Operation *function) {
  std::vector<std::string> fields;
  auto entries = function->getAttrOfType<ArrayAttr>(kPassthrough);
  for (Attribute entry : entries ? entries.getValue() : ArrayRef<Attribute>()) {
    auto pair = dyn_cast<ArrayAttr>(entry);
    if (!pair || pair.size() != 2 ||
        cast<StringAttr>(pair[0]).getValue() != kStoresFirst)
      continue;
    SmallVector<StringRef> names;
    cast<StringAttr>(pair[1]).getValue().split(names, ',');
    for (StringRef name : names)
      fields.push_back(name.str());
  }
  return fields;
}
