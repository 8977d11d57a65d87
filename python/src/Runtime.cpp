//===- Runtime.cpp - Contexts, fields, kernels and tapes ------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Core.h"

#include <cstring>
#include <map>
#include <vector>

using namespace taipy;

namespace taipy {

void setError(TaiContext context, TaiStatus status) {
  TaiError error = taiContextLastError(context);
  try {
    py::object make = py::module_::import("tai.errors").attr("from_core");
    auto text = [](const char *string) {
      return py::str(string ? string : "");
    };
    py::object exception =
        make(static_cast<int>(status), text(error.message), text(error.file),
             error.line, error.column, text(error.diagnostics));
    PyErr_SetObject(reinterpret_cast<PyObject *>(Py_TYPE(exception.ptr())),
                    exception.ptr());
  } catch (py::error_already_set &failure) {
    failure.restore();
  } catch (...) {
    PyErr_NoMemory();
  }
}

void Context::raise(TaiStatus status) const {
  setError(handle, status);
  throw py::error_already_set();
}

} // namespace taipy

namespace {

struct Field {
  ContextRef context;
  TaiField handle = nullptr;
  TaiFieldInfo info;

  Field() = default;
  Field(const Field &) = delete;
  Field &operator=(const Field &) = delete;
  ~Field() {
    Teardown teardown;
    if (handle)
      taiFieldRelease(handle);
  }

