//===- TaiTypes.cpp - Layout types: syntax and rules ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// One grammar serves all levels. Inside `!tai.root`, a level is written by its
// bare keyword, a record of places in braces, and any other level as a full
// type, which must implement SNodeTypeInterface.
//
//===----------------------------------------------------------------------===//

#include "mlir/IR/Builders.h"
#include "mlir/IR/DialectImplementation.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/SmallBitVector.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/ADT/TypeSwitch.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Dialect/Tai/IR/TaiTypeInterfaces.cpp.inc"
#define GET_TYPEDEF_CLASSES
#include "tai/Dialect/Tai/IR/TaiTypes.cpp.inc"

void TaiDialect::registerTypes() {
  addTypes<
#define GET_TYPEDEF_LIST
#include "tai/Dialect/Tai/IR/TaiTypes.cpp.inc"
      >();
}

//===----------------------------------------------------------------------===//
// Syntax
//===----------------------------------------------------------------------===//

/// Parses an axis and its positive extent, for example `i: 8`.
static ParseResult parseAxisExtent(AsmParser &parser, unsigned &axis,
                                   int64_t &extent) {
  StringRef letter;
  SMLoc loc = parser.getCurrentLocation();
  if (parser.parseKeyword(&letter))
    return failure();
  std::optional<unsigned> parsed = parseAxisLetter(letter);
  if (!parsed)
    return parser.emitError(loc, "expected an axis, a letter from 'i' to 't', "
                                 "but got '")
           << letter << "'";
  axis = *parsed;
  return failure(parser.parseColon() || parser.parseInteger(extent));
}

ParseResult tai::parseLevelAxes(AsmParser &parser, SmallVector<unsigned> &axes,
                                SmallVector<int64_t> &shape) {
  return parser.parseCommaSeparatedList(AsmParser::Delimiter::Square, [&]() {
    return parseAxisExtent(parser, axes.emplace_back(), shape.emplace_back());
  });
}

/// Parses the places of a record, from after its opening brace to its closing
/// brace.
static Type parsePlaces(AsmParser &parser) {
  SmallVector<StringAttr> names;
  SmallVector<Type> types;
  Builder &builder = parser.getBuilder();
  SMLoc loc = parser.getCurrentLocation();
  if (failed(parser.parseOptionalRBrace())) {
    if (parser.parseCommaSeparatedList([&]() -> ParseResult {
          std::string name;
          if (parser.parseKeywordOrString(&name) || parser.parseColon() ||
              parser.parseType(types.emplace_back()))
            return failure();
          names.push_back(builder.getStringAttr(name));
          return success();
        }) ||
        parser.parseRBrace())
      return {};
  }
  return PlacesType::getChecked([&] { return parser.emitError(loc); },
                                builder.getContext(), names, types);
}

static Type parseChild(AsmParser &parser) {
  if (succeeded(parser.parseOptionalLBrace()))
    return parsePlaces(parser);
  SMLoc loc = parser.getCurrentLocation();
  StringRef keyword;
  // An editor offers these, and then types.
  if (failed(parser.parseOptionalKeyword(
          &keyword, {"dense", "pointer", "bitmasked", "hash", "dynamic"})) &&
      failed(parser.parseOptionalKeyword(&keyword))) {
    Type type;
    if (parser.parseType(type))
      return {};
    return type;
  }
  if (keyword == "dense")
    return DenseType::parse(parser);
  if (keyword == "pointer")
    return PointerType::parse(parser);
  if (keyword == "bitmasked")
    return BitmaskedType::parse(parser);
  if (keyword == "hash")
    return HashType::parse(parser);
  if (keyword == "dynamic")
    return DynamicType::parse(parser);
  parser.emitError(loc, "expected a level ('dense', 'pointer', 'bitmasked', "
                        "'hash', 'dynamic', a level type of another dialect) "
                        "or places in braces, but got '")
      << keyword << "'";
  return {};
}

ParseResult tai::parseLevelChildren(AsmParser &parser,
                                    SmallVector<Type> &children) {
  do {
    Type child = parseChild(parser);
    if (!child)
      return failure();
    children.push_back(child);
  } while (succeeded(parser.parseOptionalComma()));
  return success();
}

static void printPlaces(AsmPrinter &printer, PlacesType type) {
  printer << "{";
  llvm::interleaveComma(llvm::zip(type.getNames(), type.getTypes()),
                        printer.getStream(), [&](auto place) {
                          printer.printKeywordOrString(
                              std::get<0>(place).getValue());
                          printer << ": " << std::get<1>(place);
                        });
  printer << "}";
}

static void printChild(AsmPrinter &printer, Type type) {
  if (auto places = dyn_cast<PlacesType>(type))
    return printPlaces(printer, places);
  llvm::TypeSwitch<Type>(type)
      .Case<DenseType, PointerType, BitmaskedType, HashType, DynamicType>(
          [&](auto level) {
            printer << level.getKind();
            level.print(printer);
          })
      .Default([&](Type other) { printer << other; });
}

