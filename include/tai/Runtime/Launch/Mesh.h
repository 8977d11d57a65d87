//===- Mesh.h - The ranks that share fields ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A mesh is a set of processes that run the same program, each on its rows of
// the sharded fields. The mesh is a property of the process, as its safepoint
// handler is. The runtime moves no bytes between processes: a handler of the
// host does. See docs/decisions/0075-shards.md.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_MESH_H
#define TAI_RUNTIME_LAUNCH_MESH_H

#include "tai/Runtime/Launch/Runtime.h"
#include <functional>
#include <optional>
#include <string>

namespace mlir::tai::runtime {

/// An exchange of a launch: the elements of a field, as an array of numbers.
/// Dimension `rows` of the array is divided among the ranks, unless it is
/// negative.
struct Exchange {
  const char *kind, *field, *kernel, *where;
  int64_t element, digest, block, before, after;
  void *address;
  int64_t rows;
  std::vector<int64_t> extents, strides;
  /// True if `address` is memory of the runtime's device. The default stream
  /// waits for all earlier work, and later work for the default stream, on
  /// which the handler queues its own.
  bool isOnDevice = false;
};

struct Launch;

struct Mesh {
  int64_t rank = 0;
  /// The number of ranks; 0 if the process belongs to no mesh.
  int64_t ranks = 0;
  /// Carries out an exchange together with the other ranks. Returns the message
  /// of a failure, or an empty string.
  std::function<std::string(const Exchange &)> exchange;
};

/// Sets the mesh of the process. Call while no kernel runs.
void setMesh(Mesh mesh);

/// The number of the process in its mesh; nothing if it belongs to none.
std::optional<int64_t> rankOfProcess();

/// Tells the other ranks of the mesh, if there are any, that work on this one
/// has failed: they may wait in an exchange that this rank does not reach.
/// `kernel` is empty if several launches may be the cause.
void tellRanks(const std::string &failure, const std::string &kernel,
               const char *where);

/// True if the launch, which this thread has run last, has asked for the number
/// of the process in its mesh.
bool isOnRanks(const Launch &launch);

/// The number of exchanges of the process that were left out, because the
/// halos were current.
int64_t numExchangesLeftOut();

/// Adds the functions of tai/ABI/MeshAbi.h.
void appendMeshCalls(std::vector<RuntimeSymbol> &symbols);

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_MESH_H
