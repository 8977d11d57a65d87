//===- Completion.cpp - Completion of symbols -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Completion.h"
#include "mlir/Support/LLVM.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/Regex.h"

using namespace mlir;
using namespace mlir::tai;

namespace {
enum SymbolKinds { Tree = 1, Field = 2, Kernel = 4, Function = 8, Global = 16 };

struct Symbol {
  SymbolKinds kind;
  StringRef name;
  /// The text after the name, up to the end of the line.
  StringRef rest;
};

/// Where a symbol of some kinds is expected: after a text that a pattern
/// matches, up to the `@`.
struct Place {
  StringLiteral pattern;
  unsigned kinds;
};
} // namespace

static constexpr Place kPlaces[] = {
    // Definitions have names of their own.
    {"^ *(tai\\.(tree|field|kernel)|memref\\.global|(func|llvm)\\.func)"
     "( +[a-z]+)* *$",
     0},
    {"^ *tai\\.field +@[A-Za-z0-9_$.]+ *= *$", Tree},
    {"tai\\.launch +$", Kernel},
    {"(call|tai\\.grad|func\\.constant|tai\\.adjoint *=) +$",
     Function | Kernel},
    {"get_global +$", Global},
    {"(adjoint|dual|loss|in|wrt) *\\(? *$", Field},
    {"tai\\.[a-z_]+ [^@]*$", Field | Tree},
};

static std::optional<SymbolKinds> getKind(StringRef op) {
  return llvm::StringSwitch<std::optional<SymbolKinds>>(op)
      .Case("tai.tree", Tree)
      .Case("tai.field", Field)
      .Case("tai.kernel", Kernel)
      .Cases({"func.func", "llvm.func"}, Function)
      .Case("memref.global", Global)
      .Default(std::nullopt);
}

static SmallVector<Symbol> findSymbols(StringRef text) {
  static const llvm::Regex definition(
      "^ *([a-z]+\\.[a-z]+)( +[a-z]+)* +@([A-Za-z0-9_$.]+)(.*)$");
  SmallVector<Symbol> symbols;
  while (!text.empty()) {
    StringRef line;
    std::tie(line, text) = text.split('\n');
    SmallVector<StringRef> parts;
    if (!line.contains('@') || !definition.match(line, &parts))
      continue;
    if (std::optional<SymbolKinds> kind = getKind(parts[1]))
      symbols.push_back({*kind, parts[3], parts[4]});
  }
  return symbols;
}

static llvm::json::Object createItem(StringRef name, int kind,
                                     StringRef detail) {
  return llvm::json::Object{
      {"label", name},
      {"kind", kind},
      {"insertText", name},
      {"insertTextFormat", 1},
      {"detail", detail.trim(" {:=").str()},
  };
}

/// The names of the places of a tree: names before a colon, in braces.
static llvm::json::Array completePlaces(StringRef text, StringRef tree) {
  llvm::json::Array items;
  size_t at = text.find(("tai.tree @" + tree + " ").str());
  if (at == StringRef::npos)
    return items;
  text = text.drop_front(at);
  size_t begin = 0;
  int depth = 0;
  bool inBraces = false;
  for (size_t i = 0; i < text.size(); ++i) {
    char c = text[i];
    if (c == '<')
      ++depth;
    else if (c == '>' && --depth == 0)
      break;
    else if (c == '{' || c == '}')
      inBraces = c == '{';
    if (c == ':' && inBraces) {
      StringRef type =
          text.drop_front(i + 1).take_until([](char c) { return c == '}'; });
      items.push_back(
          createItem(text.slice(begin, i).trim(" \n\""), 5,
                     type.take_until([](char c) { return c == ','; })));
    }
    if (c == '{' || c == ',')
      begin = i + 1;
  }
  return items;
}

/// The text of a line before a position.
static StringRef getLineStart(StringRef text, unsigned line,
                              unsigned character) {
  for (; line != 0; --line)
    text = text.split('\n').second;
  text = text.split('\n').first;
  size_t i = 0;
  while (i < text.size() && character != 0) {
    unsigned char c = text[i];
    size_t bytes = c < 0x80 ? 1 : c < 0xe0 ? 2 : c < 0xf0 ? 3 : 4;
    character -= std::min(character, bytes == 4 ? 2u : 1u);
    i = std::min(text.size(), i + bytes);
  }
  return text.take_front(i);
}

std::optional<llvm::json::Array>
tai::completeSymbol(StringRef text, unsigned line, unsigned character) {
  StringRef before = getLineStart(text, line, character);
  if (before.contains("//"))
    return std::nullopt;
  static const llvm::Regex place("@([A-Za-z0-9_$.]+)\\[\"[A-Za-z0-9_$.]*$");
  SmallVector<StringRef> parts;
  if (before.contains("tai.field") && place.match(before, &parts))
    return completePlaces(text, parts[1]);
  static const llvm::Regex symbol("^(.*)@[A-Za-z0-9_$.]*$");
  if (!symbol.match(before, &parts))
    return std::nullopt;
  unsigned kinds = Tree | Field | Kernel | Function | Global;
  for (const Place &entry : kPlaces)
    if (llvm::Regex(entry.pattern).match(parts[1])) {
      kinds = entry.kinds;
      break;
    }
  llvm::json::Array items;
  for (const Symbol &found : findSymbols(text)) {
    if (!(found.kind & kinds))
      continue;
    // The kinds of the protocol: a field, a function, a struct or a variable.
    int kind = found.kind == Field    ? 5
               : found.kind == Tree   ? 22
               : found.kind == Global ? 6
                                      : 3;
    items.push_back(createItem(found.name, kind, found.rest));
  }
  return items;
}
