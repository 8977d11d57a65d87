//===- VersionRemarks.h - Remarks on versions of loops ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The remarks by which `kernel.explain()` and `tape.explain()` list versions.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_TRANSFORMS_LOOPS_VERSIONREMARKS_H
#define TAI_LIB_TRANSFORMS_LOOPS_VERSIONREMARKS_H

#include "mlir/IR/Remarks.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {

/// Says in a remark that a loop gets versions for certain values of the launch,
/// or, with a reason, that it gets none.
inline void reportVersions(ParallelForOp loop, StringRef values,
                           const Twine &reason = "") {
  if (!loop.getContext()->getRemarkEngine())
    return;
  std::string why = reason.str();
  auto function = loop->getParentOfType<FunctionOpInterface>();
  auto options = remark::RemarkOpts::name(why.empty() ? "versions" : "none")
                     .category("tai-versions")
                     .function(function.getName());
  if (why.empty())
    remark::passed(loop.getLoc(), options)
        << remark::metric("Values", values.str());
  else
    remark::missed(loop.getLoc(), options)
        << remark::metric("Values", values.str())
        << remark::metric("Reason", why);
}

} // namespace mlir::tai

#endif // TAI_LIB_TRANSFORMS_LOOPS_VERSIONREMARKS_H