  bool isFloat() const {
    return info.type == TAI_F16 || info.type == TAI_BF16 ||
           info.type == TAI_F32 || info.type == TAI_F64;
  }
  int64_t numComponents() const {
    int64_t count = 1;
    for (int d = 0; d < info.element_rank; ++d)
      count *= info.element_shape[d];
    return count;
  }
  int64_t numScalars() const {
    int64_t count = numComponents();
    for (int d = 0; d < info.rank; ++d)
      count *= info.shape[d];
    return count;
  }
  int64_t scalarSize() const {
    switch (info.type) {
    case TAI_I1:
    case TAI_I8:
      return 1;
    case TAI_I16:
    case TAI_F16:
    case TAI_BF16:
      return 2;
    case TAI_I32:
    case TAI_F32:
      return 4;
    case TAI_I64:
    case TAI_F64:
      return 8;
    }
    return 8;
  }
};

/// The indices of one element. The rank and the range are checked in Python's
/// terms here, so that the message can name the indices as written.
std::vector<int64_t> toIndices(const Field &field, const py::tuple &indices) {
  if (static_cast<int>(indices.size()) != field.info.rank)
    throw py::index_error("expects " + std::to_string(field.info.rank) +
                          (field.info.rank == 1 ? " index" : " indices") +
                          ", but got " + std::to_string(indices.size()));
  std::vector<int64_t> result;
  result.reserve(indices.size());
  for (size_t d = 0; d < indices.size(); ++d) {
    PyObject *number = PyNumber_Index(indices[d].ptr());
    if (!number)
      throw py::error_already_set();
    int64_t index = PyLong_AsLongLong(number);
    Py_DECREF(number);
    if (index == -1 && PyErr_Occurred())
      throw py::error_already_set();
    int64_t low = field.info.offset[d], high = low + field.info.shape[d];
    if (index < low || index >= high)
      throw py::index_error(
          "index " + std::to_string(index) + " is out of range for dimension " +
          std::to_string(d) + ", which runs from " + std::to_string(low) +
          " to " + std::to_string(high - 1));
    result.push_back(index);
  }
  return result;
}

py::object readAt(const Field &field, const std::vector<int64_t> &at,
                  int64_t component) {
  if (field.isFloat()) {
    double value = 0;
    field.context->check(
        taiFieldReadF64(field.handle, at.data(), component, &value));
    return py::float_(value);
  }
  int64_t value = 0;
  field.context->check(
      taiFieldReadI64(field.handle, at.data(), component, &value));
  return py::int_(value);
}

py::object readElement(const Field &field, const py::tuple &indices,
                       int64_t component) {
  return readAt(field, toIndices(field, indices), component);
}

/// Reads all components of one element of a field.
py::list readAll(const Field &field, const py::tuple &indices) {
  std::vector<int64_t> at = toIndices(field, indices);
  py::list values(field.numComponents());
  for (size_t component = 0; component < values.size(); ++component)
    values[component] = readAt(field, at, static_cast<int64_t>(component));
  return values;
}

std::vector<TaiField> handlesOf(const std::vector<Field *> &fields) {
  std::vector<TaiField> handles;
  handles.reserve(fields.size());
  for (const Field *field : fields)
    handles.push_back(field->handle);
  return handles;
}

void writeAt(const Field &field, const std::vector<int64_t> &at,
             int64_t component, const py::object &value) {
  if (field.isFloat()) {
    double number = PyFloat_AsDouble(value.ptr());
    if (number == -1.0 && PyErr_Occurred())
      throw py::error_already_set();
    field.context->check(
        taiFieldWriteF64(field.handle, at.data(), component, number));
    return;
  }
  py::object whole =
      py::reinterpret_steal<py::object>(PyNumber_Long(value.ptr()));
  if (!whole)
    throw py::error_already_set();
  // Unsigned values of 64 bits are stored as the same bits.
  int64_t number =
      static_cast<int64_t>(PyLong_AsUnsignedLongLongMask(whole.ptr()));
  if (PyErr_Occurred())
    throw py::error_already_set();
  field.context->check(
      taiFieldWriteI64(field.handle, at.data(), component, number));
}

void writeElement(const Field &field, const py::tuple &indices,
                  int64_t component, const py::object &value) {
  writeAt(field, toIndices(field, indices), component, value);
}

void writeAll(const Field &field, const py::tuple &indices,
              const py::sequence &values) {
  std::vector<int64_t> at = toIndices(field, indices);
  for (size_t component = 0; component < values.size(); ++component)
    writeAt(field, at, static_cast<int64_t>(component), values[component]);
}

/// Checks that a buffer is a C-contiguous array of all scalars of the field.
struct ArrayView {
  ArrayView(const Field &field, const py::object &array, bool writable) {
    int flags = PyBUF_C_CONTIGUOUS | (writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(array.ptr(), &view, flags) != 0)
      throw py::error_already_set();
    // NumPy has no bf16: its numbers are f32 in Python.
    int64_t size = field.info.type == TAI_BF16 ? 4 : field.scalarSize();
    if (view.len != field.numScalars() * size) {
      PyBuffer_Release(&view);
      throw py::value_error("the array has not the size of the field");
    }
  }
  ~ArrayView() { PyBuffer_Release(&view); }
  Py_buffer view;
};

/// Rounds f32 numbers to the nearest bf16, ties to even.
std::vector<uint16_t> toBfloats(const void *numbers, int64_t count) {
  std::vector<uint16_t> result(count);
  for (int64_t i = 0; i < count; ++i) {
    uint32_t bits;
    std::memcpy(&bits, static_cast<const char *>(numbers) + 4 * i, 4);
    bool isNaN = (bits & 0x7fffffff) > 0x7f800000;
    result[i] = isNaN ? (bits >> 16) | 0x40
                      : (bits + 0x7fff + ((bits >> 16) & 1)) >> 16;
  }
  return result;
}

void fromBfloats(const std::vector<uint16_t> &numbers, void *result) {
  for (size_t i = 0; i < numbers.size(); ++i) {
    uint32_t bits = uint32_t(numbers[i]) << 16;
    std::memcpy(static_cast<char *>(result) + 4 * i, &bits, 4);
  }
}

/// Runs one of a pair of Python callables without arguments for the tape. An
/// exception stays set and becomes a failure of the sweep.
TaiStatus callBack(void *pair, int which) {
  retakeLock();
  PyObject *callable =
      PyTuple_GET_ITEM(static_cast<py::object *>(pair)->ptr(), which);
  PyObject *result = PyObject_CallNoArgs(callable);
  if (!result)
    return TAI_ERROR_RUNTIME;
  Py_DECREF(result);
  return TAI_OK;
}

/// Throws the exception of a callback, or else the failure of the sweep.
void checkSweep(Tape &tape, TaiStatus status) {
  (void)afterCall();
  if (PyErr_Occurred())
    throw py::error_already_set();
  tape.context->check(status);
}

/// (total, [(kind, field, indices, component, access, earlier)]), where an
/// access is (kernel, launch, kind, file, line, column).
py::tuple getViolations(Tape &tape) {
  const TaiViolation *rows = nullptr;
  int64_t count = 0, total = 0;
  tape.context->check(taiTapeViolations(tape.handle, &rows, &count, &total));
  auto place = [](const TaiAccessPlace &p) {
    return py::make_tuple(p.kernel, p.launch, p.kind, p.file, p.line, p.column);
  };
  py::list list;
  for (const TaiViolation *row = rows; row != rows + count; ++row) {
    py::list indices;
    for (int32_t i = 0; i != row->rank; ++i)
      indices.append(row->indices[i]);
    list.append(py::make_tuple(row->kind, row->field, py::tuple(indices),
                               row->component, place(row->access),
                               place(row->earlier)));
  }
  return py::make_tuple(total, list);
}

void bindTape(py::module_ &module) {
  py::class_<Tape>(module, "Tape")
      .def(py::init<>())
      .def(
          "end",
          [](Tape &t, bool isSwept) {
            t.context->check(isSwept ? taiTapeEndToSweep(t.handle)
                                     : taiTapeEnd(t.handle));
          },
          py::arg("is_swept") = false)
      .def("clear_gradients",
           [](Tape &t) { t.context->check(taiTapeClearGradients(t.handle)); })
      .def("backward",
           [](Tape &t) { checkSweep(t, taiTapeBackward(t.handle)); })
      .def("replay",
           [](Tape &t, bool forward, bool backward) {
             checkSweep(t, taiTapeReplay(t.handle, forward, backward));
           })
      .def("suspend",
           [](Tape &t) { t.context->check(taiTapeSuspend(t.handle)); })
      .def("resume", [](Tape &t) { t.context->check(taiTapeResume(t.handle)); })
      .def("keep",
           [](Tape &t, py::object object) {
             t.kept.push_back(std::make_unique<py::object>(std::move(object)));
           })
      .def("record",
           [](Tape &t, const py::object &forward, const py::object &backward) {
             t.hostFunctions[settled(taiTapeNumRecords(t.handle))] = forward;
             // One user pointer serves both directions: a pair of callables.
             bool reverses = !backward.is_none();
             auto pair = std::make_unique<py::object>(
                 py::make_tuple(forward, backward));
             void *user = pair.get();
             t.kept.push_back(std::move(pair));
             t.context->check(taiTapeRecordCallback(
                 t.handle, [](void *user) { return callBack(user, 0); },
                 reverses ? +[](void *user) { return callBack(user, 1); }
                          : nullptr,
                 user));
           })
      .def("note_array_copy",
           [](Tape &t, uint64_t address, uint64_t begin, uint64_t end,
              uint64_t step, uint64_t bytes) {
             const auto *at = reinterpret_cast<const void *>(address);
             taiTapeNoteArrayCopy(t.handle, at, {begin, end, step, bytes});
             settle();
           })
      .def("note_array_write",
           [](Tape &t, uint64_t begin, uint64_t end, uint64_t step,
              uint64_t bytes) {
             taiTapeNoteArrayWrite(t.handle, {begin, end, step, bytes});
             settle();
           })
      .def("want",
           [](Tape &t, const std::vector<Field *> &fields) {
             std::vector<TaiField> handles;
             for (const Field *field : fields)
               handles.push_back(field->handle);
             auto count = static_cast<int64_t>(handles.size());
             t.context->check(taiTapeWant(t.handle, handles.data(), count));
           })
      .def("skip_unchanged",
           [](Tape &t) { t.context->check(taiTapeSkipUnchanged(t.handle)); })
      .def("add_loss",
           [](Tape &t, const Field &loss) {
             t.context->check(taiTapeAddLoss(t.handle, loss.handle));
           })
      .def("set_seed",
           [](Tape &t, const Field &loss, const py::buffer &array) {
             t.context->check(
                 taiTapeSetSeed(t.handle, loss.handle, array.request().ptr));
           })
      .def(
          "set_checkpoint",
          [](Tape &t, int kind, int64_t snapshots, int64_t budget) {
            t.context->check(taiTapeSetCheckpoint(
                t.handle, static_cast<TaiCheckpoint>(kind), snapshots, budget));
          })
      .def("save",
           [](Tape &t, const std::string &path, const Field &loss,
              const std::vector<const Field *> &fields) {
             std::vector<TaiField> handles;
             for (const Field *field : fields)
               handles.push_back(field->handle);
             t.context->check(taiTapeSave(
                 t.handle, path.c_str(), loss.handle, handles.data(),
                 static_cast<int64_t>(handles.size())));
           })
      .def("stats",
           [](Tape &t) {
             TaiTapeStats stats;
             t.context->check(taiTapeGetStats(t.handle, &stats));
             return py::make_tuple(stats.saved_bytes, stats.peak_bytes,
                                   stats.snapshots, stats.snapshot_bytes,
                                   stats.recomputed, stats.optimum);
           })
      .def("warnings",
           [](Tape &t) {
             std::vector<std::string> lines;
             while (const char *line = settled(taiTapeWarning(
                        t.handle, static_cast<int64_t>(lines.size()))))
               lines.push_back(line);
             return lines;
           })
      .def("explain",
           [](Tape &t) {
             const char *text = settled(taiTapeExplain(t.handle));
             if (!text)
               throw std::bad_alloc();
             return std::string(text);
           })
      .def_property_readonly(
          "records",
          [](Tape &t) { return settled(taiTapeNumRecords(t.handle)); })
      .def_property_readonly(
          "skipped",
          [](Tape &t) { return settled(taiTapeNumSkipped(t.handle)); })
      .def("run_record",
           [](Tape &t, int64_t record) {
             checkSweep(t, taiTapeRunRecord(t.handle, record));
           })
      .def("kernel_of",
           [](Tape &t, int64_t record) -> py::object {
             const char *name = settled(taiTapeRecordKernel(t.handle, record));
             return name ? py::object(py::str(name)) : py::object(py::none());
           })
      .def("host_function",
           [](Tape &t, int64_t record) -> py::object {
             auto found = t.hostFunctions.find(record);
             return found == t.hostFunctions.end() ? py::object(py::none())
                                                   : found->second;
           })
      .def("accesses",
           [](Tape &t, int64_t record) {
             const TaiTapeAccess *rows = nullptr;
             int64_t count = 0;
             t.context->check(
                 taiTapeRecordAccesses(t.handle, record, &rows, &count));
             py::list result;
             for (const TaiTapeAccess *row = rows; row != rows + count; ++row)
               result.append(py::make_tuple(row->field, row->kind,
                                            row->dimension, row->index));
             return result;
           })
      .def("watch_health",
           [](Tape &t, bool on) {
             t.context->check(taiTapeWatchHealth(t.handle, on));
           })
      .def("check_accesses",
           [](Tape &t, int64_t limit, bool racesOnly) {
             t.context->check(taiTapeCheckAccesses(t.handle, limit, racesOnly));
           })
      .def("violations", &getViolations)
      .def("health", [](Tape &t) {
        const TaiTapeHealthRow *rows = nullptr;
        int64_t count = 0;
        t.context->check(taiTapeHealth(t.handle, &rows, &count));
        py::list result;
        for (const TaiTapeHealthRow *row = rows; row != rows + count; ++row)
          result.append(py::make_tuple(row->record, row->field, row->nans,
                                       row->infs, row->max_abs, row->norm));
        return result;
      });
}

void bindField(py::module_ &module) {
  py::class_<Field>(module, "Field")
      .def("get", &readElement)
      .def("set", &writeElement)
      .def("get_all", &readAll)
      .def("set_all", &writeAll)
      .def("fill",
           [](Field &f, const py::object &value) {
             if (f.isFloat())
               f.context->check(
                   taiFieldFillF64(f.handle, value.cast<double>()));
             else
               f.context->check(taiFieldFillI64(
                   f.handle, static_cast<int64_t>(
                                 PyLong_AsUnsignedLongLongMask(value.ptr()))));
           })
      .def("address",
           [](Field &f, const py::tuple &indices) {
             void *address = nullptr;
             f.context->check(taiFieldGetAddress(
                 f.handle, toIndices(f, indices).data(), &address));
             return reinterpret_cast<uintptr_t>(address);
           })
      // Address, whether it is on a device, bytes from index to index, and the
      // owner of the memory.
      .def("lend",
           [](Field &f) {
             TaiFieldMemory memory;
             TaiExportedBuffer buffer = nullptr;
             f.context->check(taiFieldExport(f.handle, &memory, &buffer));
             py::capsule owner(buffer, [](void *pointer) {
               Teardown teardown;
               taiExportedBufferRelease(
                   static_cast<TaiExportedBuffer>(pointer));
             });
             py::tuple strides(f.info.rank + f.info.element_rank);
             for (size_t d = 0; d < strides.size(); ++d)
               strides[d] = memory.strides[d];
             return py::make_tuple(reinterpret_cast<uint64_t>(memory.address),
                                   bool(memory.on_device), strides, owner);
           })
      .def("note_write",
           [](Field &f) { f.context->check(taiFieldNoteWrite(f.handle)); })
      .def("read_elements",
           [](Field &f, const py::buffer &indices, const py::buffer &values) {
             // The caller has checked shapes and types.
             py::buffer_info at = indices.request();
             auto *places = static_cast<const int64_t *>(at.ptr);
             void *result = values.request(/*writable=*/true).ptr;
             bool isBfloat = f.info.type == TAI_BF16;
             std::vector<uint16_t> numbers(
                 isBfloat ? at.shape[0] * f.numComponents() : 0);
             f.context->check(
                 taiFieldReadElements(f.handle, places, at.shape[0],
                                      isBfloat ? numbers.data() : result));
             fromBfloats(numbers, result);
           })
      .def("write_elements",
           [](Field &f, const py::buffer &indices, const py::buffer &values) {
             py::buffer_info at = indices.request();
             auto *places = static_cast<const int64_t *>(at.ptr);
             const void *given = values.request().ptr;
             bool isBfloat = f.info.type == TAI_BF16;
             std::vector<uint16_t> numbers = toBfloats(
                 given, isBfloat ? at.shape[0] * f.numComponents() : 0);
             f.context->check(
                 taiFieldWriteElements(f.handle, places, at.shape[0],
                                       isBfloat ? numbers.data() : given));
           })
      .def("copy_to",
           [](Field &f, const py::object &array) {
             ArrayView view(f, array, /*writable=*/true);
             if (f.info.type == TAI_BF16) {
               std::vector<uint16_t> numbers(f.numScalars());
               f.context->check(taiFieldCopyToHost(f.handle, numbers.data()));
               return fromBfloats(numbers, view.view.buf);
             }
             f.context->check(taiFieldCopyToHost(f.handle, view.view.buf));
           })
      .def("copy_from",
           [](Field &f, const py::object &array) {
             ArrayView view(f, array, /*writable=*/false);
             if (f.info.type == TAI_BF16)
               return f.context->check(taiFieldCopyFromHost(
                   f.handle, toBfloats(view.view.buf, f.numScalars()).data()));
             f.context->check(taiFieldCopyFromHost(f.handle, view.view.buf));
           })
      .def_property_readonly("shape", [](Field &f) {
        py::tuple shape(f.info.rank);
        for (int d = 0; d < f.info.rank; ++d)
          shape[d] = f.info.shape[d];
        return shape;
      });
}

void bindKernel(py::module_ &module) {
  py::class_<Kernel, std::shared_ptr<Kernel>>(module, "Kernel")
      .def("ir",
           [](Kernel &k, const std::string &stage) {
             const char *text = nullptr;
             k.context->check(taiKernelGetIR(k.handle, stage.c_str(), &text));
             return std::string(text);
           })
      .def("reads_in_reverse",
           [](Kernel &k, int64_t slot) {
             return settled(taiKernelReadsInReverse(k.handle, slot));
           })
      .def("ends_gradients",
           [](Kernel &k, int64_t slot) {
             return settled(taiKernelEndsGradients(k.handle, slot));
           })
      .def_property_readonly(
          "trees",
          [](Kernel &k) {
            std::vector<std::string> trees;
            while (const char *name = settled(taiKernelGetTree(
                       k.handle, static_cast<int64_t>(trees.size()))))
              trees.push_back(name);
            return trees;
          })
      .def("compile", [](Kernel &k, bool adjoint) {
        k.context->check(
            taiKernelsCompile(k.context->handle, &k.handle, 1, adjoint));
      });
}

} // namespace

