//===- TensorView.h - Reading tensors of other libraries --------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_TENSORVIEW_H
#define TAI_PYTHON_TENSORVIEW_H

#include "Core.h"
#include "DLPack.h"

#include <array>

namespace taipy {

/// An interned string, created once.
struct Name {
  explicit Name(const char *text) : text(PyUnicode_InternFromString(text)) {}
  operator PyObject *() const { return text; }
  PyObject *text;
};

/// An attribute; null, and no Python error, if there is none.
inline PyObject *get(PyObject *object, const Name &name) {
  PyObject *found = PyObject_GetAttr(object, name);
  if (!found)
    PyErr_Clear();
  return found;
}

inline py::object take(PyObject *object) {
  return py::reinterpret_steal<py::object>(object);
}

/// Normalises the struct format of int64, which NumPy spells 'l' or 'q'.
inline char normal(char format) {
  return format == 'l' ? 'q' : format == 'L' ? 'Q' : format;
}

/// Cached facts about the type of an object.
struct TensorType {
  PyTypeObject *type;
  bool isTensor;
  const dlpack::ExchangeTable *table; // or null
};

/// The memory of a contiguous tensor.
struct TensorView {
  static constexpr int kMostDimensions = 8;

  uint64_t address = 0;
  int32_t deviceType = 0, deviceNumber = 0;
  int rank = 0;
  std::array<int64_t, kMostDimensions> shape{};
  /// The struct format, as in NumPy; 0 for an unsupported type.
  char format = 0;
  int itemBytes = 0;

  int64_t bytes() const {
    int64_t all = itemBytes;
    for (int d = 0; d < rank; ++d)
      all *= shape[static_cast<size_t>(d)];
    return all;
  }
};

TensorType findTensorType(PyObject *object);
/// False for a tensor that is not contiguous or not supported.
bool readTensor(const TensorType &type, PyObject *object, TensorView &view);
/// The current stream of the tensor's library. False and a Python error on
/// failure.
bool findStream(const TensorType &type, uint64_t &stream);

} // namespace taipy

#endif // TAI_PYTHON_TENSORVIEW_H
