//===- TapedArrays.cpp - Arrays of the launches of a tape -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapedArrays.h"
#include "TensorView.h"
#include "tai/Support/XXHash.h"

#include <cstring>
#include <utility>

using namespace taipy;

namespace {

/// The arrays of the tape that a thread records.
struct TapedArrays {
  /// The tape is kept alive, because otherwise another tape could get its
  /// address.
  py::object tape;
  std::unordered_map<PyObject *, TapedArray> arrays;
  /// Memory of arrays with strides.
  std::vector<std::pair<uint64_t, uint64_t>> others;
  /// Null if Python code must see each new tensor; its Python object.
  NotedTensors *noted = nullptr;
  py::object notedObject;
};
/// A pointer, since destructors at the end of a thread run without Python's
/// lock.
thread_local TapedArrays *taped = nullptr;

void forgetArrays() {
  // The pointer is cleared first, because destructors of the arrays may call
  // this function again.
  delete std::exchange(taped, nullptr);
}

/// The former contents of an array on the host.
struct SavedBytes {
  SavedBytes(uint64_t address, size_t bytes)
      : array(reinterpret_cast<char *>(address)), kept(array, array + bytes) {}

  char *array;
  std::vector<char> kept;
};

TaiStatus saveBytes(void *user) {
  auto *saved = static_cast<SavedBytes *>(user);
  std::memcpy(saved->kept.data(), saved->array, saved->kept.size());
  return TAI_OK;
}

TaiStatus restoreBytes(void *user) {
  auto *saved = static_cast<SavedBytes *>(user);
  std::memcpy(saved->array, saved->kept.data(), saved->kept.size());
  return TAI_OK;
}

void recordSaving(Tape &tape, uint64_t begin, uint64_t end) {
  auto saved = std::make_unique<SavedBytes>(begin, end - begin);
  py::capsule owner(saved.get(),
                    [](void *one) { delete static_cast<SavedBytes *>(one); });
  SavedBytes *one = saved.release();
  tape.kept.push_back(std::make_unique<py::object>(std::move(owner)));
  tape.context->check(
      taiTapeRecordCallback(tape.handle, &saveBytes, &restoreBytes, one));
}

/// A tensor of the same memory without a gradient.
py::object aliasOf(PyObject *tensor) {
  static const Name detach("detach");
  py::object alias = take(PyObject_CallMethodNoArgs(tensor, detach));
  if (!alias)
    throw py::error_already_set();
  return alias;
}

int64_t versionOf(PyObject *tensor) {
  static const Name version("_version");
  py::object now = take(get(tensor, version));
  return now && PyLong_Check(now.ptr()) ? PyLong_AsLongLong(now.ptr()) : -1;
}

/// Whether the tensors have the contents and the gradients that the launches
/// have used, and a sweep needs nothing else done for them.
bool areUnchanged(const NotedTensors &noted) {
  static const Name gradient("grad");
  for (const NotedTensor &one : noted.tensors) {
    if (one.isRestored || versionOf(one.tensor.ptr()) != one.version)
      return false;
    if (one.gradient && !take(get(one.tensor.ptr(), gradient)).is(one.gradient))
      return false;
  }
  return true;
}

void note(NotedTensors &noted, const UsedTensor &used, PyObject *launcher) {
  auto object = [](PyObject *borrowed) {
    return py::reinterpret_borrow<py::object>(borrowed);
  };
  auto known = noted.places.find(used.tensor);
  if (known == noted.places.end()) {
    py::object memory = aliasOf(used.tensor);
    noted.tape.kept.push_back(std::make_unique<py::object>(memory));
    if (used.gradient)
      noted.tape.kept.push_back(
          std::make_unique<py::object>(aliasOf(used.gradient)));
    known = noted.places.emplace(used.tensor, noted.tensors.size()).first;
    noted.tensors.push_back({object(used.tensor), std::move(memory),
                             object(used.gradient), used.version,
                             object(launcher), used.argument, false,
                             used.isOnDevice, false});
  }
  NotedTensor &one = noted.tensors[known->second];
  one.isWritten |= used.isWritten;
  one.isRestored |= used.overwrites;
  if (used.overwrites)
    recordSaving(noted.tape, used.begin, used.end);
}

/// [(tensor, memory, gradient, version, launcher, argument, is written, is
/// restored)], which are forgotten here.
py::list takeNoted(NotedTensors &noted) {
  py::list found;
  for (NotedTensor &one : noted.tensors)
    found.append(py::make_tuple(one.tensor, one.memory,
                                one.gradient ? one.gradient : py::none(),
                                one.version, one.launcher, one.argument,
                                one.isWritten, one.isRestored));
  noted.tensors.clear();
  noted.places.clear();
  return found;
}

} // namespace

TapedArray *taipy::findTaped(PyObject *object) {
  if (!taped)
    return nullptr;
  auto found = taped->arrays.find(object);
  return found == taped->arrays.end() ? nullptr : &found->second;
}

bool taipy::canNoteTensors() { return taped && taped->noted; }

