//===- CompiledObject.cpp - The result of a compilation -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/CodeGen/CompiledObject.h"
#include "tai/ABI/DeviceAccesses.h"
#include "llvm/ADT/SmallVector.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/Endian.h"

using namespace llvm;
using namespace mlir::tai;

// The format of a serialized object: the magic, the symbol, the code, the
// demands of the adjoint, the places, the counts, the loop levels, the adjoints
// that are stored first, the warnings (the lines and columns of all warnings,
// then the texts of each), the image of the device (its kind and the number of
// its functions, or nothing; its bytes, its machine code, its bitcode, the
// functions' names and accesses, their block sizes and their places), and the
// trees up to the end. Each string is its length in eight bytes and its bytes.
static constexpr StringLiteral magic = "TAIOBJ12\n";

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

/// Appends a list of numbers to a serialized object as one string, in which
/// each number takes eight bytes.
static void append(std::string &bytes, ArrayRef<int64_t> numbers) {
  std::string string(8 * numbers.size(), '\0');
  for (auto [i, number] : enumerate(numbers))
    support::endian::write64le(&string[8 * i], static_cast<uint64_t>(number));
  append(bytes, string);
}

static std::optional<std::vector<int64_t>> consumeNumbers(StringRef &bytes) {
  std::optional<StringRef> string = consume(bytes);
  if (!string || string->size() % 8)
    return std::nullopt;
  std::vector<int64_t> numbers;
  for (; !string->empty(); string = string->drop_front(8))
    numbers.push_back(
        static_cast<int64_t>(support::endian::read64le(string->data())));
  return numbers;
}

static void append(std::string &bytes,
                   const std::optional<runtime::DeviceImage> &image) {
  if (!image)
    return append(bytes, ArrayRef<int64_t>());
  int64_t header[] = {static_cast<int64_t>(image->kind),
                      static_cast<int64_t>(image->functions.size())};
  append(bytes, ArrayRef<int64_t>(header));
  append(bytes, StringRef(image->bytes));
  append(bytes, StringRef(image->machineCode));
  append(bytes, image->bitcode ? StringRef(*image->bitcode) : StringRef());
  for (auto [i, function] : enumerate(image->functions)) {
    append(bytes, StringRef(function));
    append(bytes, i < image->accesses.size()
                      ? ArrayRef<int64_t>(image->accesses[i])
                      : ArrayRef<int64_t>());
  }
  append(bytes, ArrayRef<int64_t>(image->blockSizes));
  append(bytes, StringRef(llvm::join(image->places, "\n")));
}

/// Parses an optional device image; false if `bytes` does not start with one.
static bool consumeImage(StringRef &bytes,
                         std::optional<runtime::DeviceImage> &image) {
  auto header = consumeNumbers(bytes);
  if (!header || (!header->empty() && header->size() != 2))
    return false;
  if (header->empty())
    return true;
  image.emplace();
  image->kind = static_cast<runtime::DeviceKind>((*header)[0]);
  if (image->kind != runtime::DeviceKind::Cuda &&
      image->kind != runtime::DeviceKind::Emulated)
    return false;
  std::optional<StringRef> code = consume(bytes);
  if (!code)
    return false;
  image->bytes = code->str();
  std::optional<StringRef> machineCode = consume(bytes);
  if (!machineCode)
    return false;
  image->machineCode = machineCode->str();
  std::optional<StringRef> bitcode = consume(bytes);
  if (!bitcode)
    return false;
  image->bitcode = std::make_shared<const std::string>(bitcode->str());
  for (int64_t left = (*header)[1]; left > 0; --left) {
    std::optional<StringRef> function = consume(bytes);
    if (!function)
      return false;
    auto accesses = consumeNumbers(bytes);
    if (!accesses)
      return false;
    image->functions.push_back(function->str());
    image->accesses.push_back(std::move(*accesses));
  }
  auto sizes = consumeNumbers(bytes);
  if (!sizes || sizes->size() > image->functions.size() ||
      any_of(*sizes, [](int64_t size) {
        return size < 0 || size > runtime::kMostBlockThreads;
      }))
    return false;
  image->blockSizes = std::move(*sizes);
  std::optional<StringRef> places = consume(bytes);
  if (!places)
    return false;
  SmallVector<StringRef> lines;
  places->split(lines, '\n', /*MaxSplit=*/-1, /*KeepEmpty=*/true);
  if (lines.size() == image->functions.size())
    for (StringRef line : lines)
      image->places.push_back(line.str());
  return true;
}

