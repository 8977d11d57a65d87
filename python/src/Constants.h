//===- Constants.h - Python values compiled into code -----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A template argument is part of the code of a kernel. `Constant` keeps a copy
// from when the kernel was compiled, and tells whether another value, or the
// same object later, has the same code. Python's `==` is not enough: it does
// not distinguish `1`, `1.0` and `True`, nor `0.0` and `-0.0`.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_CONSTANTS_H
#define TAI_PYTHON_CONSTANTS_H

#include "Core.h"

#include <string>
#include <vector>

namespace taipy {

/// Returns the object behind a weak reference, or null. The reference is
/// borrowed.
inline PyObject *referent(PyObject *weak) {
  PyObject *object = PyWeakref_GET_OBJECT(weak);
  return object == Py_None ? nullptr : object;
}

/// A snapshot of a Python value.
///
/// Numbers, texts, containers, arrays, matrices and structs match if their
/// types and contents are equal, bit by bit and in order. Any other value
/// matches only itself, by identity; a constant keeps the value alive unless it
/// is made by `weakly`.
class Constant {
public:
  /// A snapshot of a value and its contents.
  ///
  /// \throws py::error_already_set where it is nested too deeply.
  explicit Constant(py::handle value);

  /// Makes a constant that is the object itself, compared by identity.
  static Constant identity(py::handle value);
  /// The object, compared by identity but not kept alive. When the object is
  /// gone, nothing matches.
  static Constant weakly(py::handle value);

  bool matches(PyObject *given) const {
    return kind == Kind::Identity ? given == object.ptr()
           : kind == Kind::Weak   ? given == referent(object.ptr())
                                  : matchesContents(given);
  }

  /// True if the original object is mutable, so that its contents must be
  /// compared again.
  bool canChange() const;

  int traverse(visitproc visit, void *arg) const;
  void clear();

private:
  enum class Kind {
    Identity,
    Weak,
    Integer,
    Float,
    Plain,    // a complex number, text or bytes: equal and of one type
    Sequence, // a list or tuple
    Iterated, // another container: the items that iterating yields
    Mapping,  // a dict: keys and values in turn
    Buffer,   // a NumPy array or number
    Wrapped,  // an object whose contents are an attribute: `_tai_content`
    Range
  };

  Constant() = default;
  bool matchesContents(PyObject *given) const;
  bool matchesItems(PyObject *const *given, Py_ssize_t count) const;
  void takeItems(PyObject *sequence);
  bool takeBuffer(PyObject *value);
  bool matchesBuffer(PyObject *given) const;

  Kind kind = Kind::Identity;
  /// The Python type of the value; unused for identities.
  py::object type;
  /// The object or the weak reference to it, the number or the text; the name
  /// of the attribute of `Wrapped`.
  py::object object;
  std::vector<Constant> items;
  /// For `Buffer`: the elements, the format and the extents.
  std::string bytes, format;
  std::vector<Py_ssize_t> shape;
};

/// An attribute of an object that a kernel read while it was compiled.
struct Read {
  /// Makes a read from a tuple of the owner or a weak reference to it, the
  /// name, and the `Constant` of the attribute's value.
  explicit Read(const py::tuple &described)
      : owner(described[0]), name(described[1]), constant(described[2]),
        value(&constant.cast<const Constant &>()) {}

  /// True if the attribute still has the value that was read.
  bool holds() const;
  /// Returns the owner of the attribute, or null if the owner is gone.
  PyObject *getOwner() const {
    return PyWeakref_Check(owner.ptr()) ? referent(owner.ptr()) : owner.ptr();
  }

  int traverse(visitproc visit, void *arg) const;

  py::object owner, name;
  py::object constant;
  const Constant *value;
};

/// All attributes of template arguments that were read while a kernel was
/// compiled.
///
/// Checked at each launch. Before Python 3.12, dictionaries have version
/// numbers: while the number of an object's dictionary is unchanged, so are the
/// attributes in the dictionary, unless their values are mutable.
class Reads {
public:
  void add(const py::tuple &described);
  bool hold() {
    for (Stored &one : stored)
      if (!one.isAsSeen() && !one.look())
        return false;
    for (const Read &read : others)
      if (!read.holds())
        return false;
    return true;
  }

  int traverse(visitproc visit, void *arg) const;

private:
  /// The attributes that were read from the dictionary of one object.
  struct Stored {
    bool isAsSeen() const;
    bool look();

    PyObject *owner;
    std::vector<Read> reads;
    uint64_t state = 0;
  };

  std::vector<Stored> stored;
  std::vector<Read> others;
};

void bindConstants(py::module_ &module);

} // namespace taipy

#endif // TAI_PYTHON_CONSTANTS_H