void tai::printLevelAxes(AsmPrinter &printer, ArrayRef<unsigned> axes,
                         ArrayRef<int64_t> shape) {
  printer << "[";
  llvm::interleaveComma(llvm::zip(axes, shape), printer.getStream(),
                        [&](auto pair) {
                          printer << getAxisLetter(std::get<0>(pair)) << ": "
                                  << std::get<1>(pair);
                        });
  printer << "]";
}

void tai::printLevelChildren(AsmPrinter &printer, ArrayRef<Type> children) {
  for (Type child : children) {
    printer << ", ";
    printChild(printer, child);
  }
}

/// Parses the parameters of a level, for example `<[i: 8], child>`, for all
/// levels that have this form.
template <typename Level> static Type parseLevel(AsmParser &parser) {
  SmallVector<unsigned> axes;
  SmallVector<int64_t> shape;
  SmallVector<Type> children;
  SMLoc loc = parser.getCurrentLocation();
  if (parser.parseLess() || parseLevelAxes(parser, axes, shape) ||
      parser.parseComma() || parseLevelChildren(parser, children) ||
      parser.parseGreater())
    return {};
  return Level::getChecked([&] { return parser.emitError(loc); },
                           parser.getContext(), axes, shape, children);
}

template <typename Level>
static void printLevel(AsmPrinter &printer, Level type) {
  printer << "<";
  printLevelAxes(printer, type.getAxes(), type.getShape());
  printLevelChildren(printer, type.getChildren());
  printer << ">";
}

Type DenseType::parse(AsmParser &parser) {
  return parseLevel<DenseType>(parser);
}
void DenseType::print(AsmPrinter &printer) const { printLevel(printer, *this); }
Type PointerType::parse(AsmParser &parser) {
  return parseLevel<PointerType>(parser);
}
void PointerType::print(AsmPrinter &printer) const {
  printLevel(printer, *this);
}
Type BitmaskedType::parse(AsmParser &parser) {
  return parseLevel<BitmaskedType>(parser);
}
void BitmaskedType::print(AsmPrinter &printer) const {
  printLevel(printer, *this);
}
Type HashType::parse(AsmParser &parser) { return parseLevel<HashType>(parser); }
void HashType::print(AsmPrinter &printer) const { printLevel(printer, *this); }

Type DynamicType::parse(AsmParser &parser) {
  unsigned axis;
  int64_t capacity, chunkSize;
  SmallVector<Type> children;
  SMLoc loc = parser.getCurrentLocation();
  if (parser.parseLess() || parser.parseLSquare() ||
      parseAxisExtent(parser, axis, capacity) || parser.parseRSquare() ||
      parser.parseComma() || parser.parseKeyword("chunk") ||
      parser.parseInteger(chunkSize) || parser.parseComma() ||
      parseLevelChildren(parser, children) || parser.parseGreater())
    return {};
  return getChecked([&] { return parser.emitError(loc); }, parser.getContext(),
                    axis, capacity, chunkSize, children);
}

void DynamicType::print(AsmPrinter &printer) const {
  printer << "<[" << getAxisLetter(getAxis()) << ": " << getCapacity()
          << "], chunk " << getChunkSize();
  printLevelChildren(printer, getChildren());
  printer << ">";
}

Type RootType::parse(AsmParser &parser) {
  SmallVector<Type> children;
  SMLoc loc = parser.getCurrentLocation();
  if (parser.parseLess() || parseLevelChildren(parser, children) ||
      parser.parseGreater())
    return {};
  return getChecked([&] { return parser.emitError(loc); }, parser.getContext(),
                    children);
}

void RootType::print(AsmPrinter &printer) const {
  printer << "<";
  llvm::interleaveComma(getChildren(), printer.getStream(),
                        [&](Type child) { printChild(printer, child); });
  printer << ">";
}

Type PlacesType::parse(AsmParser &parser) {
  if (parser.parseLess() || parser.parseLBrace())
    return {};
  Type type = parsePlaces(parser);
  if (!type || parser.parseGreater())
    return {};
  return type;
}

void PlacesType::print(AsmPrinter &printer) const {
  printer << "<";
  printPlaces(printer, *this);
  printer << ">";
}

//===----------------------------------------------------------------------===//
// Rules
//===----------------------------------------------------------------------===//

using EmitError = function_ref<InFlightDiagnostic()>;

static LogicalResult verifyChildren(EmitError emitError,
                                    ArrayRef<Type> children) {
  if (children.empty())
    return emitError() << "expects at least one child";
  for (Type child : children)
    if (!isa<PlacesType>(child) && !isa<SNodeTypeInterface>(child))
      return emitError() << "expects levels or places as children, but got "
                         << child;
  return success();
}

