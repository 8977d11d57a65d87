//===- AccessChecks.h - Checked accesses under a tape -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs the launches of a tape with instrumented kernels that check the global
// data access rules, and collects violations.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_ACCESSCHECKS_H
#define TAI_RUNTIME_LAUNCH_ACCESSCHECKS_H

#include "tai/ABI/AccessLog.h"
#include "tai/Runtime/Launch/Kernel.h"
#include <unordered_map>
#include <utility>

namespace mlir::tai::runtime {

class Runtime;

struct Launch;

/// An access of a checked kernel, with its source location.
struct CheckedAccess {
  Field *field;
  AccessKind kind;
  std::string file;
  int64_t line = 0, column = 0;
};

/// The variant of a kernel that checks the data access rules at run time, with
/// the accesses and fields that it reports on.
struct CheckedKernel {
  KernelPtr kernel;
  /// The fields whose shadow arrays are additional arguments of `kernel`.
  std::vector<FieldPtr> fields;
  std::vector<CheckedAccess> accesses;
};

/// The position of an access: the launch, numbered among checked launches, and
/// the source location.
struct AccessPlace {
  std::string kernel;
  int64_t launch;
  AccessKind kind;
  std::string file;
  int64_t line, column;
};

struct Violation {
  accesslog::ViolationKind kind;
  std::string field;
  std::vector<int64_t> indices;
  /// Row-major number of the component within its element, or -1 for fields of
  /// scalars.
  int64_t component;
  AccessPlace access, earlier;
};

class AccessChecks {
public:
  /// Creates a checker that keeps the first `limit` violations; with
  /// `racesOnly`, it ignores violations other than races.
  AccessChecks(Runtime &runtime, int64_t limit, bool racesOnly)
      : runtime(runtime), limit(limit), racesOnly(racesOnly) {}

  /// Launches the variant of `kernel` that logs its accesses, instead of
  /// `kernel` itself, and reads the access log of the launch.
  Status run(Launch &launch, Kernel &kernel, const uint64_t *args,
             uint64_t *results, uint64_t number);

  const std::vector<Violation> &violations() const { return found; }
  /// The number of violations found, including violations beyond the limit,
  /// which are not kept.
  int64_t numViolations() const { return total; }

private:
  /// The range of access numbers that a checked launch uses; it starts at
  /// `base`.
  struct Range {
    int64_t base;
    const CheckedKernel *kernel;
    int64_t launch;
  };

  /// Shadow words of a field's components, initially zero. Pages are committed
  /// by the system on first write, because a sparse field may span far more
  /// elements than are active.
  struct Shadow {
    Shadow() = default;
    Shadow(Shadow &&other) noexcept
        : words(std::exchange(other.words, nullptr)), count(other.count) {}
    Shadow &operator=(Shadow &&) = delete;
    ~Shadow();
    int32_t *words = nullptr;
    size_t count = 0;
  };
  Status findShadow(Field &field, const Shadow *&shadow);
  void collect(const Range &range);
  AccessPlace getPlace(int64_t id) const;

  Runtime &runtime;
  int64_t limit;
  bool racesOnly;
  int64_t total = 0;
  int64_t nextBase = 0;
  std::unordered_map<Field *, Shadow> shadows;
  std::vector<Range> ranges;
  std::vector<int64_t> log;
  std::vector<uint64_t> slots;
  std::vector<Violation> found;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_ACCESSCHECKS_H
