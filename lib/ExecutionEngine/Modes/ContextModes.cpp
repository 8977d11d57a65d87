//===- ContextModes.cpp - Numeric modes of a context ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modes/ContextModes.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Interfaces/Differentiable.h"

using namespace mlir;
using namespace mlir::tai;

std::string ContextModes::setWord(StringRef name, StringRef word) {
  struct Words {
    StringRef name;
    std::string ContextModes::*member;
    SmallVector<StringRef, 4> words;
  };
  const Words table[] = {
      {"precision", &ContextModes::precision, {"default", "f64", "f32"}},
      {"sums",
       &ContextModes::sums,
       {"default", "compensated", "deterministic"}},
      {"math", &ContextModes::math, {"default", "fast", "strict", "accurate"}},
      {"adjoints", &ContextModes::adjoints, {"default", "f64"}},
  };
  for (const Words &row : table) {
    if (row.name != name)
      continue;
    if (llvm::is_contained(row.words, word)) {
      this->*row.member = word.str();
      return "";
    }
    std::string expected;
    for (auto [i, known] : llvm::enumerate(row.words))
      expected += (i == 0                      ? ""
                   : i + 1 == row.words.size() ? " or "
                                               : ", ") +
                  known.str();
    if (name == "precision" && (word == "f16" || word == "bf16"))
      expected += " (numbers of 16 bits are types of fields)";
    return expected;
  }
  llvm_unreachable("not a word of numbers");
}

std::string ContextModes::findContradiction() const {
  auto word = [](StringRef name, StringRef value) {
    return name.str() + "=\"" + value.str() + "\"";
  };
  std::string fast = has(Shorthand::FastMath) ? "fast_math"
                     : math == "fast"         ? word("math", math)
                                              : "";
  if (fast.empty())
    return "";
  auto say = [&](const std::string &first, StringRef does, StringRef other) {
    return "options '" + first + "' and '" + fast +
           "' contradict one another: the first " + does.str() +
           ", the second " + other.str() + "; choose one";
  };
  constexpr StringRef rounds = "rounds every operation by itself";
  constexpr StringRef reorders = "reorders them";
  if (math == "strict")
    return say(word("math", math), rounds, reorders);
  if (has(Shorthand::Strict))
    return say("strict", rounds, reorders);
  if (shadow)
    return say("shadow", rounds, reorders);
  if (math == "accurate")
    return say(word("math", math),
               "wants every function right to one unit in the last place",
               "approximates them");
  if (sums == "compensated")
    return say(word("sums", sums), "keeps what a sum rounds away",
               "may cancel it by reordering");
  return "";
}

void ContextModes::addTo(ModuleOp module) const {
  Builder builder(module.getContext());
  NamedAttrList words;
  auto add = [&](StringRef name, StringRef word) {
    if (word != "default")
      words.append(name, builder.getStringAttr(word));
  };
  add("precision", precision);
  add("sums", sums);
  // As in Python, `accurate` is not replaced by `strict`, which `shadow`
  // implies.
  add("math", (has(Shorthand::Strict) || shadow) && math != "accurate"
                  ? "strict"
                  : StringRef(math));
  if (ftz)
    words.append("ftz", builder.getBoolAttr(true));
  if (words.empty())
    return;
  for (KernelOp kernel : module.getOps<KernelOp>()) {
    NamedAttrList all(kernel.getModesAttr());
    for (NamedAttribute entry : words)
      if (!all.get(entry.getName()))
        all.push_back(entry);
    kernel.setModesAttr(all.getDictionary(module.getContext()));
  }
}

LogicalResult ContextModes::checkFields(ModuleOp module) const {
  if (adjoints == "default")
    return success();
  for (FieldOp field : module.getOps<FieldOp>()) {
    if (!field.getAdjoint() || !isFloatOrVector(field.getType()))
      continue;
    auto adjoint = module.lookupSymbol<FieldOp>(*field.getAdjoint());
    if (!adjoint)
      continue;
    Type element = getElementTypeOrSelf(adjoint.getType());
    if (element.isF64())
      continue;
    return field.emitError()
           << "with adjoints=\"f64\" gradients of fields are fields of f64, "
              "but '@"
           << adjoint.getSymName() << "', that of '@" << field.getSymName()
           << "', holds " << element;
  }
  return success();
}
