//===- Modes.cpp - Numeric modes of a kernel ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/Modes.h"
#include "mlir/IR/Builders.h"
#include "mlir/Interfaces/FunctionInterfaces.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

/// Name of an attribute of LLVM dialect functions: a list of names, and of
/// pairs of a name and a value, that become attributes of the LLVM function.
static constexpr StringLiteral kPassthrough = "passthrough";
static constexpr StringLiteral kPassedName = "tai.modes";

//===----------------------------------------------------------------------===//
// Words
//===----------------------------------------------------------------------===//

namespace {
template <typename T> struct Word {
  StringLiteral text;
  T value;
};
} // namespace

// Types that exist only in storage, such as f16, are no precisions of kernels,
// because a kernel allocates no storage.
static constexpr Word<Precision> kPrecisions[] = {
    {"default", Precision::Default},
    {"f64", Precision::F64},
    {"f32", Precision::F32},
};
static constexpr Word<SumsMode> kSums[] = {
    {"default", SumsMode::Default},
    {"compensated", SumsMode::Compensated},
    {"deterministic", SumsMode::Deterministic},
    {"compensated+deterministic", SumsMode::Both},
};
static constexpr Word<MathMode> kMath[] = {
    {"default", MathMode::Default},
    {"fast", MathMode::Fast},
    {"strict", MathMode::Strict},
    {"accurate", MathMode::Accurate},
};
static constexpr Word<bool> kSwitch[] = {{"false", false}, {"true", true}};

/// Calls `visit` with the name of each mode, its value in `modes`, and the
/// words that it can have.
template <typename ModesT, typename Visitor>
static void forEachMode(ModesT &modes, Visitor visit) {
  visit(StringRef("precision"), modes.precision, ArrayRef(kPrecisions));
  visit(StringRef("sums"), modes.sums, ArrayRef(kSums));
  visit(StringRef("math"), modes.math, ArrayRef(kMath));
  visit(StringRef("ftz"), modes.ftz, ArrayRef(kSwitch));
}

/// Sets the mode `name` to the word `text`. False if there is no such mode, or
/// the mode has no such word.
static bool readWord(Modes &modes, StringRef name, StringRef text) {
  bool isRead = false;
  forEachMode(modes, [&](StringRef mode, auto &value, auto words) {
    const auto *word =
        llvm::find_if(words, [&](const auto &w) { return w.text == text; });
    if (mode != name || word == words.end())
      return;
    value = word->value;
    isRead = true;
  });
  return isRead;
}

/// Lists, for each mode that is set in `modes`, its name and its word.
static SmallVector<std::pair<StringRef, StringRef>>
getWords(const Modes &modes) {
  SmallVector<std::pair<StringRef, StringRef>> result;
  forEachMode(modes, [&](StringRef mode, const auto &value, auto words) {
    for (const auto &word : words)
      if (value == word.value)
        result.emplace_back(mode, word.text);
  });
  return result;
}

//===----------------------------------------------------------------------===//
// On kernels
//===----------------------------------------------------------------------===//

/// Returns the word of a mode's attribute `entry`; none if the attribute does
/// not have the type that the mode requires, a boolean or a string.
static std::optional<StringRef> getText(NamedAttribute entry) {
  bool isSwitch = entry.getName() == "ftz";
  if (auto on = dyn_cast<BoolAttr>(entry.getValue()); on && isSwitch)
    return on.getValue() ? "true" : "false";
  if (auto text = dyn_cast<StringAttr>(entry.getValue()); text && !isSwitch)
    return text.getValue();
  return std::nullopt;
}

static Modes readModes(DictionaryAttr chosen) {
  Modes result;
  if (!chosen)
    return result;
  for (NamedAttribute entry : chosen)
    if (std::optional<StringRef> text = getText(entry))
      readWord(result, entry.getName(), *text);
  return result;
}

static InFlightDiagnostic emitUnknownMode(Operation *op) {
  return op->emitError("there is no mode '");
}

static LogicalResult finish(InFlightDiagnostic &&diag) {
  return diag << "'; there are 'precision = \"f64\"' and '\"f32\"', 'sums = "
                 "\"compensated\"' and '\"deterministic\"', 'math = "
                 "\"fast\"', '\"strict\"' and '\"accurate\"', "
                 "'\"default\"' of each, and 'ftz = true' and 'false'";
}

