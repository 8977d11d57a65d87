//===- Constants.cpp - Python values compiled into code -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Constants.h"
#include "Safepoint.h"

#include <algorithm>
#include <cstring>

using namespace taipy;

namespace {

/// Compares by the method of the built-in type `base`, even if the type of `a`
/// overrides `==`.
bool isEqual(PyTypeObject &base, PyObject *a, PyObject *b) {
  PyObject *answer = base.tp_richcompare(a, b, Py_EQ);
  if (!answer) {
    forgetError();
    return false;
  }
  bool equal = answer == Py_True;
  Py_DECREF(answer);
  return equal;
}

PyTypeObject *plainBase(PyObject *value) {
  for (PyTypeObject *base : {&PyUnicode_Type, &PyBytes_Type, &PyComplex_Type})
    if (PyObject_TypeCheck(value, base))
      return base;
  return nullptr;
}

/// The bits of a number, which tell -0.0 from 0.0 and are equal for equal NaNs.
uint64_t bitsOf(double number) {
  uint64_t bits;
  std::memcpy(&bits, &number, sizeof bits);
  return bits;
}

bool isIterated(PyObject *value) {
  return PyAnySet_Check(value) ||
         std::strcmp(Py_TYPE(value)->tp_name, "collections.deque") == 0;
}

/// True if the value is memory of NumPy's or Python's own array types.
bool isBuffer(PyObject *value) {
  return PyObject_CheckBuffer(value) && !PyBytes_Check(value);
}

/// A view of an array with its format and extents.
class View {
public:
  explicit View(PyObject *value) {
    isValid = PyObject_GetBuffer(value, &buffer, PyBUF_FULL_RO) == 0;
    if (!isValid)
      forgetError();
  }
  ~View() {
    if (isValid)
      PyBuffer_Release(&buffer);
  }
  View(const View &) = delete;
  View &operator=(const View &) = delete;

  /// Returns the elements of an array in C order, as bytes.
  std::string contents() const {
    std::string bytes(static_cast<size_t>(buffer.len), '\0');
    if (buffer.len &&
        PyBuffer_ToContiguous(bytes.data(), &buffer, buffer.len, 'C') != 0)
      throw py::error_already_set();
    return bytes;
  }

  bool isValid = false;
  Py_buffer buffer;
};

} // namespace

Constant Constant::identity(py::handle value) {
  Constant made;
  made.object = py::reinterpret_borrow<py::object>(value);
  return made;
}

Constant Constant::weakly(py::handle value) {
  Constant made;
  made.kind = Kind::Weak;
  made.object =
      py::reinterpret_steal<py::object>(PyWeakref_NewRef(value.ptr(), nullptr));
  if (!made.object)
    throw py::error_already_set();
  return made;
}

Constant::Constant(py::handle given)
    : object(py::reinterpret_borrow<py::object>(given)) {
  PyObject *value = given.ptr();
  if (value == Py_None || PyBool_Check(value) || PyType_Check(value))
    return;
  type = py::reinterpret_borrow<py::object>(
      reinterpret_cast<PyObject *>(Py_TYPE(value)));
  if (PyLong_Check(value)) {
    kind = Kind::Integer;
  } else if (PyFloat_Check(value)) {
    kind = Kind::Float;
  } else if (plainBase(value)) {
    kind = Kind::Plain;
  } else if (PyTuple_Check(value) || PyList_Check(value)) {
    kind = Kind::Sequence;
    takeItems(value);
  } else if (PyDict_Check(value)) {
    kind = Kind::Mapping;
    auto flat = py::list();
    PyObject *key, *item;
    for (Py_ssize_t at = 0; PyDict_Next(value, &at, &key, &item);) {
      flat.append(py::handle(key));
      flat.append(py::handle(item));
    }
    takeItems(flat.ptr());
  } else if (isIterated(value)) {
    kind = Kind::Iterated;
    takeItems(py::list(object).ptr());
  } else if (PyRange_Check(value)) {
    kind = Kind::Range;
    takeItems(py::make_tuple(object.attr("start"), object.attr("stop"),
                             object.attr("step"))
                  .ptr());
  } else if (py::hasattr(type, "_tai_content")) {
    kind = Kind::Wrapped;
    py::object name = type.attr("_tai_content");
    items.push_back(Constant(object.attr(name)));
    object = name;
    return;
  } else if (!isBuffer(value) || !takeBuffer(value)) {
    type = py::object();
    return;
  }
  if (kind != Kind::Integer && kind != Kind::Float && kind != Kind::Plain)
    object = py::object();
}

