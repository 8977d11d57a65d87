//===- ArrayArguments.h - Array arguments of kernels ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Conversion of array arguments without running Python code: arrays of NumPy,
// `ti.ndarray`, and tensors on the CPU and on a GPU.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_ARRAYARGUMENTS_H
#define TAI_PYTHON_ARRAYARGUMENTS_H

#include "Core.h"
#include "Slots.h"
#include "TapedArrays.h"

#include <vector>

namespace taipy {

enum class Match { Yes, No, Error };

/// An array parameter of a specialisation.
struct ArrayArg {
  std::string format;           // struct format of a number
  int rank = 0;                 // dimensions, the element's included
  std::vector<int64_t> element; // extents of the element
  /// The kernel is differentiated with respect to the array, whose gradient is
  /// the next argument.
  bool hasGradient = false;
  /// The annotation specifies how many dimensions belong to the element.
  /// Otherwise a `ti.ndarray` specifies this, and elements of other arrays are
  /// scalars.
  bool isElementFixed = false;
  bool isWritten = false;
  /// The launch reads the array, and stores values that depend on it where
  /// torch does not know of the dependence.
  bool cutsGraph = false;
};

/// How a launch uses the gradients of its arrays.
enum class ArrayUse {
  Forward,  // nothing
  Gradient, // adds to them
  Recorded  // a tape adds to them later
};

/// The gradient of a tensor, passed beside the tensor.
struct Beside {
  /// The tensor to which the gradient is added; None for a tensor without a
  /// gradient.
  PyObject *gradient;
  /// If not 0, the address of contiguous memory of the tensor's size, which is
  /// used in place of the tensor and of its gradient.
  uint64_t copy = 0;
};

/// The arrays of one launch: keeps them alive, and checks them.
class HeldArrays {
public:
  /// `mayAlias`: the kernel takes several arrays and writes to one.
  /// `watches`: Python code must look at new arrays without a gradient.
  HeldArrays(const Kernel &kernel, ArrayUse use, bool mayAlias, bool watches)
      : kernel(kernel), context(*kernel.context), use(use), mayAlias(mayAlias),
        watches(watches) {}
  ~HeldArrays();
  HeldArrays(const HeldArrays &) = delete;
  HeldArrays &operator=(const HeldArrays &) = delete;

  /// Adds the slots of an array, which is an argument of this \p number. `No`
  /// means that Python code must handle the array.
  ///
  /// \p beside is null if the array has its gradient itself.
  Match pack(const ArrayArg &arg, PyObject *object, const Beside *beside,
             size_t number, Slots &slots);
  /// Call when all arguments of \p launcher have been packed and the launch is
  /// certain: appends the gradients, as adjoints, and notes the tensors for the
  /// tape. `No` for forbidden overlaps: of two overlapping arrays, one has a
  /// gradient, or one is written and the arrays are not identical.
  Match finish(PyObject *launcher, Slots &slots);

  /// Order the launch after the queued work of the arrays' libraries, and their
  /// later work after the launch. False, with a Python error, on failure.
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
  Match packTensor(const ArrayArg &arg, PyObject *object, const Beside *beside,
                   Slots &slots);
  template <typename Packer>
  Match packGradient(PyObject *owner, PyObject *name, Slots &slots,
                     size_t first, Packer pack);
  Match addGradient(Match match, Slots &slots, size_t first);
  const Range &addRange(const ArrayArg &arg, const Slots &slots, size_t first);
  bool isUsable(uint64_t address) const;
  Match matchTaped(const Range &range, PyObject *object, size_t number,
                   Slots &slots, size_t first);
  Match matchTensor(const Range &range, PyObject *object, size_t number,
                    const TapedArray *found, uint64_t gradient, size_t first);
  bool mustNotOverlap(const Range &one, const Range &other) const;

  const Kernel &kernel;
  Context &context;
  ArrayUse use;
  bool mayAlias, watches;
  bool isOnDevice = false; // the array that was packed last
  std::vector<Py_buffer> buffers;
  std::vector<PyObject *> objects;
  /// The arrays so far; stored inline for most kernels.
  Range few[4];
  std::vector<Range> many;
  size_t numRanges = 0;
  Range *ranges = few;
  std::vector<uint64_t> adjoints;
  std::vector<uint64_t> streams;
  /// Tensors that the tape is to note.
  std::vector<UsedTensor> used;
};

void bindArrayArguments(py::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_ARRAYARGUMENTS_H