LogicalResult tai::verifyModes(Operation *kernel, DictionaryAttr modes) {
  Modes ignored;
  for (NamedAttribute entry : modes) {
    std::optional<StringRef> text = getText(entry);
    if (!text || !readWord(ignored, entry.getName(), *text))
      return finish(emitUnknownMode(kernel)
                    << entry.getName().strref() << " = " << entry.getValue());
  }
  return success();
}

//===----------------------------------------------------------------------===//
// Modes of functions of the LLVM dialect
//===----------------------------------------------------------------------===//

/// Returns the value of `tai.modes` in the function's attribute `passthrough`,
/// if present.
static std::optional<StringRef> getPassed(Operation *function) {
  auto entries = function->getAttrOfType<ArrayAttr>(kPassthrough);
  if (!entries)
    return std::nullopt;
  for (Attribute entry : entries) {
    auto pair = dyn_cast<ArrayAttr>(entry);
    if (!pair || pair.size() != 2)
      continue;
    auto name = dyn_cast<StringAttr>(pair[0]);
    auto value = dyn_cast<StringAttr>(pair[1]);
    if (name && value && name.getValue() == kPassedName)
      return value.getValue();
  }
  return std::nullopt;
}

static Modes readPassed(StringRef text) {
  Modes result;
  for (StringRef entry : llvm::split(text, ',')) {
    auto [name, word] = entry.split('=');
    readWord(result, name, word);
  }
  return result;
}

LogicalResult tai::verifyPassedModes(Operation *function) {
  std::optional<StringRef> text = getPassed(function);
  if (!text)
    return success();
  Modes ignored;
  for (StringRef entry : llvm::split(*text, ',')) {
    auto [name, word] = entry.split('=');
    if (!readWord(ignored, name, word))
      return finish(emitUnknownMode(function) << entry);
  }
  return success();
}

static void setPassed(Operation *function, const Modes &modes) {
  Builder builder(function->getContext());
  SmallVector<Attribute> entries;
  if (auto others = function->getAttrOfType<ArrayAttr>(kPassthrough))
    for (Attribute entry : others) {
      auto pair = dyn_cast<ArrayAttr>(entry);
      if (!pair || pair.empty() ||
          pair[0] != builder.getStringAttr(kPassedName))
        entries.push_back(entry);
    }
  std::string text;
  for (auto [name, word] : getWords(modes))
    text += ((text.empty() ? "" : ",") + name + "=" + word).str();
  if (!text.empty())
    entries.push_back(builder.getStrArrayAttr({kPassedName, text}));
  if (entries.empty())
    function->removeAttr(kPassthrough);
  else
    function->setAttr(kPassthrough, builder.getArrayAttr(entries));
}

//===----------------------------------------------------------------------===//
// Modes
//===----------------------------------------------------------------------===//

Modes Modes::of(Operation *op) {
  Operation *function = op;
  if (!isa<FunctionOpInterface>(op))
    function = op->getParentOfType<FunctionOpInterface>();
  if (!function)
    return Modes();
  if (auto kernel = dyn_cast<KernelOp>(function))
    return readModes(kernel.getModesAttr());
  std::optional<StringRef> text = getPassed(function);
  return text ? readPassed(*text) : Modes();
}

void Modes::setOn(Operation *function) const {
  auto kernel = dyn_cast<KernelOp>(function);
  if (!kernel)
    return setPassed(function, *this);
  Builder builder(function->getContext());
  SmallVector<NamedAttribute> entries;
  for (auto [name, word] : getWords(*this)) {
    Attribute value = builder.getStringAttr(word);
    if (name == "ftz")
      value = builder.getBoolAttr(*ftz);
    entries.push_back(builder.getNamedAttr(name, value));
  }
  if (entries.empty())
    kernel.removeModesAttr();
  else
    kernel.setModesAttr(builder.getDictionaryAttr(entries));
}

Modes Modes::inDeterministicContext() const {
  Modes result = *this;
  if (!sums)
    result.sums = SumsMode::Deterministic;
  else if (sums == SumsMode::Compensated)
    result.sums = SumsMode::Both;
  return result;
}
