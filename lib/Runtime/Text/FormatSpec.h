//===- FormatSpec.h - How a number is written -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Python's format specifications for numbers, without the grouping of digits:
//
//   [[fill]align][sign]["#"]["0"][width]["." precision][type]["u"]
//
// The "u" behind it is ours: the bits of a whole number, to which IR gives no
// sign, are those of an unsigned one.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TEXT_FORMATSPEC_H
#define TAI_LIB_RUNTIME_TEXT_FORMATSPEC_H

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace mlir::tai::runtime {

struct FormatSpec {
  char fill = ' ';
  char align = '>'; // One of "<>^=", where '=' pads behind the sign.
  char sign = '-';  // One of "-+ ".
  bool alternate = false;
  int width = 0;
  int precision = -1; // As many digits as the number needs.
  char type = 0;      // One of "bdoxXeEfFgG%", or 0.
  bool isUnsigned = false;

  /// Nothing where the text is no specification.
  static std::optional<FormatSpec> parse(std::string_view text);

  std::string apply(uint64_t magnitude, bool negative) const;
  /// `shortest` is what is written where neither a type nor a precision is
  /// asked for, without a sign.
  std::string apply(double value, const std::string &shortest) const;

private:
  std::string pad(bool negative, std::string prefix,
                  const std::string &digits) const;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TEXT_FORMATSPEC_H
