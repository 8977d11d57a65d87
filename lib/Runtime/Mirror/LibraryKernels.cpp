//===- LibraryKernels.cpp - Kernels of the device library -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Mirror/LibraryKernels.h"
#include <algorithm>

using namespace mlir::tai::runtime;

/// The names of the kernels, in the order of LibraryKernel.
static constexpr const char *names[] = {
    "tai_dev_list_cells",   "tai_dev_list_count",      "tai_dev_list_scan",
    "tai_dev_list_write",   "tai_dev_deactivate_list", "tai_dev_move_cells",
    "tai_dev_keep_activity"};

Status LibraryKernels::load(bool &isThere) {
  Section::Entry section(loading);
  if (section.isAgain())
    return section.check();
  isThere = !entries.empty();
  if (isThere || !queue.canMakePrograms())
    return Status::success();
  DeviceImage image;
  Status status =
      queue.makeLibrary({std::begin(names), std::end(names)}, image);
  if (status)
    status = queue.load(image, module);
  for (const std::string &name : image.functions) {
    Entry entry{nullptr, 1};
    if (status)
      status = queue.find(*module, name, entry.function);
    if (!status)
      return status;
    entry.mostThreads = queue.mostThreads(*entry.function);
    entries.push_back(entry);
  }
  isThere = true;
  return status;
}

Status LibraryKernels::launch(LibraryKernel kernel, unsigned blocks,
                              unsigned threads,
                              std::initializer_list<uint64_t> slots) {
  const Entry &entry = entries[static_cast<size_t>(kernel)];
  LaunchShape shape;
  shape.threads = std::min(threads, entry.mostThreads);
  shape.blocks =
      blocks
          ? blocks
          : std::max(queue.residentBlocks(*entry.function, shape.threads), 1u);
  return queue.launch(*entry.function, shape, slots.begin(),
                      static_cast<int>(slots.size()));
}