void Constant::takeItems(PyObject *sequence) {
  if (Py_EnterRecursiveCall(" in a template argument"))
    throw py::error_already_set();
  Py_ssize_t count = PySequence_Fast_GET_SIZE(sequence);
  items.reserve(static_cast<size_t>(count));
  try {
    for (Py_ssize_t i = 0; i < PySequence_Fast_GET_SIZE(sequence); ++i)
      items.push_back(Constant(PySequence_Fast_GET_ITEM(sequence, i)));
  } catch (...) {
    Py_LeaveRecursiveCall();
    throw;
  }
  Py_LeaveRecursiveCall();
}

bool Constant::takeBuffer(PyObject *value) {
  View view(value);
  if (!view.isValid)
    return false;
  const Py_buffer &buffer = view.buffer;
  format = buffer.format ? buffer.format : "B";
  // The bytes of object elements are addresses, not values, so such arrays
  // cannot be compared.
  if (format.find('O') != std::string::npos)
    return false;
  kind = Kind::Buffer;
  shape.assign(buffer.shape, buffer.shape + buffer.ndim);
  bytes = view.contents();
  return true;
}

bool Constant::matchesBuffer(PyObject *given) const {
  View view(given);
  if (!view.isValid)
    return false;
  const Py_buffer &buffer = view.buffer;
  if (static_cast<size_t>(buffer.len) != bytes.size() ||
      static_cast<size_t>(buffer.ndim) != shape.size() ||
      !std::equal(shape.begin(), shape.end(), buffer.shape) ||
      format != (buffer.format ? buffer.format : "B"))
    return false;
  if (PyBuffer_IsContiguous(&buffer, 'C'))
    return std::memcmp(buffer.buf, bytes.data(), bytes.size()) == 0;
  return view.contents() == bytes;
}

bool Constant::matchesItems(PyObject *const *given, Py_ssize_t count) const {
  if (static_cast<size_t>(count) != items.size())
    return false;
  for (size_t i = 0; i < items.size(); ++i)
    if (!items[i].matches(given[i]))
      return false;
  return true;
}

bool Constant::matchesContents(PyObject *given) const {
  if (reinterpret_cast<PyObject *>(Py_TYPE(given)) != type.ptr())
    return false;
  switch (kind) {
  case Kind::Identity:
  case Kind::Weak:
    return matches(given);
  case Kind::Integer:
    return given == object.ptr() || isEqual(PyLong_Type, object.ptr(), given);
  case Kind::Float:
    return bitsOf(PyFloat_AS_DOUBLE(given)) ==
           bitsOf(PyFloat_AS_DOUBLE(object.ptr()));
  case Kind::Plain:
    if (PyComplex_Check(given)) {
      Py_complex a = PyComplex_AsCComplex(given);
      Py_complex b = PyComplex_AsCComplex(object.ptr());
      return bitsOf(a.real) == bitsOf(b.real) &&
             bitsOf(a.imag) == bitsOf(b.imag);
    }
    return given == object.ptr() ||
           isEqual(*plainBase(given), object.ptr(), given);
  case Kind::Sequence:
    return matchesItems(PySequence_Fast_ITEMS(given),
                        PySequence_Fast_GET_SIZE(given));
  case Kind::Mapping: {
    if (static_cast<size_t>(PyDict_GET_SIZE(given)) * 2 != items.size())
      return false;
    PyObject *key, *item;
    size_t i = 0;
    for (Py_ssize_t at = 0; PyDict_Next(given, &at, &key, &item); i += 2)
      if (!items[i].matches(key) || !items[i + 1].matches(item))
        return false;
    return true;
  }
  case Kind::Iterated: {
    PyObject *list = PySequence_List(given);
    if (!list) {
      forgetError();
      return false;
    }
    bool same =
        matchesItems(PySequence_Fast_ITEMS(list), PyList_GET_SIZE(list));
    Py_DECREF(list);
    return same;
  }
  case Kind::Range: {
    const char *names[] = {"start", "stop", "step"};
    for (size_t i = 0; i < 3; ++i) {
      PyObject *part = PyObject_GetAttrString(given, names[i]);
      bool same = part && items[i].matches(part);
      Py_XDECREF(part);
      if (!same) {
        forgetError();
        return false;
      }
    }
    return true;
  }
  case Kind::Buffer:
    return matchesBuffer(given);
  case Kind::Wrapped: {
    PyObject *contents = PyObject_GetAttr(given, object.ptr());
    if (!contents) {
      forgetError();
      return false;
    }
    bool same = items.front().matches(contents);
    Py_DECREF(contents);
    return same;
  }
  }
  return false;
}

