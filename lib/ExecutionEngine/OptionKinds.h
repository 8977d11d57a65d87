//===- OptionKinds.h - Texts of options, read -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The kinds of Options.def: what they are in C++, and how a text becomes one.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_EXECUTIONENGINE_OPTIONKINDS_H
#define TAI_LIB_EXECUTIONENGINE_OPTIONKINDS_H

#include "tai/Support/BoundsMode.h"
#include "tai/Support/Skips.h"
#include "llvm/ADT/StringSwitch.h"
#include <optional>
#include <string>

namespace mlir::tai::options {
using llvm::StringRef;

/// A whole number from 0 on, of a type that can hold more.
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

/// In any notation, so that it can be a mask.
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

/// Whether there is one: AddressSanitizer is all there is.
struct Sanitizer {
  using Type = bool;
  static std::optional<bool> parse(StringRef text) {
    return llvm::StringSwitch<std::optional<bool>>(text)
        .Case("", false)
        .Case("address", true)
        .Default(std::nullopt);
  }
};

/// As it is: whoever sets it says what is wrong with it.
struct Text {
  using Type = StringRef;
  static std::optional<Type> parse(StringRef text) { return text; }
};

/// The same: what is wrong with a list of skips names the skips.
struct Skips : Text {};

} // namespace mlir::tai::options

#endif // TAI_LIB_EXECUTIONENGINE_OPTIONKINDS_H
