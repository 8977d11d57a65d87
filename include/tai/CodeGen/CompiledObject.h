//===- CompiledObject.h - What a compilation leaves -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Object code and what must be known to run it, as one block of bytes: the
// payload of an entry of the compile cache.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_COMPILEDOBJECT_H
#define TAI_CODEGEN_COMPILEDOBJECT_H

#include "tai/CodeGen/Diagnostics.h"
#include "tai/Runtime/Device/Device.h"
#include "tai/Support/Skips.h"
#include "llvm/ADT/SmallVector.h"
#include "llvm/ADT/StringRef.h"
#include <optional>
#include <string>
#include <vector>

namespace mlir::tai {

struct CompiledObject {
  /// The function to call. Empty for an adjoint that has nothing to do.
  std::string symbol;
  /// The trees whose bases the function is given, in order.
  std::vector<std::string> trees;
  /// Of adjoints, which values must be recorded: a serialized ToBeRecorded.
  std::string toBeRecorded;
  /// A digest of where the kernel stands in the source, if that is in the code.
  std::string places;
  /// What the compiler had to say; then the places stand in `places`.
  std::vector<Warning> warnings;
  /// What the passes have left out, and what they have not.
  SkipAmounts skipped{};
  /// Of a kernel that does nothing but loop over active cells: pairs of a tree,
  /// by its position among `trees`, and the number of a level in it.
  std::vector<int64_t> loopLevels;
  /// Of a kernel with device functions, their code.
  std::optional<runtime::DeviceImage> image;
  llvm::SmallVector<char, 0> code;

  std::string serialize() const;
  /// Nothing where the bytes are not those of a serialized object.
  static std::optional<CompiledObject> deserialize(llvm::StringRef bytes);
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_COMPILEDOBJECT_H
