//===- OptionKinds.h - Parsers of option values -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The kinds of options in Options.def: their C++ types, and how they are
// parsed.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_SESSION_OPTIONKINDS_H
#define TAI_LIB_EXECUTIONENGINE_SESSION_OPTIONKINDS_H

#include "tai/Support/BoundsMode.h"
#include "tai/Support/Skips.h"
#include "llvm/ADT/StringSwitch.h"
#include <optional>
#include <string>

namespace mlir::tai::options {
using llvm::StringRef;

/// An option whose value is a non-negative integer of a signed type.
template <typename Number> struct WholeNumber {
  using Type = Number;
  static std::optional<Type> parse(StringRef text) {
    Type value;
    if (text.getAsInteger(10, value) || value < Type(0))
      return std::nullopt;
    return value;
  }
};

struct Count : WholeNumber<int> {};
struct Bytes : WholeNumber<int64_t> {};

struct Switch {
  using Type = bool;
  static std::optional<bool> parse(StringRef text) {
    return llvm::StringSwitch<std::optional<bool>>(text)
        .Cases({"true", "1", "on"}, true)
        .Cases({"false", "0", "off"}, false)
        .Default(std::nullopt);
  }
};

struct Level {
  using Type = unsigned;
  static std::optional<Type> parse(StringRef text) {
    Type level;
    if (text.getAsInteger(10, level) || level > 3)
      return std::nullopt;
    return level;
  }
};

struct BlockThreads {
  using Type = int;
  static std::optional<int> parse(StringRef text) {
    std::optional<int> threads = Count::parse(text);
    return threads && *threads % 32 == 0 ? threads : std::nullopt;
  }
};

/// An option whose value is an integer in any C notation (0x…, 0b…), so that it
/// can be a mask.
struct Seed {
  using Type = uint64_t;
  static std::optional<Type> parse(StringRef text) {
    Type seed;
    if (text.getAsInteger(0, seed))
      return std::nullopt;
    return seed;
  }
};

struct Bounds {
  using Type = BoundsMode;
  static std::optional<Type> parse(StringRef text) {
    return llvm::StringSwitch<std::optional<Type>>(text)
        .Case("off", BoundsMode::Off)
        .Case("clamp", BoundsMode::Clamp)
        .Case("check", BoundsMode::Check)
        .Default(std::nullopt);
  }
};

/// An option that says whether a sanitizer is used; AddressSanitizer is the
/// only choice.
struct Sanitizer {
  using Type = bool;
  static std::optional<bool> parse(StringRef text) {
    return llvm::StringSwitch<std::optional<bool>>(text)
        .Case("", false)
        .Case("address", true)
        .Default(std::nullopt);
  }
};

/// An option whose value is any text, which the option's setter checks.
struct Text {
  using Type = StringRef;
  static std::optional<Type> parse(StringRef text) { return text; }
};

/// An option whose value is a set of skips (optimisations that leave out
/// unneeded work). Any text is accepted; the option's setter parses it, and its
/// error message lists the names of skips.
struct Skips : Text {};

} // namespace mlir::tai::options

#endif // TAI_LIB_EXECUTIONENGINE_SESSION_OPTIONKINDS_H