bool taipy::overlapsOthers(const PyObject *object, uint64_t begin,
                           uint64_t end) {
  for (const auto &[other, entry] : taped->arrays)
    if (other != object && begin < entry.end && entry.begin < end)
      return true;
  for (const auto &[from, to] : taped->others)
    if (begin < to && from < end)
      return true;
  return false;
}

bool taipy::noteTensors(const std::vector<UsedTensor> &used,
                        PyObject *launcher) {
  // Python code that runs meanwhile may end the tape.
  py::object kept = taped->notedObject;
  NotedTensors *noted = taped->noted;
  try {
    for (const UsedTensor &one : used) {
      note(*noted, one, launcher);
      if (!taped)
        continue;
      auto owner = py::reinterpret_borrow<py::object>(one.tensor);
      TapedArray &entry =
          taped->arrays
              .try_emplace(one.tensor,
                           TapedArray{owner, one.begin, one.end, one.version})
              .first->second;
      entry.gradient = one.gradientAddress;
    }
    return true;
  } catch (py::error_already_set &error) {
    error.restore();
    return false;
  }
}

uint64_t taipy::digest(uint64_t address, uint64_t bytes) {
  return mlir::tai::runtime::xxh64(reinterpret_cast<const void *>(address),
                                   bytes);
}

uint64_t taipy::sample(uint64_t address, uint64_t bytes) {
  constexpr uint64_t pieces = 32, size = 64;
  if (bytes <= pieces * size)
    return digest(address, bytes);
  uint64_t result = 0, step = (bytes - size) / (pieces - 1);
  for (uint64_t i = 0; i < pieces; ++i)
    result = result * 31 + digest(address + i * step, size);
  return result;
}

void taipy::setArrayTape(PyObject *tape) {
  // Without a tape, while a function runs that is not recorded, the arrays of
  // the last tape stay.
  if (!tape || (taped && taped->tape.ptr() == tape))
    return;
  forgetArrays();
  taped = new TapedArrays{
      py::reinterpret_borrow<py::object>(tape), {}, {}, nullptr, {}};
}

void taipy::bindTapedArrays(py::module_ &module) {
  // A capsule, since pybind11 allocates memory for objects of its classes where
  // no exception is caught.
  module.def("note_tensors", [](const py::object &tape) {
    auto noted = std::make_unique<NotedTensors>(tape);
    py::capsule owner(noted.get(), [](void *one) {
      delete static_cast<NotedTensors *>(one);
    });
    noted.release();
    return owner;
  });
  module.def("are_noted_unchanged", [](const py::capsule &noted) {
    return areUnchanged(*noted.get_pointer<NotedTensors>());
  });
  module.def("take_noted", [](const py::capsule &noted) {
    return takeNoted(*noted.get_pointer<NotedTensors>());
  });
  // A tensor on a GPU, or None.
  module.def("noted_on_device", [](const py::capsule &noted) -> py::object {
    for (const NotedTensor &one : noted.get_pointer<NotedTensors>()->tensors)
      if (one.isOnDevice)
        return one.memory;
    return py::none();
  });
  // From now on, launches of the tape that this thread records note tensors.
  module.def("follow_tensors", [](const py::capsule &noted) {
    auto *tensors = noted.get_pointer<NotedTensors>();
    if (!taped || !taped->tape.is(tensors->owner))
      return;
    taped->notedObject = noted;
    taped->noted = tensors;
  });
  module.def("note_taped_array", [](const py::object &array, uint64_t address,
                                    uint64_t bytes, int64_t version) {
    if (!taped)
      return;
    auto [entry, isNew] = taped->arrays.try_emplace(
        array.ptr(), TapedArray{array, address, address + bytes, version});
    entry->second.begin = address;
    entry->second.end = address + bytes;
    entry->second.version = version;
    entry->second.frozen = 0;
    entry->second.hasDigest = false;
    entry->second.hasSample = false;
  });
  // Notes the memory of an array with strides, from its first byte to its last.
  module.def("note_taped_memory", [](uint64_t begin, uint64_t end) {
    if (taped)
      taped->others.push_back({begin, end});
  });
  // Notes that adjoints read a copy of the array, at this address.
  module.def("note_frozen_array", [](const py::object &array, uint64_t frozen) {
    if (TapedArray *found = findTaped(array.ptr()))
      found->frozen = frozen;
  });
  // Notes that adjoints read the array itself, which must keep this digest.
  module.def("note_array_digest", [](const py::object &array, uint64_t value) {
    if (TapedArray *found = findTaped(array.ptr())) {
      found->hasDigest = true;
      found->digest = value;
    }
  });
  // Notes a sample of an array that adjoints read and kernels write: if the
  // sample changes, Python has written the array, too.
  module.def("note_array_sample", [](const py::object &array, uint64_t value) {
    if (TapedArray *found = findTaped(array.ptr())) {
      found->hasSample = true;
      found->sample = value;
    }
  });
  module.def("digest", &digest);
  module.def("sample", &sample);
  module.def("note_taped_gradient",
             [](const py::object &array, uint64_t address) {
               if (TapedArray *found = findTaped(array.ptr()))
                 found->gradient = address;
             });
  module.def("forget_taped_arrays", &forgetArrays);
}
