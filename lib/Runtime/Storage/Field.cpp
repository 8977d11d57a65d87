//===- Field.cpp - Access to single elements ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The address of an element, and conversions from and to numbers of the host.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Storage/Scalars.h"

using namespace mlir::tai::runtime;

__thread uint64_t mlir::tai::runtime::ownThreadNumber = 0;

uint64_t mlir::tai::runtime::numberThread() {
  static std::atomic<uint64_t> last{0};
  return ownThreadNumber = 1 + last.fetch_add(1, std::memory_order_relaxed);
}

int64_t Field::elementOffset(const int64_t *index) const {
  int64_t offset = fieldLayout.placeOffset;
  for (size_t d = 0; d < shapeOf.size(); ++d) {
    int64_t i = index[d];
    if (!fieldLayout.offset.empty())
      i -= fieldLayout.offset[d];
    if (i < 0 || i >= shapeOf[d])
      return -1;
    for (const LayoutLevel &level : fieldLayout.indices[d])
      offset += i / level.divisor % level.extent * level.stride;
  }
  return offset;
}

int64_t Field::cellNumber(const int64_t *index) const {
  int64_t cell = 0;
  for (size_t d = 0; d < shapeOf.size(); ++d) {
    int64_t at = index[d] - firstIndex(static_cast<int64_t>(d));
    if (at < 0 || at >= shapeOf[d])
      return -1;
    for (const LayoutLevel &level : fieldLayout.indices[d])
      cell += at / level.divisor % level.extent * level.cells;
  }
  return cell;
}

Status Field::locate(const int64_t *index, int64_t component,
                     int64_t &offset) const {
  if (!valid())
    return Status::failure(StatusCode::Usage,
                           "field '" + fieldName + "' is gone: its tree '" +
                               owner->name() + "' has been destroyed");
  if (component < 0 || component >= components)
    return Status::failure(
        StatusCode::Index,
        "component " + std::to_string(component) + " of field '" + fieldName +
            "', whose elements have " + std::to_string(components));
  offset = elementOffset(index);
  if (offset < 0) {
    std::string text = "index (";
    for (size_t d = 0; d < shapeOf.size(); ++d)
      text += (d ? ", " : "") + std::to_string(index[d]);
    text += ") is out of range of field '" + fieldName + "', whose indices are";
    for (size_t d = 0; d < shapeOf.size(); ++d) {
      int64_t first = fieldLayout.offset.empty() ? 0 : fieldLayout.offset[d];
      text += (d ? ", " : " ") + std::to_string(first) + " to " +
              std::to_string(first + shapeOf[d] - 1);
    }
    return Status::failure(StatusCode::Index, std::move(text));
  }
  offset += component * fieldLayout.componentStride;
  return Status::success();
}

/// Reads a component of an element as a number; `load` converts its bytes.
template <typename Number>
static Status read(const Field &field, const int64_t *index, int64_t component,
                   Number (*load)(ScalarKind, const char *), Number &value) {
  int64_t offset = 0;
  char bytes[8] = {};
  Status status = field.locate(index, component, offset);
  if (status)
    status = field.loadBytes(offset, bytes);
  if (status)
    value = load(field.scalar(), bytes);
  return status;
}

/// Writes a component of an element; `store` converts the number. The cell that
/// holds the element becomes active.
template <typename Number>
static Status write(Field &field, const int64_t *index, int64_t component,
                    void (*store)(ScalarKind, char *, Number), Number value) {
  int64_t offset = 0;
  Status status = field.locate(index, component, offset);
  if (!status)
    return status;
  if (SparseNode *node = field.sparseNode())
    node->activate(field.cellNumber(index));
  char bytes[8] = {};
  store(field.scalar(), bytes, value);
  field.markDirty();
  return field.storeBytes(offset, bytes);
}

Status Field::readF64(const int64_t *index, int64_t component,
                      double &value) const {
  return read(*this, index, component, loadF64, value);
}

Status Field::writeF64(const int64_t *index, int64_t component, double value) {
  return write(*this, index, component, storeF64, value);
}

Status Field::readI64(const int64_t *index, int64_t component,
                      int64_t &value) const {
  return read(*this, index, component, loadI64, value);
}

Status Field::writeI64(const int64_t *index, int64_t component, int64_t value) {
  return write(*this, index, component, storeI64, value);
}

Status Field::readElements(const int64_t *indices, int64_t count,
                           void *values) const {
  auto scalar = static_cast<size_t>(byteSize(fieldLayout.scalar));
  char *to = static_cast<char *>(values);
  for (int64_t i = 0; i < count; ++i, indices += rank()) {
    int64_t from = 0;
    Status status = locate(indices, 0, from);
    for (int64_t c = 0; c < components && status; ++c, to += scalar)
      status = loadBytes(from + c * fieldLayout.componentStride, to);
    if (!status)
      return status;
  }
  return Status::success();
}

//===----------------------------------------------------------------------===//
// Steps
//===----------------------------------------------------------------------===//

bool mlir::tai::runtime::findConstantStep(
    const std::vector<LayoutLevel> &levels, int64_t &step) {
  int64_t weight = 1;
  bool any = false;
  step = 0;
  for (auto level = levels.rbegin(); level != levels.rend(); ++level) {
    if (level->extent == 1)
      continue;
    if (level->divisor != weight)
      return false;
    if (!any)
      step = level->stride;
    else if (level->stride != step * weight)
      return false;
    any = true;
    weight *= level->extent;
  }
  return true;
}

int64_t mlir::tai::runtime::findEvenStep(const FieldLayout &layout,
                                         const std::vector<int64_t> &shape,
                                         int64_t elementBytes) {
  int64_t first = 0, expected = 0;
  for (size_t d = shape.size(); d-- > 0;) {
    int64_t step;
    if (!findConstantStep(layout.indices[d], step))
      return 0;
    if (shape[d] <= 1)
      continue;
    if (first == 0)
      first = expected = step;
    if (step != expected)
      return 0;
    expected *= shape[d];
  }
  // The stride of a single element is defined as the size of the element.
  return first == 0 ? elementBytes : first;
}
