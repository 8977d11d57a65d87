//===- FormerNames.cpp - Former names of passes ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A renamed pass is still found by its former name for one release, with the
// same options, and prints a note on the standard error.
//
//===----------------------------------------------------------------------===//

#include "FormerNames.h"
#include "mlir/Pass/PassRegistry.h"
#include "llvm/Support/raw_ostream.h"

using namespace mlir;

namespace {
struct FormerName {
  StringLiteral former, name;
};
} // namespace

static constexpr FormerName kFormerNames[] = {
    {"tai-forward-stores", "tai-promote-elements"},
    {"tai-gather-accumulations", "tai-scatter-to-gather"},
    {"tai-split-interior", "tai-version-interior"},
    {"tai-split-loops", "tai-split-index-sets"},
    {"tai-spread-accumulations", "tai-reroll-accumulations"},
    {"tai-strip-loops", "tai-coarsen-threads"},
};

/// Names that others may expect, by the effect of a pass; not deprecated.
static constexpr FormerName kSynonyms[] = {
    {"convert-tai-to-host", "convert-tai-to-scf"},
};

static void add(const FormerName &entry, bool isDeprecated) {
  auto build = [entry, isDeprecated](
                   OpPassManager &pm, StringRef options,
                   function_ref<LogicalResult(const Twine &)> errorHandler) {
    const PassInfo *pass = PassInfo::lookup(entry.name);
    if (!pass)
      return errorHandler("the pass '" + entry.name + "' is not registered");
    if (isDeprecated)
      llvm::errs() << "note: the pass '" << entry.former << "' is called '"
                   << entry.name << "' now\n";
    return pass->addToPipeline(pm, options, errorHandler);
  };
  registerPassPipeline(
      entry.former,
      (isDeprecated ? "The former name of " : "Another name of ") +
          entry.name.str(),
      build, [](function_ref<void(const detail::PassOptions &)>) {});
}

void tai::registerFormerNames() {
  for (const FormerName &entry : kFormerNames)
    add(entry, /*isDeprecated=*/true);
  for (const FormerName &entry : kSynonyms)
    add(entry, /*isDeprecated=*/false);
}
