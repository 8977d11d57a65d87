//===- FormatSpec.h - Format specifications of numbers ----------*- C++ -*-===//
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
// The suffix "u" is an extension: an integer, which is signless in the IR, is
// printed as unsigned.
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
  char align = '>'; // One of "<>^=", where '=' pads after the sign.
  char sign = '-';  // One of "-+ ".
  bool alternate = false;
  int width = 0;
  int precision = -1; // -1: all digits of the number.
  char type = 0;      // One of "bdoxXeEfFgG%", or 0.
  bool isUnsigned = false;

  /// Parses the specification of a placeholder. Returns no value if the text is
  /// not one.
  static std::optional<FormatSpec> parse(std::string_view text);

  std::string apply(uint64_t magnitude, bool negative) const;
  /// Formats a number. `shortest`: the text, without sign, to use if neither
  /// type nor precision is given.
  std::string apply(double value, const std::string &shortest) const;

private:
  std::string pad(bool negative, std::string prefix,
                  const std::string &digits) const;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TEXT_FORMATSPEC_H
