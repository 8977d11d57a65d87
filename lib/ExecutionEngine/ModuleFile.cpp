//===- ModuleFile.cpp - Reading and writing modules -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A file is a header of 24 bytes, the magic number, the length of the bytecode
// and its checksum, and then the bytecode. Both numbers are little-endian.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/ModuleFile.h"
#include "mlir/Bytecode/BytecodeReader.h"
#include "mlir/Bytecode/BytecodeWriter.h"
#include "mlir/IR/Diagnostics.h"
#include "mlir/Parser/Parser.h"
#include "tai/Support/XXHash.h"
#include "llvm/Support/Endian.h"
#include "llvm/Support/MemoryBuffer.h"
#include <optional>

using namespace mlir;
using namespace mlir::tai;

static constexpr StringLiteral kMagic("\xabTaiMLIR");
static constexpr size_t kHeaderSize = kMagic.size() + 2 * sizeof(uint64_t);
static constexpr StringLiteral kRemedy(
    "give the module as text, or as what 'tai-translate --tai-to-bytecode' or "
    "taiModuleWrite makes of it");

/// The length is part of it, so that no file is the beginning of another.
static uint64_t getChecksum(StringRef bytecode) {
  return runtime::xxh64(bytecode.data(), bytecode.size(), bytecode.size());
}

static bool startsAsBytecode(StringRef bytes) {
  return isBytecode(llvm::MemoryBufferRef(bytes, "module"));
}

/// The fault of the header or of the bytes behind it, if any.
static std::string checkHeader(StringRef bytes) {
  if (bytes.size() < kHeaderSize)
    return "this bytecode is cut off: it has " + std::to_string(bytes.size()) +
           " bytes, fewer than its header";
  StringRef bytecode = bytes.drop_front(kHeaderSize);
  const char *numbers = bytes.data() + kMagic.size();
  uint64_t size = llvm::support::endian::read64le(numbers);
  if (size != bytecode.size())
    return "this bytecode is cut off or damaged: it has " +
           std::to_string(bytecode.size()) + " bytes, and its header says " +
           std::to_string(size);
  if (llvm::support::endian::read64le(numbers + sizeof(uint64_t)) !=
      getChecksum(bytecode))
    return "this bytecode is damaged: its checksum does not match";
  if (!startsAsBytecode(bytecode))
    return "what stands behind the checksum is not MLIR bytecode";
  return "";
}

/// The place of a construct that MLIR's parser dies of, and the reason of the
/// refusal: an array of `index`, and a result so far behind the others that
/// there is no memory for those before it.
static std::optional<std::pair<size_t, StringRef>>
findFatalText(StringRef text) {
  constexpr size_t kMostDigits = 6;
  constexpr StringLiteral stops("#<\"/");
  for (size_t at = text.find_first_of(stops); at != StringRef::npos;
       at = text.find_first_of(stops, at + 1)) {
    StringRef rest = text.drop_front(at + 1);
    switch (text[at]) {
    case '/':
      // Past a comment.
      if (rest.starts_with("/"))
        at += rest.find_first_of('\n') == StringRef::npos
                  ? rest.size()
                  : rest.find_first_of('\n');
      break;
    case '"':
      // Past a string.
      for (++at; at < text.size() && text[at] != '"' && text[at] != '\n'; ++at)
        at += text[at] == '\\';
      if (at >= text.size())
        return std::nullopt;
      break;
    case '#':
      if (rest.take_while(llvm::isDigit).size() > kMostDigits)
        return std::pair(at, StringRef("no operation has so many results"));
      break;
    case '<':
      rest = rest.ltrim();
      if (text.take_front(at).rtrim().ends_with("array") &&
          rest.consume_front("index") && rest.ltrim().starts_with(":"))
        return std::pair(at, StringRef("an array attribute holds integers of "
                                       "known width or floats, not 'index'"));
      break;
    }
  }
  return std::nullopt;
}

static Location getPlace(MLIRContext *context, StringRef text, size_t at,
                         StringRef file) {
  StringRef before = text.take_front(at);
  unsigned column = before.size() - (before.rfind('\n') + 1);
  return FileLineColLoc::get(context, file, before.count('\n') + 1, column + 1);
}

OwningOpRef<ModuleOp> mlir::tai::readModule(StringRef bytes,
                                            const ParserConfig &config,
                                            StringRef file) {
  MLIRContext *context = config.getContext();
  auto start = FileLineColLoc::get(context, file, 1, 1);
  if (startsAsBytecode(bytes)) {
    emitError(start, "this is MLIR bytecode without a checksum, which is not "
                     "read here, since damaged bytecode ends the process")
            .attachNote()
        << kRemedy;
    return {};
  }
  if (!bytes.starts_with(kMagic)) {
    // To MLIR's parser a file of nothing but zeros is an empty module.
    if (bytes.contains('\0')) {
      emitError(getPlace(context, bytes, bytes.find('\0'), file),
                "this is neither text nor bytecode: a byte is zero");
      return {};
    }
    if (auto fatal = findFatalText(bytes)) {
      emitError(getPlace(context, bytes, fatal->first, file), fatal->second);
      return {};
    }
    return parseSourceString<ModuleOp>(bytes, config, file);
  }
  if (std::string problem = checkHeader(bytes); !problem.empty()) {
    emitError(start, problem).attachNote() << kRemedy;
    return {};
  }
  // Resources keep the alignment with which they were written.
  StringRef bytecode = bytes.drop_front(kHeaderSize);
  auto aligned = llvm::WritableMemoryBuffer::getNewUninitMemBuffer(
      bytecode.size(), file, llvm::Align(64));
  llvm::copy(bytecode, aligned->getBufferStart());
  return parseSourceString<ModuleOp>(aligned->MemoryBuffer::getBuffer(), config,
                                     file);
}

LogicalResult mlir::tai::writeModule(ModuleOp module,
                                     llvm::raw_ostream &stream) {
  std::string bytecode;
  llvm::raw_string_ostream bytecodeStream(bytecode);
  if (failed(writeBytecodeToFile(module, bytecodeStream)))
    return failure();
  char numbers[2 * sizeof(uint64_t)];
  llvm::support::endian::write64le(numbers, bytecode.size());
  llvm::support::endian::write64le(numbers + sizeof(uint64_t),
                                   getChecksum(bytecode));
  stream << kMagic << StringRef(numbers, sizeof(numbers)) << bytecode;
  return success();
}