bool Constant::canChange() const {
  switch (kind) {
  case Kind::Identity:
  case Kind::Weak:
  case Kind::Integer:
  case Kind::Float:
  case Kind::Plain:
  case Kind::Range:
    return false;
  case Kind::Sequence:
    return !PyType_IsSubtype(reinterpret_cast<PyTypeObject *>(type.ptr()),
                             &PyTuple_Type) ||
           std::any_of(items.begin(), items.end(),
                       [](const Constant &item) { return item.canChange(); });
  default:
    return true;
  }
}

int Constant::traverse(visitproc visit, void *arg) const {
  Py_VISIT(type.ptr());
  Py_VISIT(object.ptr());
  for (const Constant &item : items)
    if (int stop = item.traverse(visit, arg))
      return stop;
  return 0;
}

void Constant::clear() {
  // The constant matches no value from now on.
  kind = Kind::Identity;
  type = py::object();
  object = py::object();
  std::vector<Constant> gone;
  gone.swap(items);
}

bool Read::holds() const {
  // Reading the attribute may run Python code, which may drop the owner.
  auto held = py::reinterpret_borrow<py::object>(getOwner());
  if (!held)
    return false;
  PyObject *found = PyObject_GetAttr(held.ptr(), name.ptr());
  if (!found) {
    forgetError();
    return false;
  }
  bool same = value->matches(found);
  Py_DECREF(found);
  return same;
}

int Read::traverse(visitproc visit, void *arg) const {
  Py_VISIT(owner.ptr());
  Py_VISIT(name.ptr());
  Py_VISIT(constant.ptr());
  return 0;
}

/// The dictionary of an object if Python numbers the states of dictionaries, or
/// null.
static PyDictObject *numberedDict(PyObject *owner) {
#if PY_VERSION_HEX < 0x030c0000
  PyObject **at = _PyObject_GetDictPtr(owner);
  if (at && *at && PyDict_CheckExact(*at))
    return reinterpret_cast<PyDictObject *>(*at);
#endif
  return nullptr;
}

static uint64_t stateOf([[maybe_unused]] const PyDictObject *dict) {
#if PY_VERSION_HEX < 0x030c0000
  return dict->ma_version_tag;
#else
  return 0;
#endif
}

bool Reads::Stored::isAsSeen() const {
  // If the owner is gone, another object may have its address, so nothing
  // holds.
  if (reads.front().getOwner() != owner)
    return false;
  const PyDictObject *dict = numberedDict(owner);
  return dict && stateOf(dict) == state;
}

bool Reads::Stored::look() {
  for (const Read &read : reads)
    if (!read.holds())
      return false;
  if (reads.front().getOwner() != owner)
    return false;
  if (const PyDictObject *dict = numberedDict(owner))
    state = stateOf(dict);
  return true;
}

void Reads::add(const py::tuple &described) {
  Read read(described);
  PyObject *owner = read.getOwner();
  PyDictObject *dict =
      !owner || PyType_Check(owner) ? nullptr : numberedDict(owner);
  if (!dict || read.value->canChange() ||
      PyDict_Contains(reinterpret_cast<PyObject *>(dict), read.name.ptr()) !=
          1) {
    forgetError();
    others.push_back(std::move(read));
    return;
  }
  for (Stored &one : stored)
    if (one.owner == owner && one.reads.front().getOwner() == owner) {
      one.reads.push_back(std::move(read));
      return;
    }
  stored.push_back({owner, {}});
  stored.back().reads.push_back(std::move(read));
}

int Reads::traverse(visitproc visit, void *arg) const {
  for (const Stored &one : stored)
    for (const Read &read : one.reads)
      if (int stop = read.traverse(visit, arg))
        return stop;
  for (const Read &read : others)
    if (int stop = read.traverse(visit, arg))
      return stop;
  return 0;
}

void taipy::bindConstants(py::module_ &module) {
  auto setUp = [](PyHeapTypeObject *made) {
    PyTypeObject *type = &made->ht_type;
    type->tp_flags |= Py_TPFLAGS_HAVE_GC;
    type->tp_traverse = [](PyObject *self, visitproc visit, void *arg) {
      Py_VISIT(Py_TYPE(self));
      if (!py::detail::is_holder_constructed(self))
        return 0;
      return py::cast<Constant &>(py::handle(self)).traverse(visit, arg);
    };
    type->tp_clear = [](PyObject *self) {
      if (py::detail::is_holder_constructed(self))
        py::cast<Constant &>(py::handle(self)).clear();
      return 0;
    };
  };
  py::class_<Constant>(module, "Constant", py::custom_type_setup(setUp))
      .def(py::init<py::handle>())
      .def_static("identity", &Constant::identity)
      .def_static("weakly", &Constant::weakly)
      .def("matches", [](const Constant &constant, py::handle value) {
        return constant.matches(value.ptr());
      });
}
