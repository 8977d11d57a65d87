//===- Places.h - Where in a source an op comes from ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What messages name, as the compiler and as running code report them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_PLACES_H
#define TAI_SUPPORT_PLACES_H

#include "mlir/IR/Location.h"
#include "mlir/IR/Visitors.h"
#include "llvm/ADT/Twine.h"

namespace mlir::tai {

/// The place in a file that a location stands for, if it has one: the
/// innermost, where functions were inlined.
inline FileLineColLoc findFileLocation(Location location) {
  // A call site is where the inlined code stands, not where it was called.
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

/// The same as "file:line:column", or empty.
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
