//===- HostSparse.cpp - Some elements of fields at once -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What the host does to the cells of a sparse field that hold something,
// without going over those that do not.
//
//===----------------------------------------------------------------------===//

#include "HostWrite.h"
#include "tai/Runtime/Launch/Runtime.h"
#include <algorithm>
#include <cstring>

using namespace mlir::tai::runtime;

Status Runtime::activateNonzero(Field &field, const void *array) {
  SparseNode &node = *field.sparseNode();
  const std::vector<int64_t> &shape = field.shape();
  size_t rank = shape.size();
  int64_t bytes = byteSize(field.scalar()) * field.numComponents();
  const char *element = static_cast<const char *>(array);
  std::vector<int64_t> index(rank);
  for (size_t d = 0; d < rank; ++d)
    index[d] = field.firstIndex(static_cast<int64_t>(d));
  for (int64_t i = 0, n = field.numElements(); i < n; ++i, element += bytes) {
    if (std::any_of(element, element + bytes, [](char b) { return b != 0; })) {
      int64_t cell = field.cellNumber(index.data());
      if (!node.isActive(cell)) {
        Status status = checkActiveBytes(node, 1);
        if (!status)
          return status;
        node.activate(cell);
      }
    }
    for (size_t d = rank; d-- > 0;) {
      int64_t first = field.firstIndex(static_cast<int64_t>(d));
      if (++index[d] < first + shape[d])
        break;
      index[d] = first;
    }
  }
  return Status::success();
}

Status Field::readElements(const int64_t *indices, int64_t count,
                           void *values) const {
  auto scalar = static_cast<size_t>(byteSize(fieldLayout.scalar));
  char *to = static_cast<char *>(values);
  for (int64_t i = 0; i < count; ++i, indices += rank()) {
    int64_t from = 0;
    Status status = locate(indices, 0, from);
    for (int64_t c = 0; c < components && status; ++c, to += scalar)
      status = loadBytes(from + c * fieldLayout.componentStride, to);
    if (!status)
      return status;
  }
  return Status::success();
}

Status Runtime::writeElements(Field &field, const int64_t *indices,
                              int64_t count, const void *values) {
  const char *from = static_cast<const char *>(values);
  for (int64_t i = 0; i < count; ++i, indices += field.rank())
    for (int64_t c = 0; c < field.numComponents(); ++c) {
      Status status =
          change({HostWrite::What::Element, &field, from, indices, c});
      if (!status)
        return status;
      from += byteSize(field.scalar());
    }
  return Status::success();
}
