//===- Format.cpp - Formatting of values ----------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Text/Format.h"
#include "FormatSpec.h"
#include "tai/ABI/Abi.h"
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>

using namespace mlir::tai::runtime;

/// Returns the shortest text that reads back as the same number; for numbers
/// that came from f32, the shortest that reads back as the same f32.
static void appendFloat(std::string &text, double value) {
  if (std::isnan(value)) {
    text += "nan";
    return;
  }
  if (std::isinf(value)) {
    text += value < 0 ? "-inf" : "inf";
    return;
  }
  char digits[64];
  float narrow = static_cast<float>(value);
  std::to_chars_result end =
      static_cast<double>(narrow) == value
          ? std::to_chars(digits, digits + sizeof(digits), narrow)
          : std::to_chars(digits, digits + sizeof(digits), value);
  size_t start = text.size();
  text.append(digits, end.ptr);
  if (text.find_first_of(".e", start) == std::string::npos)
    text += ".0";
}

static void appendValue(std::string &text, int32_t kind, uint64_t slot,
                        const std::optional<FormatSpec> &spec) {
  switch (kind) {
  case TAI_VALUE_I64: {
    bool negative =
        static_cast<int64_t>(slot) < 0 && !(spec && spec->isUnsigned);
    text += spec ? spec->apply(negative ? 0 - slot : slot, negative)
                 : std::to_string(static_cast<int64_t>(slot));
    return;
  }
  case TAI_VALUE_U64:
    text += spec ? spec->apply(slot, false) : std::to_string(slot);
    return;
  case TAI_VALUE_BOOL:
    slot &= 0xff;
    text += spec ? spec->apply(slot != 0, false) : slot ? "true" : "false";
    return;
  case TAI_VALUE_F64: {
    double value;
    std::memcpy(&value, &slot, sizeof(value));
    if (!spec)
      return appendFloat(text, value);
    std::string shortest;
    appendFloat(shortest, std::fabs(value));
    text += spec->apply(value, shortest);
    return;
  }
  }
  text += "?";
}

/// Parses a placeholder of a format, "{}" or "{:...}", at `at`: stores its
/// specification, and returns its number of characters, or 0 if there is no
/// placeholder at `at`.
static size_t parsePlace(const char *at, std::optional<FormatSpec> &spec) {
  spec.reset();
  if (at[0] != '{')
    return 0;
  if (at[1] == '}')
    return 2;
  const char *end = std::strchr(at, '}');
  if (at[1] != ':' || !end)
    return 0;
  spec = FormatSpec::parse(std::string_view(at + 2, end - at - 2));
  return spec ? end - at + 1 : 0;
}

std::string mlir::tai::runtime::formatValues(const char *format, int32_t count,
                                             const int32_t *kinds,
                                             const int32_t *shapes,
                                             const uint64_t *slots) {
  std::string text;
  int32_t next = 0;
  std::optional<FormatSpec> spec;
  auto appendNext = [&] {
    int32_t components = shapes ? shapes[next] : 1;
    if (components != 1)
      text += '[';
    for (int32_t c = 0; c < components; ++c) {
      if (c)
        text += ", ";
      appendValue(text, kinds[next], *slots++, spec);
    }
    if (components != 1)
      text += ']';
    ++next;
  };
  for (const char *at = format ? format : ""; *at;) {
    size_t size = next < count ? parsePlace(at, spec) : 0;
    if (size)
      appendNext();
    else
      text += *at;
    at += std::max<size_t>(size, 1);
  }
  spec.reset();
  // Values beyond the last placeholder of the format are appended.
  while (next < count) {
    if (!text.empty())
      text += ' ';
    appendNext();
  }
  return text;
}

std::string mlir::tai::runtime::endPrinted(std::string text) {
  if (!text.empty() && text.back() == TAI_SAME_LINE)
    text.pop_back();
  else
    text += '\n';
  return text;
}

std::string mlir::tai::runtime::formatBytes(int64_t bytes) {
  const char *units[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
  double value = static_cast<double>(bytes);
  int unit = 0;
  for (; value >= 1024 && unit < 6; ++unit)
    value /= 1024;
  char text[32];
  std::snprintf(text, sizeof(text), unit ? "%.1f %s" : "%.0f %s", value,
                units[unit]);
  return text;
}
