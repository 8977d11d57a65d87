//===- Places.h - Source locations for messages -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Source locations as text, for diagnostics and for messages of compiled code.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_PLACES_H
#define TAI_SUPPORT_PLACES_H

#include "mlir/IR/Location.h"
#include "mlir/IR/Visitors.h"
#include "llvm/ADT/Twine.h"

namespace mlir::tai {

/// The file location contained in `location`, or null; for inlined code, the
/// location in the callee.
inline FileLineColLoc findFileLocation(Location location) {
  // For inlined code, the location in the callee is used.
  if (auto call = dyn_cast<CallSiteLoc>(location))
    return findFileLocation(call.getCallee());
  FileLineColLoc found;
  location->walk([&](Location inner) {
    if (isa<CallSiteLoc>(inner)) {
      found = findFileLocation(inner);
      return found ? WalkResult::interrupt() : WalkResult::skip();
    }
    found = dyn_cast<FileLineColLoc>(inner);
    if (!found)
      if (auto range = dyn_cast<FileLineColRange>(inner))
        found = FileLineColLoc::get(range.getFilename(), range.getStartLine(),
                                    range.getStartColumn());
    return found ? WalkResult::interrupt() : WalkResult::advance();
  });
  return found;
}

/// The file location contained in `location` as "file:line:column", or empty.
inline std::string describePlace(Location location) {
  FileLineColLoc place = findFileLocation(location);
  return place ? (place.getFilename().getValue() + ":" +
                  llvm::Twine(place.getLine()) + ":" +
                  llvm::Twine(place.getColumn()))
                     .str()
               : std::string();
}

} // namespace mlir::tai

#endif // TAI_SUPPORT_PLACES_H
