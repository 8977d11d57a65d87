//===- StripAttributes.h - Passes that must not rely on them ----*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Any pass may drop discardable attributes. Tests ask for the worst: that all
// those of tai are dropped in front of each pass.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_STRIPATTRIBUTES_H
#define TAI_LIB_EXECUTIONENGINE_STRIPATTRIBUTES_H

#include "mlir/Pass/PassInstrumentation.h"
#include "mlir/Pass/PassManager.h"
#include <cstdlib>

namespace mlir::tai {

/// Drops what passes have noted on ops of any dialect.
class StripAttributes : public PassInstrumentation {
public:
  void runBeforePass(Pass *, Operation *root) override {
    root->walk([](Operation *op) {
      for (NamedAttribute attribute :
           llvm::to_vector(op->getDiscardableAttrs()))
        if (attribute.getName().strref().starts_with("tai."))
          op->removeDiscardableAttr(attribute.getName());
    });
  }

  /// Where the environment variable TAI_STRIP_ATTRIBUTES is set.
  static void addIfWanted(PassManager &manager) {
    if (std::getenv("TAI_STRIP_ATTRIBUTES"))
      manager.addInstrumentation(std::make_unique<StripAttributes>());
  }
};

} // namespace mlir::tai

#endif // TAI_LIB_EXECUTIONENGINE_STRIPATTRIBUTES_H
