//===- TensorView.cpp - Reading tensors of other libraries ----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Reads tensors by the C functions of DLPack's exchange table if the type has
// one, else by attributes, each of which takes as long as a launch.
//
//===----------------------------------------------------------------------===//

#include "TensorView.h"
#include "Safepoint.h"

#include <vector>

using namespace taipy;

static const dlpack::ExchangeTable *findTable(PyTypeObject *type) {
  static const Name name("__dlpack_c_exchange_api__");
  PyObject *capsule = get(reinterpret_cast<PyObject *>(type), name);
  if (!capsule)
    return nullptr;
  const dlpack::ExchangeTable *table = nullptr;
  if (PyCapsule_IsValid(capsule, dlpack::kTableName)) {
    // The table is never freed.
    table = static_cast<const dlpack::ExchangeTable *>(
        PyCapsule_GetPointer(capsule, dlpack::kTableName));
    if (table->major != 1 || !table->view || !table->currentStream)
      table = nullptr;
  }
  Py_DECREF(capsule);
  return table;
}

/// The properties of the type of an object, which are looked up once.
TensorType taipy::findTensorType(PyObject *object) {
  static std::vector<TensorType> known;
  PyTypeObject *type = Py_TYPE(object);
  for (const TensorType &entry : known)
    if (entry.type == type)
      return entry;
  auto *owner = reinterpret_cast<PyObject *>(type);
  TensorType entry{type, false, nullptr};
  constexpr size_t most = 32;
  if (known.size() >= most)
    return entry;
  entry.isTensor = PyObject_HasAttrString(owner, "data_ptr") &&
                   PyObject_HasAttrString(owner, "is_contiguous");
  if (entry.isTensor)
    entry.table = findTable(type);
  Py_INCREF(type);
  known.push_back(entry);
  return entry;
}

/// The format in NumPy's notation; 0 for a type that kernels do not support.
static char formatOf(const dlpack::Tensor &tensor) {
  if (tensor.lanes != 1)
    return 0;
  auto choose = [&](const char *formats) -> char {
    switch (tensor.bits) {
    case 8:
      return formats[0];
    case 16:
      return formats[1];
    case 32:
      return formats[2];
    case 64:
      return formats[3];
    }
    return 0;
  };
  switch (tensor.code) {
  case 0:
    return choose("bhiq");
  case 1:
    return choose("BHIQ");
  case 2:
    return choose("\0efd");
  case 6:
    return tensor.bits == 8 ? '?' : 0;
  }
  return 0;
}

/// Also returns false for memory that is not contiguous.
static bool readByTable(const dlpack::ExchangeTable &table, PyObject *object,
                        TensorView &view) {
  dlpack::Tensor tensor;
  if (table.view(object, &tensor) != 0) {
    forgetError();
    return false;
  }
  if (tensor.rank > TensorView::kMostDimensions)
    return false;
  view.address = reinterpret_cast<uint64_t>(tensor.data) + tensor.byteOffset;
  view.deviceType = tensor.deviceType;
  view.deviceNumber = tensor.deviceNumber;
  view.rank = tensor.rank;
  view.format = formatOf(tensor);
  view.itemBytes = tensor.bits / 8;
  int64_t step = 1;
  bool isDense = true;
  for (int d = tensor.rank; d-- > 0;) {
    view.shape[d] = tensor.shape[d];
    isDense &=
        !tensor.strides || tensor.shape[d] <= 1 || tensor.strides[d] == step;
    step *= tensor.shape[d];
  }
  return isDense || step == 0;
}

/// NumPy's character for a dtype, cached by dtype. Null if NumPy has no such
/// type.
static const char *readFormat(PyObject *dtype, int &itemBytes) {
  static PyObject *formats = PyDict_New();
  PyObject *found = PyDict_GetItemWithError(formats, dtype);
  if (!found) {
    forgetError();
    try {
      py::object type = py::module_::import("tai._impl.interop.device_arrays")
                            .attr("numpy_type")(py::handle(dtype));
      py::tuple made = py::make_tuple(type.attr("char"), type.attr("itemsize"));
      PyDict_SetItem(formats, dtype, made.ptr());
      found = made.ptr(); // which the dictionary keeps
    } catch (py::error_already_set &) {
      return nullptr;
    }
  }
  itemBytes = static_cast<int>(PyLong_AsLong(PyTuple_GET_ITEM(found, 1)));
  return PyUnicode_AsUTF8(PyTuple_GET_ITEM(found, 0));
}

static bool readByAttributes(PyObject *object, TensorView &view) {
  static const Name isCuda("is_cuda"), device("device"), index("index"),
      dtype("dtype"), shape("shape"), dataPtr("data_ptr"),
      isContiguous("is_contiguous");
  py::object onGpu = take(get(object, isCuda));
  if (!onGpu)
    return false;
  view.deviceType = onGpu.is(py::bool_(true)) ? dlpack::kCuda : dlpack::kCpu;
  if (view.deviceType == dlpack::kCuda) {
    py::object place = take(get(object, device));
    py::object number = place ? take(get(place.ptr(), index)) : place;
    if (!number)
      return false;
    view.deviceNumber = number.is_none() ? 0 : number.cast<int>();
  }
  py::object type = take(get(object, dtype));
  const char *format = type ? readFormat(type.ptr(), view.itemBytes) : nullptr;
  py::object extents = take(get(object, shape));
  if (!format || !extents || !PyTuple_Check(extents.ptr()) ||
      PyTuple_GET_SIZE(extents.ptr()) > TensorView::kMostDimensions)
    return false;
  view.format = *format;
  view.rank = static_cast<int>(PyTuple_GET_SIZE(extents.ptr()));
  for (int d = 0; d < view.rank; ++d)
    view.shape[d] = PyLong_AsLongLong(PyTuple_GET_ITEM(extents.ptr(), d));
  py::object dense = take(PyObject_CallMethodNoArgs(object, isContiguous));
  py::object address = take(PyObject_CallMethodNoArgs(object, dataPtr));
  if (!dense || !address || PyErr_Occurred()) {
    forgetError();
    return false;
  }
  view.address = PyLong_AsUnsignedLongLong(address.ptr());
  return dense.is(py::bool_(true));
}

bool taipy::readTensor(const TensorType &type, PyObject *object,
                       TensorView &view) {
  return type.table ? readByTable(*type.table, object, view)
                    : readByAttributes(object, view);
}

bool taipy::findStream(const TensorType &type, uint64_t &stream) {
  if (type.table) {
    void *found = nullptr;
    if (type.table->currentStream(dlpack::kCuda, 0, &found) != 0)
      return false;
    stream = reinterpret_cast<uint64_t>(found);
    return true;
  }
  try {
    stream = py::module_::import("tai._impl.interop.streams")
                 .attr("stream_number")(py::none())
                 .cast<uint64_t>();
    return true;
  } catch (py::error_already_set &error) {
    error.restore();
    return false;
  }
}
