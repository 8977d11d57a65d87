//===- TangentFlows.h - Lost tangents in forward mode -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Forward mode has no tape: the loss of tangents is detected at each launch.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_LAUNCH_TANGENTFLOWS_H
#define TAI_LIB_RUNTIME_LAUNCH_TANGENTFLOWS_H

#include "tai/Runtime/Host/HostWrites.h"
#include "tai/Runtime/Launch/FlowTracker.h"
#include <mutex>

namespace mlir::tai::runtime {

class TangentFlows final : public OverwriteWatcher {
public:
  TangentFlows(const std::vector<FieldPtr> &fields,
               const std::vector<FieldPtr> &inputs);

  void launch(Kernel &kernel, const uint64_t *args);
  void overwrite(const Field &field) override;
  /// Returns a line for each cut in the derivatives of `outputs` whose name is
  /// not in `said` yet, and adds the names to `said`.
  std::vector<std::string> describe(const std::vector<FieldPtr> &outputs,
                                    std::unordered_set<std::string> &said);

private:
  /// Guards the tracker of tangents, since several threads may launch at once.
  std::mutex mutex;
  FlowTracker tracker;
  bool hasLaunched = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_LAUNCH_TANGENTFLOWS_H
