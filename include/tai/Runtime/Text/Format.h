//===- Format.h - Formatting of values --------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_TEXT_FORMAT_H
#define TAI_RUNTIME_TEXT_FORMAT_H

#include <cstdint>
#include <string>

namespace mlir::tai::runtime {

/// Replaces each "{}" and "{:...}" (see FormatSpec.h) of the format by the next
/// value. `kinds`: TaiValueKind of each value; `shapes`: number of its
/// components; null for scalars.
std::string formatValues(const char *format, int32_t count,
                         const int32_t *kinds, const int32_t *shapes,
                         const uint64_t *slots);
/// The final form of a printed text: appends a newline, or removes a final
/// TAI_SAME_LINE.
std::string endPrinted(std::string text);
std::string formatBytes(int64_t bytes);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_TEXT_FORMAT_H