void taipy::bindRuntime(py::module_ &module) {
  module.def("stop_background_work", [] {
    taiStopBackgroundWork();
    settle();
  });
  module.def("options", [] {
    const TaiOptionRow *rows = nullptr;
    int64_t count = taiListOptions(&rows);
    py::list options;
    for (int64_t i = 0; i < count; ++i)
      options.append(py::make_tuple(rows[i].name, rows[i].initial,
                                    rows[i].expects, rows[i].about));
    return options;
  });
  py::class_<Context, ContextRef>(module, "Context")
      .def(py::init<>())
      .def("set_option",
           [](Context &c, const std::string &name, const std::string &value) {
             c.check(
                 taiContextSetOption(c.handle, name.c_str(), value.c_str()));
           })
      .def("synchronize",
           [](Context &c) { c.check(taiContextSynchronize(c.handle)); })
      .def("add_tree",
           [](Context &c, const std::string &name, const std::string &layout) {
             c.check(taiContextAddTree(c.handle, name.c_str(), layout.c_str()));
           })
      .def("destroy_tree",
           [](Context &c, const std::string &name) {
             c.check(taiContextDestroyTree(c.handle, name.c_str()));
           })
      .def("sparse_level",
           [](Context &c, const std::string &tree, int64_t level) {
             TaiSparseLevel info = {};
             c.check(taiContextGetSparseLevel(c.handle, tree.c_str(), level,
                                              &info));
             return py::make_tuple(info.numCells, info.cellBytes,
                                   info.numActive, info.listsMade,
                                   info.listsReused, info.peakActive);
           })
      .def("active_cells",
           [](Context &c, const std::string &tree, int64_t level) {
             TaiSparseLevel info = {};
             c.check(taiContextGetSparseLevel(c.handle, tree.c_str(), level,
                                              &info));
             std::vector<int64_t> cells(info.numActive);
             c.check(taiContextGetActiveCells(c.handle, tree.c_str(), level,
                                              cells.data(), cells.size()));
             return py::bytes(reinterpret_cast<const char *>(cells.data()),
                              cells.size() * sizeof(int64_t));
           })
      .def("set_active",
           [](Context &c, const std::string &tree, int64_t level, int64_t cell,
              bool active) {
             c.check(taiContextSetActive(c.handle, tree.c_str(), level, cell,
                                         active));
           })
      .def("deactivate_all",
           [](Context &c, const std::string &tree, int64_t level) {
             c.check(taiContextDeactivateAll(c.handle, tree.c_str(), level));
           })
      .def("add_field",
           [](const ContextRef &c, const std::string &declaration) {
             auto field = std::make_unique<Field>();
             field->context = c;
             c->check(taiContextAddField(c->handle, declaration.c_str(),
                                         &field->handle));
             c->check(taiFieldGetInfo(field->handle, &field->info));
             return field;
           })
      .def("has_kernel",
           [](Context &c, const std::string &name) {
             return settled(taiContextHasKernel(c.handle, name.c_str()));
           })
      .def("count_objects",
           [](Context &c) {
             TaiContextObjects held = {};
             c.check(taiContextCountObjects(c.handle, &held));
             py::dict result;
             result["trees"] = held.trees;
             result["fields"] = held.fields;
             result["declarations"] = held.declarations;
             result["field_handles"] = held.field_handles;
             result["kernel_handles"] = held.kernel_handles;
             result["tape_handles"] = held.tape_handles;
             result["kernels"] = held.kernels;
             result["kernel_codes"] = held.kernel_codes;
             result["linked"] = held.linked;
             result["failures"] = held.failures;
             return result;
           })
      .def("clear_tangents",
           [](Context &c) { c.check(taiContextClearTangents(c.handle)); })
      .def("clear_gradients",
           [](Context &c) { c.check(taiContextClearGradients(c.handle)); })
      .def("compile",
           [](Context &c, const std::vector<std::shared_ptr<Kernel>> &kernels,
              bool adjoints) {
             std::vector<TaiKernel> handles;
             handles.reserve(kernels.size());
             for (const auto &kernel : kernels)
               handles.push_back(kernel->handle);
             c.check(taiKernelsCompile(c.handle, handles.data(),
                                       static_cast<int64_t>(handles.size()),
                                       adjoints));
           })
      .def(
          "tape",
          [](const ContextRef &c, const Field *loss, bool clear) {
            // The Python object is made first: if pybind11 has no memory for
            // it, pybind11 frees a C++ object that was passed to it twice.
            py::object made = py::type::of<Tape>()();
            Tape &tape = made.cast<Tape &>();
            tape.context = c;
            c->check(taiTapeBegin(c->handle, loss ? loss->handle : nullptr,
                                  clear, &tape.handle));
            return made;
          },
          py::arg("loss").none(true), py::arg("clear"))
      .def("wait_for_stream",
           [](Context &c, uint64_t stream) {
             c.check(taiContextWaitForStream(c.handle, stream));
           })
      .def("let_stream_wait",
           [](Context &c, uint64_t stream) {
             c.check(taiContextLetStreamWait(c.handle, stream));
           })
      .def("is_on_device",
           [](Context &c, uint64_t address) {
             return bool(settled(taiContextIsOnDevice(
                 c.handle, reinterpret_cast<const void *>(address))));
           })
      .def("follow_tangents",
           [](Context &c, const std::vector<Field *> &inputs) {
             std::vector<TaiField> handles = handlesOf(inputs);
             taiContextFollowTangents(c.handle, handles.data(),
                                      static_cast<int64_t>(handles.size()));
             settle();
           })
      .def("lost_tangents",
           [](Context &c, const std::vector<Field *> &outputs) {
             std::vector<TaiField> handles = handlesOf(outputs);
             const char *lines = settled(
                 taiContextLostTangents(c.handle, handles.data(),
                                        static_cast<int64_t>(handles.size())));
             if (!lines)
               throw std::bad_alloc();
             return std::string(lines);
           })
      .def(
          "is_on_gpu",
          [](Context &c) { return bool(settled(taiContextIsOnGpu(c.handle))); })
      .def("profile",
           [](Context &c) {
             const TaiProfileRow *rows = nullptr;
             int64_t count = 0;
             c.check(taiProfilerRows(c.handle, &rows, &count));
             py::list result;
             for (const TaiProfileRow *row = rows; row != rows + count; ++row)
               result.append(py::make_tuple(
                   row->kernel, row->launches, row->total_ms, row->min_ms,
                   row->max_ms, row->place, int(row->kind), row->bytes,
                   row->registers, row->local_bytes, row->shared_bytes,
                   row->occupancy, row->blocks, row->threads));
             return result;
           })
      .def("trace",
           [](Context &c) {
             const TaiTraceEvent *events = nullptr;
             int64_t count = 0, lost = 0;
             c.check(taiProfilerTrace(c.handle, &events, &count, &lost));
             py::list result;
             for (const TaiTraceEvent *e = events; e != events + count; ++e)
               result.append(py::make_tuple(
                   e->name, e->place, int(e->kind), bool(e->on_device),
                   e->thread, e->start_us, e->duration_us, e->queued_us,
                   e->blocks, e->threads));
             return py::make_tuple(result, lost);
           })
      .def("clear_profile",
           [](Context &c) { c.check(taiProfilerClear(c.handle)); })
      .def("shadow_rows",
           [](Context &c) {
             const TaiShadowRow *rows = nullptr;
             int64_t count = 0;
             c.check(taiShadowRows(c.handle, &rows, &count));
             py::list result;
             for (const TaiShadowRow *row = rows; row != rows + count; ++row)
               result.append(py::make_tuple(
                   row->operation, row->kernel, row->place, row->precision,
                   row->lost, row->cancellations, row->flips, row->non_finite,
                   row->error_made, row->error_in, row->bits_lost));
             return result;
           })
      .def("clear_shadows",
           [](Context &c) { c.check(taiShadowClear(c.handle)); })
      .def("shadow_errors",
           [](Context &c, const py::buffer &floats, const py::buffer &errors) {
             auto from = floats.request(), to = errors.request(true);
             c.check(taiShadowErrors(c.handle, from.ptr, int(8 * from.itemsize),
                                     from.size, static_cast<double *>(to.ptr)));
           })
      .def("skips",
           [](Context &c) {
             const TaiSkipRow *rows = nullptr;
             int64_t count = 0;
             c.check(taiProfilerSkips(c.handle, &rows, &count));
             py::list result;
             for (const TaiSkipRow *row = rows; row != rows + count; ++row)
               result.append(py::make_tuple(row->skip, row->counter, row->value,
                                            bool(row->on)));
             return result;
           })
      .def("clear_skips",
           [](Context &c) { c.check(taiProfilerClearSkips(c.handle)); });
  bindField(module);
  bindKernel(module);
  bindTape(module);
}