static LogicalResult verifyLevel(EmitError emitError, ArrayRef<unsigned> axes,
                                 ArrayRef<int64_t> shape,
                                 ArrayRef<Type> children) {
  if (axes.empty())
    return emitError() << "expects at least one axis";
  if (axes.size() != shape.size())
    return emitError() << "expects one extent for each axis, but got "
                       << axes.size() << " axes and " << shape.size()
                       << " extents";
  llvm::SmallBitVector seen(kMaxAxes);
  int64_t cells = 1;
  for (auto [axis, extent] : llvm::zip(axes, shape)) {
    if (axis >= kMaxAxes)
      return emitError() << "expects axes below " << kMaxAxes << ", but got "
                         << axis;
    if (seen.test(axis))
      return emitError() << "divides axis '" << getAxisLetter(axis)
                         << "' twice";
    seen.set(axis);
    if (extent <= 0)
      return emitError() << "expects a positive extent along axis '"
                         << getAxisLetter(axis) << "', but got " << extent;
    if (llvm::MulOverflow(cells, extent, cells))
      return emitError() << "has more cells than a 64-bit number can count";
  }
  return verifyChildren(emitError, children);
}

LogicalResult DenseType::verify(EmitError emitError, ArrayRef<unsigned> axes,
                                ArrayRef<int64_t> shape,
                                ArrayRef<Type> children) {
  return verifyLevel(emitError, axes, shape, children);
}
LogicalResult PointerType::verify(EmitError emitError, ArrayRef<unsigned> axes,
                                  ArrayRef<int64_t> shape,
                                  ArrayRef<Type> children) {
  return verifyLevel(emitError, axes, shape, children);
}
LogicalResult BitmaskedType::verify(EmitError emitError,
                                    ArrayRef<unsigned> axes,
                                    ArrayRef<int64_t> shape,
                                    ArrayRef<Type> children) {
  return verifyLevel(emitError, axes, shape, children);
}
LogicalResult HashType::verify(EmitError emitError, ArrayRef<unsigned> axes,
                               ArrayRef<int64_t> shape,
                               ArrayRef<Type> children) {
  return verifyLevel(emitError, axes, shape, children);
}

LogicalResult DynamicType::verify(EmitError emitError, unsigned axis,
                                  int64_t capacity, int64_t chunkSize,
                                  ArrayRef<Type> children) {
  if (chunkSize <= 0)
    return emitError() << "expects a positive chunk size, but got "
                       << chunkSize;
  return verifyLevel(emitError, axis, capacity, children);
}

LogicalResult RootType::verify(EmitError emitError, ArrayRef<Type> children) {
  return verifyChildren(emitError, children);
}

/// True if a place of a tree can hold elements of `type`.
static bool isPlaceElementType(Type type) {
  if (auto vector = dyn_cast<VectorType>(type)) {
    if (vector.isScalable() || vector.getRank() < 1 || vector.getRank() > 2)
      return false;
    type = vector.getElementType();
  }
  if (auto integer = dyn_cast<IntegerType>(type))
    return integer.isSignless() &&
           llvm::is_contained({1u, 8u, 16u, 32u, 64u}, integer.getWidth());
  return type.isF16() || type.isBF16() || type.isF32() || type.isF64();
}

LogicalResult PlacesType::verify(EmitError emitError,
                                 ArrayRef<StringAttr> names,
                                 ArrayRef<Type> types) {
  if (names.empty())
    return emitError() << "expects at least one place";
  if (names.size() != types.size())
    return emitError() << "expects one type for each place, but got "
                       << names.size() << " names and " << types.size()
                       << " types";
  for (auto [name, type] : llvm::zip(names, types)) {
    if (name.getValue().empty())
      return emitError() << "expects places to have names";
    if (!isPlaceElementType(type))
      return emitError() << "place '" << name.getValue() << "' has type "
                         << type
                         << "; expects i1, i8, i16, i32, i64, f16, bf16, f32, "
                            "f64, or a vector of one with one or two "
                            "dimensions";
  }
  return success();
}

//===----------------------------------------------------------------------===//
// SNodeTypeInterface
//===----------------------------------------------------------------------===//

StringRef DenseType::getKind() const { return "dense"; }
CellActivity DenseType::getActivity() const { return CellActivity::All; }
StringRef PointerType::getKind() const { return "pointer"; }
CellActivity PointerType::getActivity() const { return CellActivity::Bits; }
StringRef BitmaskedType::getKind() const { return "bitmasked"; }
CellActivity BitmaskedType::getActivity() const { return CellActivity::Bits; }
StringRef HashType::getKind() const { return "hash"; }
CellActivity HashType::getActivity() const { return CellActivity::Bits; }
StringRef DynamicType::getKind() const { return "dynamic"; }
CellActivity DynamicType::getActivity() const { return CellActivity::Length; }
ArrayRef<unsigned> DynamicType::getAxes() const { return getImpl()->axis; }
ArrayRef<int64_t> DynamicType::getShape() const { return getImpl()->capacity; }
