//===- BuildId.cpp - Which build of the compiler this is ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "BuildId.h"
#include "tai/Runtime/Abi.h"
#include "llvm/Config/llvm-config.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/raw_ostream.h"
#include <dlfcn.h>

using namespace llvm;

StringRef mlir::tai::getBuildId() {
  static const std::string id = [] {
    std::string text;
    raw_string_ostream stream(text);
    stream << "tai abi " << TAI_ABI_VERSION << " llvm " << LLVM_VERSION_STRING;
    // A rebuilt library is another file: its size and time tell, at less cost
    // than reading it.
    Dl_info info;
    sys::fs::file_status status;
    if (dladdr(reinterpret_cast<void *>(&getBuildId), &info) &&
        info.dli_fname && !sys::fs::status(info.dli_fname, status))
      stream << ' ' << status.getSize() << ' '
             << status.getLastModificationTime().time_since_epoch().count();
    return text;
  }();
  return id;
}
