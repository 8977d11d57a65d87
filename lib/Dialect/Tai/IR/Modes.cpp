//===- Modes.cpp - What a kernel says of its numbers ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/Modes.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "llvm/ADT/StringSwitch.h"

using namespace mlir;
using namespace mlir::tai;

static std::optional<Precision> parsePrecision(StringRef text) {
  return llvm::StringSwitch<std::optional<Precision>>(text)
      .Case("default", Precision::Default)
      .Case("f64", Precision::F64)
      .Case("f32", Precision::F32)
      .Case("f16", Precision::F16)
      .Case("bf16", Precision::BF16)
      .Default(std::nullopt);
}

static std::optional<SumsMode> parseSumsMode(StringRef text) {
  return llvm::StringSwitch<std::optional<SumsMode>>(text)
      .Case("default", SumsMode::Default)
      .Case("compensated", SumsMode::Compensated)
      .Case("deterministic", SumsMode::Deterministic)
      .Default(std::nullopt);
}

static std::optional<MathMode> parseMathMode(StringRef text) {
  return llvm::StringSwitch<std::optional<MathMode>>(text)
      .Case("default", MathMode::Default)
      .Case("fast", MathMode::Fast)
      .Case("strict", MathMode::Strict)
      .Case("accurate", MathMode::Accurate)
      .Default(std::nullopt);
}

static std::optional<StringRef> getWord(Attribute attr) {
  auto word = dyn_cast_if_present<StringAttr>(attr);
  return word ? std::optional(word.getValue()) : std::nullopt;
}

/// A kernel stores nothing by itself: it cannot have the types of storage.
static std::optional<Precision> parseOwnPrecision(StringRef word) {
  std::optional<Precision> found = parsePrecision(word);
  bool isStorage = found == Precision::F16 || found == Precision::BF16;
  return isStorage ? std::nullopt : found;
}

Modes Modes::of(Operation *op) {
  Modes result;
  auto function = dyn_cast<FunctionOpInterface>(op);
  if (!function)
    function = op->getParentOfType<FunctionOpInterface>();
  if (!function)
    return result;
  auto chosen = function->getAttrOfType<DictionaryAttr>(kModesAttrName);
  if (!chosen)
    return result;
  if (auto word = getWord(chosen.get("precision")))
    result.precision = parseOwnPrecision(*word);
  if (auto word = getWord(chosen.get("sums")))
    result.sums = parseSumsMode(*word);
  if (auto word = getWord(chosen.get("math")))
    result.math = parseMathMode(*word);
  if (auto on = chosen.getAs<BoolAttr>("ftz"))
    result.ftz = on.getValue();
  return result;
}

bool Modes::isDeterministic(bool otherwise) const {
  if (!sums || sums == SumsMode::Compensated)
    return otherwise;
  return sums == SumsMode::Deterministic;
}

LogicalResult tai::verifyModes(Operation *op, Attribute modes) {
  auto chosen = dyn_cast<DictionaryAttr>(modes);
  if (!chosen)
    return op->emitError("'")
           << kModesAttrName << "' is a dictionary, but got " << modes;
  for (NamedAttribute entry : chosen) {
    StringRef name = entry.getName();
    std::optional<StringRef> word = getWord(entry.getValue());
    bool isGood = name == "ftz" && isa<BoolAttr>(entry.getValue());
    if (word)
      isGood = (name == "precision" && parseOwnPrecision(*word)) ||
               (name == "sums" && parseSumsMode(*word)) ||
               (name == "math" && parseMathMode(*word));
    if (!isGood)
      return op->emitError()
             << "there is no mode '" << name << " = " << entry.getValue()
             << "'; there are 'precision = \"f64\"' and '\"f32\"', 'sums = "
                "\"compensated\"' and '\"deterministic\"', 'math = \"fast\"', "
                "'\"strict\"' and '\"accurate\"', '\"default\"' of each, and "
                "'ftz = true' and 'false'";
  }
  return success();
}
