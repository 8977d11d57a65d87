//===- StripAttributes.h - Drops discardable attributes ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Any pass may drop discardable attributes, so no result may depend on them.
// Tests drop all `tai.*` attributes before each pass (TAI_STRIP_ATTRIBUTES=1).
// To find the attribute that matters, list names:
// TAI_STRIP_ATTRIBUTES=tai.active,tai.tiles drops only these.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_EXECUTIONENGINE_REPRODUCE_STRIPATTRIBUTES_H
#define TAI_EXECUTIONENGINE_REPRODUCE_STRIPATTRIBUTES_H

#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Pass/PassManager.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/ADT/StringSet.h"
#include <cstdlib>

namespace mlir::tai {

/// Drops discardable `tai.*` attributes of ops of any dialect before each pass,
/// to test that results do not depend on them.
class StripAttributes : public PassInstrumentation {
public:
  /// Drops the attributes in `names`, separated by commas; any other text
  /// stands for all attributes.
  explicit StripAttributes(StringRef names) {
    for (StringRef name : llvm::split(names, ','))
      if (name.starts_with("tai."))
        wanted.insert(name);
  }

  void runBeforePass(Pass *, Operation *root) override {
    root->walk([this](Operation *op) {
      for (NamedAttribute attribute :
           llvm::to_vector(op->getDiscardableAttrs()))
        if (isWanted(attribute.getName()))
          op->removeDiscardableAttr(attribute.getName());
    });
  }

  /// Adds the instrumentation to a pass manager if TAI_STRIP_ATTRIBUTES is set.
  static void addIfWanted(PassManager &manager) {
    if (const char *names = std::getenv("TAI_STRIP_ATTRIBUTES"))
      manager.addInstrumentation(std::make_unique<StripAttributes>(names));
  }

private:
  bool isWanted(StringRef name) const {
    return name.starts_with("tai.") &&
           (wanted.empty() || wanted.contains(name));
  }

  llvm::StringSet<> wanted;
};

} // namespace mlir::tai

#endif // TAI_EXECUTIONENGINE_REPRODUCE_STRIPATTRIBUTES_H
