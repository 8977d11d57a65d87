//===- ArrayArguments.h - Arrays that kernels are called with ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// What a call does with arrays, without running Python code: those of NumPy,
// `ti.ndarray`, and tensors of the CPU and of a GPU.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_ARRAYARGUMENTS_H
#define TAI_PYTHON_ARRAYARGUMENTS_H

#include "Core.h"
#include "Slots.h"

#include <vector>

namespace taipy {

enum class Match { Yes, No, Error };

/// An array that a specialisation takes.
struct ArrayArg {
  std::string format;           // struct format of a number
  int rank = 0;                 // dimensions, the element's included
  std::vector<int64_t> element; // extents of the element
  /// The kernel is differentiated by it: its gradient comes behind it.
  bool hasGradient = false;
  /// The annotation says how many dimensions belong to the element. Otherwise a
  /// `ti.ndarray` does, and of other arrays none.
  bool isElementFixed = false;
  bool isWritten = false;
};

/// What a launch does with the gradients of its arrays.
enum class ArrayUse {
  Forward,  // nothing
  Gradient, // adds to them
  Recorded  // a tape adds to them later
};

/// What must not go while a launch is made, and what that has to know.
class HeldArrays {
public:
  /// `mayAlias`: the kernel takes several arrays and writes to one.
  HeldArrays(const Kernel &kernel, ArrayUse use, bool mayAlias)
      : kernel(kernel), context(*kernel.context), use(use), mayAlias(mayAlias) {
  }
  ~HeldArrays();
  HeldArrays(const HeldArrays &) = delete;
  HeldArrays &operator=(const HeldArrays &) = delete;

  /// Adds the slots of an array. No: Python must look at it.
  Match pack(const ArrayArg &arg, PyObject *object, Slots &slots);
  /// To be called when all arguments have been packed: adds the gradients
  /// again, as adjoints. No where arrays overlap that must not: one of them is
  /// written, and it is not the same memory, or one has a gradient.
  Match finish(Slots &slots);

  /// The launch comes after what the libraries of the arrays have queued, and
  /// what they queue then after the launch. Null and a Python error if not.
  bool orderBefore();
  bool orderAfter();

private:
  struct Range {
    uint64_t begin, end;
    const ArrayArg *arg;
    bool overlaps(const Range &other) const {
      return begin < other.end && other.begin < end && begin != end &&
             other.begin != other.end;
    }
    bool isSame(const Range &other) const {
      return begin == other.begin && end == other.end &&
             arg->format == other.arg->format;
    }
  };

  bool orderStreams(TaiStatus (*order)(TaiContext, uint64_t));
  Match packBuffer(const ArrayArg &arg, PyObject *object, Slots &slots);
  Match packNdarray(const ArrayArg &arg, PyObject *object, Slots &slots);
  Match packTensor(const ArrayArg &arg, PyObject *object, Slots &slots);
  template <typename Packer>
  Match packGradient(PyObject *owner, PyObject *name, Slots &slots,
                     size_t first, Packer pack);
  const Range &addRange(const ArrayArg &arg, const Slots &slots, size_t first);
  bool isUsable(uint64_t address) const;
  Match matchTaped(const Range &range, PyObject *object, Slots &slots,
                   size_t first) const;
  bool mustNotMeet(const Range &one, const Range &other) const;

  const Kernel &kernel;
  Context &context;
  ArrayUse use;
  bool mayAlias;
  std::vector<Py_buffer> buffers;
  std::vector<PyObject *> objects;
  /// The arrays so far; those of most kernels lie in place.
  Range few[4];
  std::vector<Range> many;
  size_t numRanges = 0;
  Range *ranges = few;
  std::vector<uint64_t> adjoints;
  std::vector<uint64_t> streams;
};

/// A tape begins or goes on to record, or none does.
void setArrayTape(PyObject *tape);

void bindArrayArguments(py::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_ARRAYARGUMENTS_H
