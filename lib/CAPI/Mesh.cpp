//===- Mesh.cpp - C API: processes that share fields ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai-c/Mesh.h"
#include "tai/Runtime/Launch/Mesh.h"

using namespace mlir::tai;

void taiSetMesh(int64_t rank, int64_t ranks, TaiExchangeHandler handler) {
  runtime::Mesh mesh;
  if (handler) {
    mesh.rank = rank;
    mesh.ranks = ranks;
    mesh.exchange = [handler](const runtime::Exchange &exchange) {
      TaiExchange told = {exchange.kind,
                          exchange.field,
                          exchange.kernel,
                          exchange.where,
                          exchange.element,
                          exchange.digest,
                          exchange.block,
                          exchange.before,
                          exchange.after,
                          exchange.address,
                          static_cast<int64_t>(exchange.extents.size()),
                          exchange.rows,
                          exchange.extents.data(),
                          exchange.strides.data(),
                          exchange.isOnDevice};
      const char *message = handler(&told);
      return std::string(message ? message : "");
    };
  }
  runtime::setMesh(std::move(mesh));
}

int64_t taiMeshExchangesLeftOut(void) { return runtime::numExchangesLeftOut(); }
