//===- XlaCalls.cpp - Calls from compiled programs of XLA -----------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One handler for each platform, which XLA calls on a thread of its own. It
// shows the buffers to a function of Python without copying them: on the host
// as arrays of NumPy, on a GPU as addresses with the stream. The function
// launches kernels; tai/_impl/frameworks/jax_operators.py defines it.
//
//===----------------------------------------------------------------------===//

#include "Core.h"
#include "XlaFfi.h"

#include <cstring>
#include <pybind11/numpy.h>

using namespace taipy;
using namespace taipy::xla;

namespace {

/// The function of Python, which is never released: a call may come as late as
/// at the end of the process.
PyObject *callee = nullptr;

/// The type of elements in NumPy's notation; null for unsupported types.
const char *nameOf(int32_t type) {
  switch (type) {
  case kPred:
    return "?";
  case kS8:
    return "i1";
  case kS16:
    return "i2";
  case kS32:
    return "i4";
  case kS64:
    return "i8";
  case kU8:
    return "u1";
  case kU16:
    return "u2";
  case kU32:
    return "u4";
  case kU64:
    return "u8";
  case kF16:
    return "f2";
  case kF32:
    return "f4";
  case kF64:
    return "f8";
  default:
    return nullptr;
  }
}

py::dtype dtypeOf(int32_t type) {
  // The dtypes are kept for the life of the process.
  static PyObject *known[kF64 + 1] = {};
  if (!known[type])
    known[type] = py::dtype(nameOf(type)).release().ptr();
  return py::reinterpret_borrow<py::dtype>(known[type]);
}

std::vector<py::ssize_t> shapeOf(const Buffer &buffer) {
  return {buffer.extents, buffer.extents + buffer.rank};
}

py::object showOnHost(const Buffer &buffer, bool isCleared) {
  // Given a base object, the array does not copy the memory.
  py::array array(dtypeOf(buffer.type), shapeOf(buffer), buffer.data,
                  py::none());
  if (isCleared)
    std::memset(buffer.data, 0, static_cast<size_t>(array.nbytes()));
  return std::move(array);
}

py::object showOnDevice(const Buffer &buffer) {
  return py::make_tuple(reinterpret_cast<uint64_t>(buffer.data),
                        py::cast(shapeOf(buffer)), dtypeOf(buffer.type));
}

/// Shows all buffers. On the host, sets the first `cleared` ones to zero.
py::list show(const Buffers &buffers, bool isOnHost, int64_t cleared) {
  py::list shown;
  for (int64_t i = 0; i < buffers.count; ++i) {
    const auto &buffer = *static_cast<const Buffer *>(buffers.buffers[i]);
    if (!nameOf(buffer.type))
      throw py::type_error("kernels have no numbers of this type of XLA");
    shown.append(isOnHost ? showOnHost(buffer, i < cleared)
                          : showOnDevice(buffer));
  }
  return shown;
}

/// The whole numbers among the attributes, by name.
py::dict readAttributes(const Attributes &attributes) {
  py::dict read;
  for (int64_t i = 0; i < attributes.count; ++i) {
    if (attributes.kinds[i] != kScalar)
      continue;
    const auto &scalar = *static_cast<const Scalar *>(attributes.values[i]);
    if (scalar.type != kS64)
      continue;
    int64_t value;
    std::memcpy(&value, scalar.value, sizeof value);
    const Span &name = *attributes.names[i];
    read[py::str(name.data, name.length)] = value;
  }
  return read;
}

Error *fail(const CallFrame &frame, const std::string &message,
            ErrorCode code) {
  ErrorCreateArgs args{sizeof(ErrorCreateArgs), nullptr, message.c_str(), code};
  return frame.api->createError(&args);
}

Error *call(CallFrame *frame, bool isOnHost) {
  for (Extension *e = frame->extensions; e; e = e->next)
    if (e->type == kMetadataExtension) {
      // XLA asks for the metadata of a handler once, when the handler is
      // registered.
      Metadata *metadata = reinterpret_cast<MetadataExtension *>(e)->metadata;
      metadata->version.major = 0;
      metadata->version.minor = 1;
      metadata->traits = 0;
      return nullptr;
    }
  if (frame->stage != kExecute)
    return nullptr;
  void *stream = nullptr;
  if (!isOnHost) {
    StreamGetArgs args{sizeof(StreamGetArgs), nullptr, frame->context, nullptr};
    if (Error *error = frame->api->getStream(&args))
      return error;
    stream = args.stream;
  }
  if (!Py_IsInitialized())
    return fail(*frame, "the interpreter of Python has ended", kInternal);
  py::gil_scoped_acquire lock;
  try {
    if (!callee)
      return fail(*frame, "no kernels are registered", kInternal);
    py::handle function = callee;
    py::dict attributes = readAttributes(frame->attributes);
    int64_t cleared = attributes["cleared"].cast<int64_t>();
    function(attributes, show(frame->arguments, isOnHost, 0),
             show(frame->results, isOnHost, cleared),
             reinterpret_cast<uint64_t>(stream));
  } catch (py::error_already_set &error) {
    return fail(*frame, error.what(), kInternal);
  } catch (const std::exception &error) {
    return fail(*frame, error.what(), kInvalidArgument);
  }
  return nullptr;
}

Error *callOnHost(CallFrame *frame) { return call(frame, true); }
Error *callOnDevice(CallFrame *frame) { return call(frame, false); }

} // namespace

void taipy::bindXlaCalls(py::module_ &module) {
  module.def(
      "xla_handlers",
      [](py::object function) {
        Py_XDECREF(callee);
        callee = function.release().ptr();
        return py::make_tuple(
            py::capsule(reinterpret_cast<void *>(&callOnHost),
                        "xla._CUSTOM_CALL_TARGET"),
            py::capsule(reinterpret_cast<void *>(&callOnDevice),
                        "xla._CUSTOM_CALL_TARGET"));
      },
      "The handlers of XLA for the host and for a GPU. Both call `function("
      "attributes, operands, results, stream)`.");
}
