//===- FormatSpec.cpp - Format specifications of numbers ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "FormatSpec.h"
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

using namespace mlir::tai::runtime;

// The maximum width and precision of a placeholder: larger ones are of no use
// and take memory.
static constexpr int kMost = 1000;

static bool isOneOf(char c, std::string_view those) {
  return c && those.find(c) != std::string_view::npos;
}

/// Reads the digits of a number from the front of `text`; returns false if the
/// number is too large for a format.
static bool parseNumber(std::string_view &text, int &number) {
  number = 0;
  while (!text.empty() && text[0] >= '0' && text[0] <= '9') {
    number = number * 10 + (text[0] - '0');
    if (number > kMost)
      return false;
    text.remove_prefix(1);
  }
  return true;
}

std::optional<FormatSpec> FormatSpec::parse(std::string_view text) {
  FormatSpec spec;
  auto take = [&](std::string_view those) {
    if (text.empty() || !isOneOf(text[0], those))
      return '\0';
    char taken = text[0];
    text.remove_prefix(1);
    return taken;
  };
  bool aligned = true, filled = false;
  if (text.size() > 1 && isOneOf(text[1], "<>^=")) {
    spec.fill = text[0];
    spec.align = text[1];
    text.remove_prefix(2);
    filled = true;
  } else if (char align = take("<>^=")) {
    spec.align = align;
  } else {
    aligned = false;
  }
  if (char sign = take("-+ "))
    spec.sign = sign;
  spec.alternate = take("#");
  if (take("0")) {
    if (!filled)
      spec.fill = '0';
    if (!aligned)
      spec.align = '=';
  }
  if (!parseNumber(text, spec.width))
    return std::nullopt;
  if (take(".")) {
    size_t before = text.size();
    if (!parseNumber(text, spec.precision) || text.size() == before)
      return std::nullopt;
  }
  spec.type = take("bdoxXeEfFgG%");
  spec.isUnsigned = take("u");
  if (!text.empty())
    return std::nullopt;
  return spec;
}

std::string FormatSpec::pad(bool negative, std::string prefix,
                            const std::string &digits) const {
  if (negative)
    prefix.insert(prefix.begin(), '-');
  else if (sign != '-')
    prefix.insert(prefix.begin(), sign);
  size_t size = prefix.size() + digits.size();
  size_t missing = std::max<int64_t>(0, width - static_cast<int64_t>(size));
  if (align == '=')
    return prefix + std::string(missing, fill) + digits;
  size_t left = align == '<' ? 0 : align == '^' ? missing / 2 : missing;
  return std::string(left, fill) + prefix + digits +
         std::string(missing - left, fill);
}

std::string FormatSpec::apply(uint64_t magnitude, bool negative) const {
  if (isOneOf(type, "eEfFgG%") || precision >= 0) {
    double value = static_cast<double>(magnitude);
    return apply(negative ? -value : value, std::to_string(magnitude));
  }
  unsigned base = type == 'b'           ? 2
                  : type == 'o'         ? 8
                  : isOneOf(type, "xX") ? 16
                                        : 10;
  const char *names = type == 'X' ? "0123456789ABCDEF" : "0123456789abcdef";
  std::string digits;
  do {
    digits += names[magnitude % base];
    magnitude /= base;
  } while (magnitude);
  std::reverse(digits.begin(), digits.end());
  std::string prefix;
  if (alternate && base != 10)
    prefix = {'0', type};
  return pad(negative, prefix, digits);
}

/// Prints a number with "%e", "%f" or "%g".
static std::string print(char kind, bool alternate, int precision,
                         double value) {
  std::string pattern = alternate ? "%#.*" : "%.*";
  pattern += kind;
  int size = std::snprintf(nullptr, 0, pattern.c_str(), precision, value);
  std::vector<char> text(static_cast<size_t>(size) + 1);
  std::snprintf(text.data(), text.size(), pattern.c_str(), precision, value);
  return text.data();
}

/// Formats with a precision and without a type: as "g", but with a digit after
/// the point, and with an exponent if the precision leaves no room for this
/// digit.
static std::string printGeneral(bool alternate, int precision, double value) {
  precision = std::max(precision, 1);
  std::string scientific = print('e', false, precision - 1, value);
  size_t mark = scientific.find('e');
  int exponent = std::stoi(scientific.substr(mark + 1));
  if (exponent >= -4 && exponent < precision - 1) {
    std::string text = print('g', alternate, precision, value);
    return text.find('.') == std::string::npos ? text + ".0" : text;
  }
  if (alternate)
    return print('e', true, precision - 1, value);
  std::string digits = scientific.substr(0, mark);
  if (digits.find('.') != std::string::npos) {
    digits.erase(digits.find_last_not_of('0') + 1);
    if (digits.back() == '.')
      digits.pop_back();
  }
  return digits + scientific.substr(mark);
}

std::string FormatSpec::apply(double value, const std::string &shortest) const {
  bool negative = std::signbit(value) && !std::isnan(value);
  double magnitude = std::fabs(value);
  std::string unit = type == '%' ? "%" : "";
  if (!std::isfinite(value)) {
    bool capital = isOneOf(type, "EFG");
    std::string name = std::isnan(value) ? capital ? "NAN" : "nan"
                       : capital         ? "INF"
                                         : "inf";
    return pad(negative, "", name + unit);
  }
  if (type == '%')
    magnitude *= 100;
  if (isOneOf(type, "eEfFgG%"))
    return pad(negative, "",
               print(type == '%' ? 'f' : type, alternate,
                     precision < 0 ? 6 : precision, magnitude) +
                   unit);
  if (precision < 0) {
    std::string text = shortest;
    if (alternate && text.find('.') == std::string::npos)
      text.insert(std::min(text.find('e'), text.size()), ".");
    return pad(negative, "", text);
  }
  return pad(negative, "", printGeneral(alternate, precision, magnitude));
}
