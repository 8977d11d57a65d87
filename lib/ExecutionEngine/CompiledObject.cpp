//===- CompiledObject.cpp - What a compilation leaves ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/CompiledObject.h"
#include "llvm/Support/Endian.h"

using namespace llvm;
using namespace mlir::tai;

// The magic, the symbol, the code, and the trees up to the end; each string as
// its length in eight bytes and its bytes.
static constexpr StringLiteral magic = "TAIOBJ2\n";

static void append(std::string &bytes, StringRef string) {
  char length[8];
  support::endian::write64le(length, string.size());
  bytes.append(length, sizeof(length));
  bytes.append(string.data(), string.size());
}

static std::optional<StringRef> consume(StringRef &bytes) {
  if (bytes.size() < 8)
    return std::nullopt;
  uint64_t length = support::endian::read64le(bytes.data());
  bytes = bytes.drop_front(8);
  if (length > bytes.size())
    return std::nullopt;
  StringRef string = bytes.take_front(length);
  bytes = bytes.drop_front(length);
  return string;
}

std::string CompiledObject::serialize() const {
  std::string bytes = magic.str();
  append(bytes, symbol);
  append(bytes, StringRef(code.data(), code.size()));
  append(bytes, needs);
  for (const std::string &tree : trees)
    append(bytes, tree);
  return bytes;
}

std::optional<CompiledObject> CompiledObject::deserialize(StringRef bytes) {
  if (!bytes.consume_front(magic))
    return std::nullopt;
  std::optional<StringRef> symbol = consume(bytes);
  std::optional<StringRef> code = symbol ? consume(bytes) : std::nullopt;
  std::optional<StringRef> needs = code ? consume(bytes) : std::nullopt;
  if (!needs)
    return std::nullopt;
  CompiledObject object;
  while (!bytes.empty()) {
    std::optional<StringRef> tree = consume(bytes);
    if (!tree)
      return std::nullopt;
    object.trees.push_back(tree->str());
  }
  object.symbol = symbol->str();
  object.needs = needs->str();
  object.code.assign(code->begin(), code->end());
  return object;
}
