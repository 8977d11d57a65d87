//===- Interop.cpp - Array exchange with other libraries ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The binary interface of DLPack, in both forms: capsules "dltensor", and those
// with a version and flags. Their contents are decided in
// tai/_impl/interop/sharing.py.
//
//===----------------------------------------------------------------------===//

#include "Core.h"
#include "DLPack.h"

#include <cstring>
#include <vector>

using namespace taipy;
using namespace taipy::dlpack;

namespace {

template <typename M> constexpr const char *nameOf();
template <> constexpr const char *nameOf<Managed>() { return "dltensor"; }
template <> constexpr const char *nameOf<ManagedVersioned>() {
  return "dltensor_versioned";
}
template <typename M> constexpr const char *usedNameOf();
template <> constexpr const char *usedNameOf<Managed>() {
  return "used_dltensor";
}
template <> constexpr const char *usedNameOf<ManagedVersioned>() {
  return "used_dltensor_versioned";
}

/// The data that a DLPack capsule made by this module points to.
template <typename M> struct Export {
  M managed{};
  std::vector<int64_t> shape, strides;
  PyObject *owner = nullptr;
};

template <typename M> void deleteExport(M *managed) {
  auto *made = static_cast<Export<M> *>(managed->owner);
  // Consumers release tensors on any thread, and some after the interpreter has
  // ended.
  if (Py_IsInitialized()) {
    PyGILState_STATE state = PyGILState_Ensure();
    Py_XDECREF(made->owner);
    PyGILState_Release(state);
  }
  delete made;
}

/// The destructor of a capsule that was not taken.
template <typename M> void destroyCapsule(PyObject *capsule) {
  if (!PyCapsule_IsValid(capsule, nameOf<M>()))
    return;
  auto *managed = static_cast<M *>(PyCapsule_GetPointer(capsule, nameOf<M>()));
  if (managed && managed->deleter)
    managed->deleter(managed);
}

template <typename M>
py::object makeCapsule(uint64_t address, std::vector<int64_t> shape,
                       std::vector<int64_t> strides, int code, int bits,
                       int deviceType, const py::object &owner) {
  auto made = std::make_unique<Export<M>>();
  made->shape = std::move(shape);
  made->strides = std::move(strides);
  dlpack::Tensor &tensor = made->managed.tensor;
  tensor.data = reinterpret_cast<void *>(address);
  tensor.deviceType = deviceType;
  tensor.rank = static_cast<int32_t>(made->shape.size());
  tensor.code = static_cast<uint8_t>(code);
  tensor.bits = static_cast<uint8_t>(bits);
  tensor.lanes = 1;
  tensor.shape = made->shape.data();
  tensor.strides = made->strides.data();
  made->managed.owner = made.get();
  made->managed.deleter = deleteExport<M>;
  if constexpr (std::is_same_v<M, ManagedVersioned>)
    made->managed.major = 1;
  PyObject *capsule =
      PyCapsule_New(&made->managed, nameOf<M>(), destroyCapsule<M>);
  if (!capsule)
    throw py::error_already_set();
  made->owner = owner.inc_ref().ptr();
  (void)made.release();
  return py::reinterpret_steal<py::object>(capsule);
}

/// Releases the tensor that was taken out of a capsule.
template <typename M> void destroyTaken(PyObject *capsule) {
  auto *managed =
      static_cast<M *>(PyCapsule_GetPointer(capsule, usedNameOf<M>()));
  if (managed && managed->deleter)
    managed->deleter(managed);
}

template <typename M> py::dict takeFrom(const py::object &capsule) {
  auto *managed =
      static_cast<M *>(PyCapsule_GetPointer(capsule.ptr(), nameOf<M>()));
  if (!managed)
    throw py::error_already_set();
  const dlpack::Tensor &tensor = managed->tensor;
  py::dict result;
  result["address"] =
      reinterpret_cast<uint64_t>(tensor.data) + tensor.byteOffset;
  result["device"] = py::make_tuple(tensor.deviceType, tensor.deviceNumber);
  result["type"] = py::make_tuple(tensor.code, tensor.bits, tensor.lanes);
  py::tuple shape(tensor.rank), strides(tensor.rank);
  int64_t step = 1;
  for (int32_t d = tensor.rank; d-- > 0;) {
    shape[d] = tensor.shape[d];
    strides[d] = tensor.strides ? tensor.strides[d] : step;
    step *= tensor.shape[d];
  }
  result["shape"] = shape;
  result["strides"] = strides;
  bool readOnly = false;
  if constexpr (std::is_same_v<M, ManagedVersioned>)
    readOnly = managed->flags & kReadOnly;
  result["read_only"] = readOnly;
  // `owner` has the name of capsules whose tensor was taken: no consumer can
  // take the tensor again, and destroyTaken releases it.
  PyObject *owner = PyCapsule_New(managed, usedNameOf<M>(), destroyTaken<M>);
  if (!owner)
    throw py::error_already_set();
  result["owner"] = py::reinterpret_steal<py::object>(owner);
  PyCapsule_SetName(capsule.ptr(), usedNameOf<M>());
  PyCapsule_SetDestructor(capsule.ptr(), nullptr);
  return result;
}

/// Device memory in which Python keeps copies of arrays.
struct DeviceMemory {
  DeviceMemory(ContextRef from, int64_t bytes)
      : context(std::move(from)), bytes(bytes) {
    context->check(
        taiContextAllocateOnDevice(context->handle, bytes, &address));
  }
  ~DeviceMemory() {
    Teardown teardown;
    taiContextFreeOnDevice(context->handle, address);
  }
  DeviceMemory(const DeviceMemory &) = delete;
  DeviceMemory &operator=(const DeviceMemory &) = delete;

  void save(uint64_t from) {
    context->check(taiContextCopyOnDevice(
        context->handle, address, reinterpret_cast<const void *>(from), bytes));
  }
  void restore(uint64_t to) {
    context->check(taiContextCopyOnDevice(
        context->handle, reinterpret_cast<void *>(to), address, bytes));
  }

  ContextRef context;
  int64_t bytes;
  void *address = nullptr;
};

} // namespace

void taipy::bindInterop(py::module_ &module) {
  py::class_<DeviceMemory>(module, "DeviceMemory")
      .def(py::init<ContextRef, int64_t>())
      .def("save", &DeviceMemory::save)
      .def("restore", &DeviceMemory::restore)
      .def_property_readonly("address", [](const DeviceMemory &m) {
        return reinterpret_cast<uint64_t>(m.address);
      });
  // Strides count elements.
  module.def("make_dlpack", [](uint64_t address, std::vector<int64_t> shape,
                               std::vector<int64_t> strides, int code, int bits,
                               int deviceType, const py::object &owner,
                               bool versioned) {
    return versioned ? makeCapsule<ManagedVersioned>(address, std::move(shape),
                                                     std::move(strides), code,
                                                     bits, deviceType, owner)
                     : makeCapsule<Managed>(address, std::move(shape),
                                            std::move(strides), code, bits,
                                            deviceType, owner);
  });
  module.def("take_dlpack", [](const py::object &capsule) {
    if (PyCapsule_IsValid(capsule.ptr(), nameOf<ManagedVersioned>()))
      return takeFrom<ManagedVersioned>(capsule);
    return takeFrom<Managed>(capsule);
  });
}