static void append(std::string &bytes, ArrayRef<Warning> warnings) {
  SmallVector<int64_t> places;
  for (const Warning &warning : warnings)
    places.append({warning.line, warning.column});
  append(bytes, ArrayRef<int64_t>(places));
  for (const Warning &warning : warnings)
    for (StringRef text : {warning.message, warning.file, warning.text})
      append(bytes, text);
}

/// Parses the warnings of a serialized object; false if `bytes` does not start
/// with them.
static bool consumeWarnings(StringRef &bytes, std::vector<Warning> &warnings) {
  auto places = consumeNumbers(bytes);
  if (!places || places->size() % 2)
    return false;
  for (size_t i = 0; i < places->size(); i += 2) {
    Warning warning;
    warning.line = static_cast<int>((*places)[i]);
    warning.column = static_cast<int>((*places)[i + 1]);
    for (std::string *text : {&warning.message, &warning.file, &warning.text}) {
      std::optional<StringRef> found = consume(bytes);
      if (!found)
        return false;
      *text = found->str();
    }
    warnings.push_back(std::move(warning));
  }
  return true;
}

std::string CompiledObject::serialize() const {
  std::string bytes = magic.str();
  append(bytes, symbol);
  append(bytes, StringRef(code.data(), code.size()));
  append(bytes, toBeRecorded);
  append(bytes, places);
  append(bytes, ArrayRef<int64_t>(skipped.data(), skipped.size()));
  append(bytes, ArrayRef<int64_t>(loopLevels));
  append(bytes, join(storesFirst, ","));
  append(bytes, ArrayRef<Warning>(warnings));
  append(bytes, image);
  for (const std::string &tree : trees)
    append(bytes, tree);
  return bytes;
}

std::optional<CompiledObject> CompiledObject::deserialize(StringRef bytes) {
  if (!bytes.consume_front(magic))
    return std::nullopt;
  std::optional<StringRef> symbol = consume(bytes);
  std::optional<StringRef> code = symbol ? consume(bytes) : std::nullopt;
  std::optional<StringRef> toBeRecorded = code ? consume(bytes) : std::nullopt;
  std::optional<StringRef> places =
      toBeRecorded ? consume(bytes) : std::nullopt;
  if (!places)
    return std::nullopt;
  auto counts = consumeNumbers(bytes);
  auto levels = counts ? consumeNumbers(bytes) : std::nullopt;
  auto stored = levels ? consume(bytes) : std::nullopt;
  if (!stored || counts->size() != kNumSkipCounts || levels->size() % 2)
    return std::nullopt;
  CompiledObject object;
  copy(*counts, object.skipped.begin());
  object.loopLevels = std::move(*levels);
  SmallVector<StringRef> fields;
  stored->split(fields, ',', /*MaxSplit=*/-1, /*KeepEmpty=*/false);
  for (StringRef field : fields)
    object.storesFirst.push_back(field.str());
  if (!consumeWarnings(bytes, object.warnings) ||
      !consumeImage(bytes, object.image))
    return std::nullopt;
  while (!bytes.empty()) {
    std::optional<StringRef> tree = consume(bytes);
    if (!tree)
      return std::nullopt;
    object.trees.push_back(tree->str());
  }
  object.symbol = symbol->str();
  object.toBeRecorded = toBeRecorded->str();
  object.places = places->str();
  object.code.assign(code->begin(), code->end());
  return object;
}
