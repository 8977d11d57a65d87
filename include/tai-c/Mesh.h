/*===- Mesh.h - Processes that share fields -----------------------*- C -*-===*\
|*                                                                            *|
|* Licensed under the Apache License v2.0 with LLVM Exceptions.               *|
|* SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception                    *|
|*                                                                            *|
|*===----------------------------------------------------------------------===*|
|*                                                                            *|
|* Makes the process a rank of a mesh, whose ranks run the same program, each *|
|* on its rows of the sharded fields. libtai moves no bytes between           *|
|* processes: the handler does.                                               *|
|*                                                                            *|
\*===----------------------------------------------------------------------===*/

#ifndef TAI_C_MESH_H
#define TAI_C_MESH_H

#include "tai-c/Tai.h"

#ifdef __cplusplus
extern "C" {
#endif

/// An exchange between the ranks, as the op `tai_mesh.exchange` describes it,
/// of the numbers at `address`: an array of `num_dims` dimensions with these
/// extents and strides in bytes. `element` is the type of a number: the bits of
/// an integer, or minus the bits of a float; -17 stands for bf16. Dimension
/// `rows`, if it is not negative, is divided among the ranks. `where` is the
/// location of the access that needs the exchange, "file:line:col"; `kernel` is
/// the name of the kernel that is launched. If `on_device` is not 0, `address`
/// is memory of the GPU: the default stream of the GPU waits for all earlier
/// work, and later work for the default stream, on which the handler queues its
/// own.
typedef struct TaiExchange {
  const char *kind, *field, *kernel, *where;
  int64_t element, digest, block, before, after;
  void *address;
  int64_t num_dims, rows;
  const int64_t *extents, *strides;
  int32_t on_device;
} TaiExchange;

/// Carries out an exchange, on the thread of the launch. Returns null, or the
/// message of a failure, valid until the next call. If the launch has failed on
/// this rank, `kind` is "fail", and `field` is the message: the other ranks
/// wait in an exchange that this one does not reach.
typedef const char *(*TaiExchangeHandler)(const TaiExchange *exchange);

/// Makes the process rank `rank` of a mesh of `ranks` processes. A null handler
/// takes it out of the mesh. Call while no kernel runs, and before kernels on
/// sharded fields are compiled: their code is of one rank.
TAI_EXPORT void taiSetMesh(int64_t rank, int64_t ranks,
                           TaiExchangeHandler handler);

/// The number of exchanges that were left out, since the rank had all rows that
/// the loops read.
TAI_EXPORT int64_t taiMeshExchangesLeftOut(void);

#ifdef __cplusplus
}
#endif

#endif /* TAI_C_MESH_H */
