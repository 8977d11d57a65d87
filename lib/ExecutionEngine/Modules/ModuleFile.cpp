//===- ModuleFile.cpp - Reading and writing modules -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A file is a header of 24 bytes and the bytecode. The header has the magic
// number, the length of the bytecode and its checksum; both numbers are
// little-endian.
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "mlir/Bytecode/BytecodeReader.h"
#include "mlir/Bytecode/BytecodeWriter.h"
#include "mlir/IR/Diagnostics.h"
#include "mlir/Parser/Parser.h"
#include "tai/Dialect/Tai/IR/TextLimits.h"
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

/// The checksum includes the length, so that no file is a prefix of another.
static uint64_t getChecksum(StringRef bytecode) {
  return runtime::xxh64(bytecode.data(), bytecode.size(), bytecode.size());
}

static bool startsAsBytecode(StringRef bytes) {
  return isBytecode(llvm::MemoryBufferRef(bytes, "module"));
}

/// Describes the problem with the header of a bytecode file or with the bytes
/// after it; empty if there is none.
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

bool mlir::tai::checkText(StringRef text, MLIRContext *context,
                          StringRef file) {
  std::optional<TextProblem> problem = findTextProblem(text);
  if (!problem)
    return true;
  emitError(FileLineColLoc::get(context, file, problem->line, problem->column),
            problem->message);
  return false;
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
    // MLIR's parser takes a file of zeros for an empty module.
    if (bytes.contains('\0')) {
      StringRef before = bytes.take_until([](char c) { return c == '\0'; });
      unsigned column = before.size() - (before.rfind('\n') + 1);
      emitError(FileLineColLoc::get(context, file, before.count('\n') + 1,
                                    column + 1),
                "this is neither text nor bytecode: a byte is zero");
      return {};
    }
    if (!checkText(bytes, context, file))
      return {};
    return parseSourceString<ModuleOp>(bytes, config, file);
  }
  if (std::string problem = checkHeader(bytes); !problem.empty()) {
    emitError(start, problem).attachNote() << kRemedy;
    return {};
  }
  StringRef bytecode = bytes.drop_front(kHeaderSize);
  if (!checkText(bytecode, context, file))
    return {};
  // The copy of the bytecode is aligned, since resources in it have the
  // alignment with which they were written.
  auto aligned = llvm::WritableMemoryBuffer::getNewUninitMemBuffer(
      bytecode.size(), file, llvm::Align(64));
  llvm::copy(bytecode, aligned->getBufferStart());
  auto module = parseSourceString<ModuleOp>(aligned->MemoryBuffer::getBuffer(),
                                            config, file);
  if (module && failed(checkDimensions(*module)))
    return {};
  return module;
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
