//===- Mesh.h - Exchanges between processes in Python -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_MESH_H
#define TAI_PYTHON_MESH_H

#include <pybind11/pybind11.h>

namespace taipy {

void bindMesh(pybind11::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_MESH_H
