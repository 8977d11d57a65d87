//===- PrintField.cpp - The contents of a field as text -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "PrintField.h"
#include "llvm/ADT/APFloat.h"
#include "llvm/ADT/SmallString.h"
#include <cmath>

using namespace llvm;
using namespace mlir::tai;

/// The shortest decimal that reads back as the same number of the type.
static std::string formatFloat(double value, const fltSemantics &semantics) {
  if (!std::isfinite(value))
    return std::isnan(value) ? "nan" : value > 0 ? "inf" : "-inf";
  char text[40];
  for (int digits = 1; digits <= 17; ++digits) {
    snprintf(text, sizeof(text), "%.*g", digits, value);
    bool inexact;
    APFloat whole(strtod(text, nullptr));
    whole.convert(semantics, APFloat::rmNearestTiesToEven, &inexact);
    whole.convert(APFloat::IEEEdouble(), APFloat::rmNearestTiesToEven,
                  &inexact);
    if (whole.convertToDouble() == value)
      break;
  }
  return text;
}

namespace {
/// Visits the components of a field in row-major order.
class Printer {
public:
  Printer(raw_ostream &stream, const runtime::Field &field)
      : stream(stream), field(field), index(field.shape().size()),
        offset(field.layout().offset) {
    shape.append(field.shape().begin(), field.shape().end());
    shape.append(field.elementShape().begin(), field.elementShape().end());
  }

  runtime::Status print(unsigned depth = 0) {
    if (depth == shape.size())
      return printComponent();
    stream << '[';
    for (int64_t i = 0; i < shape[depth]; ++i) {
      if (i > 0) {
        stream << ',';
        // Each innermost list starts on a new line.
        if (depth + 1 < shape.size())
          stream << '\n' << std::string(depth + 1, ' ');
        else
          stream << ' ';
      }
      if (depth < index.size()) {
        index[depth] = i + (offset.empty() ? 0 : offset[depth]);
        if (depth + 1 == index.size())
          component = 0;
      }
      if (runtime::Status status = print(depth + 1); !status.ok())
        return status;
    }
    stream << ']';
    return runtime::Status::success();
  }

private:
  runtime::Status printComponent() {
    int64_t at = component++;
    if (!runtime::isFloat(field.scalar())) {
      int64_t value = 0;
      runtime::Status status = field.readI64(index.data(), at, value);
      stream << value;
      return status;
    }
    double value = 0;
    runtime::Status status = field.readF64(index.data(), at, value);
    using Kind = runtime::ScalarKind;
    stream << formatFloat(value,
                          field.scalar() == Kind::F64   ? APFloat::IEEEdouble()
                          : field.scalar() == Kind::F32 ? APFloat::IEEEsingle()
                          : field.scalar() == Kind::F16 ? APFloat::IEEEhalf()
                                                        : APFloat::BFloat());
    return status;
  }

  raw_ostream &stream;
  const runtime::Field &field;
  SmallVector<int64_t> shape;
  SmallVector<int64_t> index;
  std::vector<int64_t> offset;
  int64_t component = 0;
};
} // namespace

runtime::Status mlir::tai::printField(raw_ostream &stream,
                                      const runtime::Field &field) {
  stream << '@' << field.name() << " : ";
  for (int64_t extent : field.shape())
    stream << extent << 'x';
  if (field.elementShape().empty()) {
    stream << runtime::spelling(field.scalar());
  } else {
    stream << "vector<";
    for (int64_t extent : field.elementShape())
      stream << extent << 'x';
    stream << runtime::spelling(field.scalar()) << '>';
  }
  stream << " = ";
  if (field.rank() > 1)
    stream << "\n";
  runtime::Status status = Printer(stream, field).print();
  stream << '\n';
  return status;
}
