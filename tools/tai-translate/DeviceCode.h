//===- DeviceCode.h - Translations of device code ---------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TOOLS_TAITRANSLATE_DEVICECODE_H
#define TAI_TOOLS_TAITRANSLATE_DEVICECODE_H

namespace mlir::tai {

/// Registers `--tai-to-ptx` and `--tai-to-device-llvmir`.
void registerDeviceCodeTranslations();

} // namespace mlir::tai

#endif // TAI_TOOLS_TAITRANSLATE_DEVICECODE_H
