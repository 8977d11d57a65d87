//===- Status.h - Success, or a failure with its message --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The runtime is built without exceptions and without LLVM, so that it can
// stand below both compiled code and a C API. A status is one pointer, null on
// success: returning one costs a launch nothing.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_STATUS_H
#define TAI_SUPPORT_STATUS_H

#include <memory>
#include <string>
#include <utility>

namespace mlir::tai::runtime {

/// The kind of a failure of the runtime. 1 to 4 are the numbers of TaiFailure
/// in Abi.h.
enum class StatusCode {
  Ok = 0,
  Assert = 1,
  Index = 2,
  Memory = 3,
  Check = 4,
  /// A launch was stopped by Runtime::interrupt().
  Interrupted = 5,
  /// The caller made an invalid call: wrong arguments, or not allowed in this
  /// state.
  Usage = 6,
  /// The KernelProvider could not compile a kernel or make its adjoint.
  Compile = 7,
  /// A kernel returned non-zero without reporting a failure.
  Internal = 8
};

class [[nodiscard]] Status {
public:
  Status() = default;

  static Status success() { return Status(); }
  static Status failure(StatusCode code, std::string message,
                        std::string where = "", int detail = 0) {
    Status status;
    status.info = std::make_unique<Info>(
        Info{code, detail, std::move(message), std::move(where)});
    return status;
  }

  bool ok() const { return !info; }
  explicit operator bool() const { return ok(); }

  StatusCode code() const { return info ? info->code : StatusCode::Ok; }
  const std::string &message() const {
    static const std::string empty;
    return info ? info->message : empty;
  }
  /// "file:line:col", or empty.
  const std::string &where() const {
    static const std::string empty;
    return info ? info->where : empty;
  }
  /// A number that the KernelProvider gave the failure; see FailureLog.
  int detail() const { return info ? info->detail : 0; }

private:
  struct Info {
    StatusCode code;
    int detail;
    std::string message;
    std::string where;
  };
  std::unique_ptr<Info> info;
};

} // namespace mlir::tai::runtime

#endif // TAI_SUPPORT_STATUS_H
