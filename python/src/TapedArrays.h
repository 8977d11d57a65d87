//===- TapedArrays.h - Arrays of the launches of a tape ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The arrays that the launches of the tape of a thread have used. Python code
// (tai/_impl/tracking/tape_arrays.py) keeps the complete record of them. Here
// is the part that launches without Python need, and tensors that only such
// launches have used, which are noted until Python code asks for them.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_TAPEDARRAYS_H
#define TAI_PYTHON_TAPEDARRAYS_H

#include "Core.h"

#include <unordered_map>
#include <vector>

namespace taipy {

/// An array that launches of the tape have used.
struct TapedArray {
  py::object owner;
  uint64_t begin, end;
  int64_t version;       // of a tensor, or -1
  uint64_t gradient = 0; // the address
  /// The version that the adjoints read: the address of a copy, or, if kernels
  /// change the array, the digest of its contents after the last launch.
  uint64_t frozen = 0;
  bool hasDigest = false;
  uint64_t digest = 0;
  /// A sample of the elements after the last launch that wrote the array.
  bool hasSample = false;
  uint64_t sample = 0;
};

/// A tensor that launches have used of which Python code knows nothing yet.
struct NotedTensor {
  py::object tensor;
  /// A tensor of the same memory, because a program may give the tensor other
  /// memory.
  py::object memory;
  py::object gradient; // or null
  int64_t version;
  /// The first launch that used it: the kernel, and the number of the argument.
  py::object launcher;
  size_t argument;
  bool isWritten, isOnDevice;
  /// True if a reverse sweep restores its former contents.
  bool isRestored;
};

/// The tensors of a tape of which Python code knows nothing yet.
struct NotedTensors {
  explicit NotedTensors(const py::object &tape)
      : owner(tape), tape(tape.cast<Tape &>()) {}

  py::object owner; // keeps the tape alive
  Tape &tape;
  std::vector<NotedTensor> tensors;
  std::unordered_map<PyObject *, size_t> places;
};

/// A tensor of a launch that is about to run.
struct UsedTensor {
  PyObject *tensor;
  PyObject *gradient; // or null
  uint64_t begin, end, gradientAddress;
  int64_t version;
  size_t argument;
  bool isWritten, isOnDevice;
  /// True if the launch changes contents that earlier launches have used.
  bool overwrites;
};

/// The entry of an array, or null. Other threads may change it whenever a call
/// of libtai waits.
TapedArray *findTaped(PyObject *object);

/// Whether launches without Python may use new tensors and write to tensors.
bool canNoteTensors();

/// Whether memory overlaps an array of the tape other than \p object.
bool overlapsOthers(const PyObject *object, uint64_t begin, uint64_t end);

/// Notes the tensors of a launch, and records that the contents which it
/// changes are restored by a reverse sweep. False, with a Python error, on
/// failure.
bool noteTensors(const std::vector<UsedTensor> &used, PyObject *launcher);

/// The largest tensor whose contents are saved without Python.
constexpr uint64_t mostSavedBytes = 1 << 20;

/// A hash of the bytes: two different contents have the same hash in one case
/// in 2⁶⁴.
uint64_t digest(uint64_t address, uint64_t bytes);
/// A hash of a sample of the bytes, for large arrays.
uint64_t sample(uint64_t address, uint64_t bytes);

/// Sets the tape that is recording, or None.
void setArrayTape(PyObject *tape);

void bindTapedArrays(py::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_TAPEDARRAYS_H
