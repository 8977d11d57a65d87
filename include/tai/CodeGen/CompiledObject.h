//===- CompiledObject.h - The result of a compilation -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Object code and the data needed to run it; serialized, it is the payload of
// an entry of the compile cache.
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
  /// The symbol of the function to call. Empty for an adjoint without effects,
  /// which needs no code.
  std::string symbol;
  /// The names of the trees of fields whose base addresses the function takes,
  /// in the order of its arguments.
  std::vector<std::string> trees;
  /// For adjoint kernels, the values that the primal must record: a serialized
  /// ToBeRecorded.
  std::string toBeRecorded;
  /// A digest of the source locations, if the object code contains them;
  /// otherwise empty.
  std::string places;
  /// Warnings of the compiler. Their presence implies that `places` is set.
  std::vector<Warning> warnings;
  /// Amounts of work that the passes found unnecessary, by kind of skip.
  SkipAmounts skipped{};
  /// For a kernel that only loops over active cells: pairs of a tree, by its
  /// position in `trees`, and the number of a level in it.
  std::vector<int64_t> loopLevels;
  /// The adjoint fields that the function can store without reading them
  /// before, in the order of the bits of TaiFrame::zeroAdjoints.
  std::vector<std::string> storesFirst;
  /// The code of the kernel's device functions, if it has any.
  std::optional<runtime::DeviceImage> image;
  llvm::SmallVector<char, 0> code;

  std::string serialize() const;
  /// Reads a serialized object. Returns no value if the bytes are not one.
  static std::optional<CompiledObject> deserialize(llvm::StringRef bytes);
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_COMPILEDOBJECT_H
