//===- ModuleFiles.h - Bytecode with a checksum -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAI_TRANSLATE_MODULEFILES_H
#define TAI_TOOLS_TAI_TRANSLATE_MODULEFILES_H

namespace mlir::tai {

/// Registers `--tai-to-bytecode` and `--tai-from-bytecode`.
void registerModuleFileTranslations();

} // namespace mlir::tai

#endif // TAI_TOOLS_TAI_TRANSLATE_MODULEFILES_H
