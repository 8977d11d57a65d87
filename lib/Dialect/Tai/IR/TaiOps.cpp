//===- TaiOps.cpp - Trees, fields and accesses ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapeValues.h"
#include "mlir/IR/Builders.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Interfaces/FunctionImplementation.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "llvm/ADT/StringSet.h"
#include "llvm/Support/MathExtras.h"

using namespace mlir;
using namespace mlir::tai;

#include "tai/Interfaces/FieldAccessInterface.cpp.inc"

/// Parses the clauses that may follow the rank, in any order:
/// `, adjoint @a`, `, dual @d`, `, offset [n, …]`, `, order [axis, …]`.
static ParseResult
parseFieldClauses(OpAsmParser &parser, FlatSymbolRefAttr &adjoint,
                  FlatSymbolRefAttr &dual, DenseI64ArrayAttr &offset,
                  DenseI64ArrayAttr &order, ElementsAttr &initial) {
  while (succeeded(parser.parseOptionalComma())) {
    SMLoc loc = parser.getCurrentLocation();
    StringRef clause;
    if (parser.parseKeyword(&clause))
      return failure();
    auto parseInto = [&](auto &attr) -> ParseResult {
      if (attr)
        return parser.emitError(loc) << "'" << clause << "' is given twice";
      if constexpr (std::is_same_v<std::decay_t<decltype(attr)>,
                                   DenseI64ArrayAttr>) {
        attr = dyn_cast_if_present<DenseI64ArrayAttr>(
            DenseI64ArrayAttr::parse(parser, Type()));
        return success(static_cast<bool>(attr));
      } else {
        return parser.parseAttribute(attr);
      }
    };
    ParseResult parsed = success();
    if (clause == "adjoint")
      parsed = parseInto(adjoint);
    else if (clause == "dual")
      parsed = parseInto(dual);
    else if (clause == "offset")
      parsed = parseInto(offset);
    else if (clause == "order")
      parsed = parseInto(order);
    else if (clause == "initial")
      parsed = parseInto(initial);
    else
      return parser.emitError(loc)
             << "expected 'adjoint', 'dual', 'offset', 'order' or 'initial', "
                "but got '"
             << clause << "'";
    if (failed(parsed))
      return failure();
  }
  return success();
}

static void printFieldClauses(OpAsmPrinter &printer, FieldOp,
                              FlatSymbolRefAttr adjoint, FlatSymbolRefAttr dual,
                              DenseI64ArrayAttr offset, DenseI64ArrayAttr order,
                              ElementsAttr initial) {
  if (adjoint)
    printer << ", adjoint " << adjoint;
  if (dual)
    printer << ", dual " << dual;
  auto printArray = [&](StringRef name, DenseI64ArrayAttr array) {
    if (!array)
      return;
    printer << ", " << name << " ";
    array.print(printer);
  };
  printArray("offset", offset);
  printArray("order", order);
  if (initial)
    printer << ", initial " << initial;
}

#define GET_OP_CLASSES
#include "tai/Dialect/Tai/IR/TaiOps.cpp.inc"

//===----------------------------------------------------------------------===//
// TreeOp, FieldOp
//===----------------------------------------------------------------------===//

/// Returns the size in bytes of all cells of the level `type`, without padding;
/// the largest number if the size overflows.
static uint64_t countBytes(Type type, const DataLayout &layout) {
  uint64_t bytes = 0;
  if (auto places = dyn_cast<PlacesType>(type)) {
    for (Type place : places.getTypes()) {
      uint64_t size = getValueSize(getElementTypeOrSelf(place), layout);
      if (auto vector = dyn_cast<VectorType>(place))
        for (int64_t extent : vector.getShape())
          size = llvm::SaturatingMultiply<uint64_t>(size, extent);
      bytes = llvm::SaturatingAdd(bytes, size);
    }
    return bytes;
  }
  auto level = cast<SNodeTypeInterface>(type);
  for (Type child : level.getChildren())
    bytes = llvm::SaturatingAdd(bytes, countBytes(child, layout));
  for (int64_t extent : level.getShape())
    bytes = llvm::SaturatingMultiply<uint64_t>(bytes, extent);
  return bytes;
}

/// Checks that the cells of each level fit the level's pool and are aligned as
/// its kind requires.
static LogicalResult verifyCells(TreeOp tree, ArrayRef<Type> children,
                                 const DataLayout &layout) {
  for (Type child : children) {
    auto level = dyn_cast<SNodeTypeInterface>(child);
    if (!level)
      continue;
    SmallVector<uint64_t> strides = level.getCellStrides(layout);
    uint64_t end = level.getCellSize(layout);
    bool isAligned = strides.size() == level.getShape().size();
    for (auto [extent, stride] : llvm::zip(level.getShape(), strides)) {
      isAligned &= stride % level.getCellAlignment(layout) == 0;
      end += (extent - 1) * stride;
    }
    if (!isAligned || end > level.getPoolSize(layout))
      return tree.emitOpError("has a level of kind '")
             << level.getKind()
             << "' whose cells are not aligned or leave its pool";
    if (level.isList() && level.getAxes().size() != 1)
      return tree.emitOpError("has lists of kind '")
             << level.getKind() << "' along more than one axis";
    if (failed(verifyCells(tree, level.getChildren(), layout)))
      return failure();
  }
  return success();
}

LogicalResult TreeOp::verify() {
  auto root = cast<RootType>(getLayout());
  DataLayout layout = DataLayout::closest(*this);
  // Half of the range of 64-bit offsets is left for alignment, and for data
  // that sparse levels keep beside their cells.
  uint64_t bytes = 0;
  for (Type child : root.getChildren())
    bytes = llvm::SaturatingAdd(bytes, countBytes(child, layout));
  if (bytes > uint64_t(1) << 62)
    return emitOpError("has more bytes than can be addressed");
  if (failed(verifyCells(*this, root.getChildren(), layout)))
    return failure();
  llvm::StringSet<> names;
  LogicalResult result = success();
  walkPlaces(cast<RootType>(getLayout()), [&](const PlacePath &path) {
    StringRef name = path.places.getNames()[path.place].getValue();
    if (succeeded(result) && !names.insert(name).second)
      result = emitOpError("has two places named '") << name << "'";
  });
  return result;
}

LogicalResult FieldOp::verify() {
  int64_t rank = getRank();
  if (getOffset() && static_cast<int64_t>(getOffset()->size()) != rank)
    return emitOpError("expects ")
           << rank << " offsets, but got " << getOffset()->size();
  return success();
}

/// True if the type `related` equals `type` except that its floats may be
/// wider.
static bool holdsWider(Type related, Type type) {
  auto own = dyn_cast<FloatType>(getElementTypeOrSelf(type));
  auto other = dyn_cast<FloatType>(getElementTypeOrSelf(related));
  if (!own || !other || own.getWidth() >= other.getWidth())
    return related == type;
  auto vector = dyn_cast<VectorType>(type);
  return related == (vector ? Type(vector.clone(other)) : Type(other));
}

/// Checks that `related` can hold derivatives of `field`. Adjoints accumulate
/// sums, so their floats may be wider.
static LogicalResult verifyRelatedField(FieldOp field,
                                        FlatSymbolRefAttr related,
                                        StringRef role,
                                        SymbolTableCollection &symbols) {
  auto other =
      symbols.lookupNearestSymbolFrom<FieldOp>(field->getParentOp(), related);
  if (!other)
    return field.emitOpError() << role << " '" << related << "' is not a field";
  bool fits = role == "adjoint" ? holdsWider(other.getType(), field.getType())
                                : other.getType() == field.getType();
  if (fits && other.getRank() == field.getRank())
    return success();
  InFlightDiagnostic diag = field.emitOpError()
                            << "expects " << role << " '" << related
                            << "' to have type " << field.getType()
                            << " and rank " << field.getRank();
  diag.attachNote(other.getLoc())
      << "it has type " << other.getType() << " and rank " << other.getRank();
  return diag;
}

/// True if no other field precedes `field` in its block.
static bool isFirstField(FieldOp field) {
  for (Operation *op = field->getPrevNode(); op; op = op->getPrevNode())
    if (isa<FieldOp>(op))
      return false;
  return true;
}

/// Rejects fields that share memory: two fields with the same place, and a
/// field that holds the derivatives of two fields, or of itself. Gradients
/// would be added to, or cleared with, those of another field.
static LogicalResult verifyApart(Block &fields) {
  DenseMap<std::pair<Attribute, Attribute>, FieldOp> places;
  DenseMap<StringAttr, FieldOp> byName;
  DenseMap<Attribute, std::pair<FieldOp, StringRef>> holders;
  for (auto field : fields.getOps<FieldOp>()) {
    byName[field.getSymNameAttr()] = field;
    auto [known, isNew] =
        places.try_emplace({field.getTreeAttr(), field.getPlaceAttr()}, field);
    if (!isNew) {
      InFlightDiagnostic diag =
          field.emitOpError("names place '")
          << field.getPlace() << "' of " << field.getTreeAttr()
          << ", which is another field already; give it a place of its own";
      diag.attachNote(known->second.getLoc())
          << "'@" << known->second.getSymName() << "' is this place";
      return diag;
    }
    for (auto [related, role] :
         {std::pair(field.getAdjointAttr(), StringRef("adjoint")),
          std::pair(field.getDualAttr(), StringRef("dual"))}) {
      if (!related)
        continue;
      auto [holder, isFree] = holders.try_emplace(related, field, role);
      if (isFree)
        continue;
      auto [owner, ownerRole] = holder->second;
      InFlightDiagnostic diag = field.emitOpError();
      if (owner == field)
        diag << "has '" << related << "' for its " << ownerRole << " and its "
             << role << "; give it one field for each";
      else
        diag << "has the " << role << " '" << related
             << "', which holds the derivatives of another field; give each "
                "field its own";
      diag.attachNote(owner.getLoc())
          << "it is the " << ownerRole << " of '@" << owner.getSymName() << "'";
      return diag;
    }
  }
  // Each field has at most one owner, so a chain of adjoints that forms a cycle
  // returns to its start.
  DenseSet<Operation *> visited;
  for (auto field : fields.getOps<FieldOp>()) {
    FieldOp next = field;
    while (next && visited.insert(next).second) {
      FlatSymbolRefAttr adjoint = next.getAdjointAttr();
      next = adjoint ? byName.lookup(adjoint.getAttr()) : FieldOp();
      if (next == field)
        return field.emitOpError("is the adjoint of ")
               << (adjoint == next.getAdjointAttr()
                       ? "itself"
                       : "its adjoint, or of the adjoint of that")
               << "; its gradient would overwrite its values";
    }
  }
  return success();
}

LogicalResult FieldOp::verifySymbolUses(SymbolTableCollection &symbols) {
  // These are the constraints (field_c1) and (field_c2). The first field of a
  // block checks all fields of the block at once, because there may be
  // thousands.
  if (isFirstField(*this) && failed(verifyApart(*(*this)->getBlock())))
    return failure();
  auto tree = symbols.lookupNearestSymbolFrom<TreeOp>((*this)->getParentOp(),
                                                      getTreeAttr());
  if (!tree)
    return emitOpError() << "names '" << getTreeAttr()
                         << "', which is not a tree";
  std::optional<PlacePath> path =
      findPlace(cast<RootType>(tree.getLayout()), getPlace());
  if (!path) {
    InFlightDiagnostic diag = emitOpError()
                              << "names place '" << getPlace()
                              << "', which the tree does not have";
    diag.attachNote(tree.getLoc()) << "tree declared here";
    return diag;
  }
  if (path->getElementType() != getType()) {
    InFlightDiagnostic diag =
        emitOpError() << "has type " << getType() << ", but place '"
                      << getPlace() << "' holds " << path->getElementType();
    diag.attachNote(tree.getLoc()) << "tree declared here";
    return diag;
  }
  if (path->getRank() != getRank()) {
    InFlightDiagnostic diag = emitOpError()
                              << "has rank " << getRank()
                              << ", but the path to place '" << getPlace()
                              << "' divides " << path->getRank() << " axes";
    diag.attachNote(tree.getLoc()) << "tree declared here";
    return diag;
  }
  if (std::optional<ArrayRef<int64_t>> order = getOrder()) {
    SmallVector<int64_t> sorted(*order);
    llvm::sort(sorted);
    if (!llvm::equal(sorted, path->axes))
      return emitOpError("expects an order that lists each axis of its path "
                         "once");
  }
  // (field_c3)
  if (ElementsAttr initial = getInitialAttr()) {
    FailureOr<FieldLayout> layout = getFieldLayout(*this);
    if (failed(layout))
      return failure();
    SmallVector<int64_t> shape = layout->shape;
    if (auto vector = dyn_cast<VectorType>(getType()))
      llvm::append_range(shape, vector.getShape());
    auto wanted = RankedTensorType::get(shape, getElementTypeOrSelf(getType()));
    if (initial.getShapedType() != wanted)
      return emitOpError("expects initial contents of type ")
             << wanted << ", but got " << initial.getShapedType();
    if (!isa<DenseElementsAttr, DenseResourceElementsAttr>(initial))
      return emitOpError("expects initial contents as dense elements");
  }
  if (getAdjointAttr() &&
      failed(verifyRelatedField(*this, getAdjointAttr(), "adjoint", symbols)))
    return failure();
  if (getDualAttr() &&
      failed(verifyRelatedField(*this, getDualAttr(), "dual", symbols)))
    return failure();
  return success();
}

//===----------------------------------------------------------------------===//
// Accesses
//===----------------------------------------------------------------------===//

/// Finds the field that an op names, or reports that it does not exist.
static FieldOp lookupOrError(Operation *op, FlatSymbolRefAttr name,
                             SymbolTableCollection &symbols) {
  auto field = symbols.lookupNearestSymbolFrom<FieldOp>(op, name);
  if (!field)
    op->emitOpError() << "names '" << name << "', which is not a field";
  return field;
}

static LogicalResult verifyIndices(Operation *op, FieldOp field,
                                   size_t indices) {
  if (indices == field.getRank())
    return success();
  InFlightDiagnostic diag = op->emitOpError("expects ")
                            << field.getRank() << " indices, but got "
                            << indices;
  diag.attachNote(field.getLoc()) << "field defined here";
  return diag;
}

/// Checks indices, components and the type of the value of an access.
static LogicalResult verifyAccess(Operation *op, FlatSymbolRefAttr name,
                                  size_t indices, size_t components,
                                  Type valueType,
                                  SymbolTableCollection &symbols) {
  // (load_c1), (load_c2)
  FieldOp field = lookupOrError(op, name, symbols);
  if (!field || failed(verifyIndices(op, field, indices)))
    return failure();
  // (load_c3)
  Type expected = field.getType();
  if (components) {
    auto vector = dyn_cast<VectorType>(expected);
    int64_t rank = vector ? vector.getRank() : 0;
    if (static_cast<int64_t>(components) != rank) {
      InFlightDiagnostic diag = op->emitOpError("expects ")
                                << rank << " component indices, but got "
                                << components;
      diag.attachNote(field.getLoc()) << "field defined here";
      return diag;
    }
    expected = vector.getElementType();
  }
  // (load_c4)
  if (valueType == expected)
    return success();
  InFlightDiagnostic diag = op->emitOpError("expects a value of type ")
                            << expected << ", but got " << valueType;
  diag.attachNote(field.getLoc()) << "field defined here";
  return diag;
}

LogicalResult LoadOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyAccess(*this, getFieldAttr(), getIndices().size(),
                      getComponents().size(), getValue().getType(), symbols);
}
LogicalResult StoreOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyAccess(*this, getFieldAttr(), getIndices().size(),
                      getComponents().size(), getValue().getType(), symbols);
}
LogicalResult AtomicOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyAccess(*this, getFieldAttr(), getIndices().size(),
                      getComponents().size(), getValue().getType(), symbols);
}

LogicalResult AtomicOp::verify() {
  // (atomic_c5)
  Type element = getElementTypeOrSelf(getValue().getType());
  bool isOfIntegers =
      llvm::is_contained({AtomicKind::And, AtomicKind::Or, AtomicKind::Xor,
                          AtomicKind::MinU, AtomicKind::MaxU},
                         getKind());
  if (isOfIntegers && !element.isInteger())
    return emitOpError() << "'" << stringifyAtomicKind(getKind())
                         << "' expects integers, but got " << element;
  // (atomic_c6)
  ReductionAttr reduction = getReductionAttr();
  if (!reduction)
    return success();
  if (getExclusive())
    return emitOpError("is exclusive, and has a reduction");
  bool isFloatSum = isa<FloatType>(element) && (getKind() == AtomicKind::Add ||
                                                getKind() == AtomicKind::Sub);
  if (!isFloatSum && (reduction.getDigits() != SumDigits::Own ||
                      reduction.getForm() == ReductionForm::Fixed))
    return emitOpError("has ")
           << reduction << ", which only sums of floats have";
  return success();
}

LogicalResult ReductionAttr::verify(function_ref<InFlightDiagnostic()> error,
                                    ReductionForm form, SumDigits digits,
                                    ReductionOrder order, int64_t block,
                                    std::optional<int64_t> buffer) {
  bool isInRegister = form == ReductionForm::Register;
  if (isInRegister == buffer.has_value() || buffer.value_or(0) < 0)
    return error() << "expects the number of a buffer with the forms 'buffer' "
                      "and 'fixed', and with no other";
  bool hasLanes =
      order == ReductionOrder::Lanes || order == ReductionOrder::Common;
  if (!isInRegister && order != ReductionOrder::Any)
    return error() << "expects the order 'any' of what is in a buffer";
  if (block < 0 ||
      (block != 0 && (!isInRegister || hasLanes || digits == SumDigits::Wide)))
    return error() << "expects a block, of at least one iteration, with sums "
                      "in a register alone, of own digits or pairs, and not in "
                      "lanes";
  if (digits != SumDigits::Own &&
      (form == ReductionForm::Fixed || order == ReductionOrder::Common))
    return error() << "expects own digits in fixed point and in the common "
                      "order";
  return success();
}

void AtomicOp::build(OpBuilder &, OperationState &state, AtomicKind kind,
                     Value value, FlatSymbolRefAttr field, ValueRange indices,
                     ValueRange components, bool exclusive) {
  state.addOperands(value);
  state.addOperands(indices);
  state.addOperands(components);
  auto &props = state.getOrAddProperties<Properties>();
  props.kind = AtomicKindAttr::get(state.getContext(), kind);
  props.field = field;
  if (exclusive)
    props.exclusive = UnitAttr::get(state.getContext());
  props.operandSegmentSizes = {1, static_cast<int32_t>(indices.size()),
                               static_cast<int32_t>(components.size())};
  state.addTypes(value.getType());
}

/// True if every index of the access is a constant inside the field.
static bool isInBounds(FieldOp field, OperandRange indices) {
  if (!field)
    return false;
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout))
    return false;
  for (auto [index, extent, first] :
       llvm::zip(indices, layout->shape, layout->offset)) {
    llvm::APInt value;
    if (!matchPattern(index, m_ConstantInt(&value)))
      return false;
    int64_t digit = value.getSExtValue() - first;
    if (digit < 0 || digit >= extent)
      return false;
  }
  return true;
}

// Reading an inactive cell yields zero, so the indices alone decide whether a
// load may be executed speculatively.
Speculation::Speculatability LoadOp::getSpeculatability() {
  for (Value component : getComponents())
    if (!matchPattern(component, m_Constant()))
      return Speculation::NotSpeculatable;
  return isInBounds(lookupField(*this, getFieldAttr()), getIndices())
             ? Speculation::Speculatable
             : Speculation::NotSpeculatable;
}

//===----------------------------------------------------------------------===//
// Topology
//===----------------------------------------------------------------------===//

/// Returns the level of the tree that is `up` levels above the place of
/// `field`; 1 is the innermost level.
static SNodeTypeInterface getLevelAbove(FieldOp field, int64_t up) {
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout) || up > static_cast<int64_t>(layout->path.levels.size()))
    return {};
  return layout->path.levels[layout->path.levels.size() - up].type;
}

static LogicalResult verifyLevelAccess(Operation *op, FlatSymbolRefAttr name,
                                       size_t indices, int64_t level,
                                       SymbolTableCollection &symbols) {
  FieldOp field = lookupOrError(op, name, symbols);
  if (!field || failed(verifyIndices(op, field, indices)))
    return failure();
  if (getLevelAbove(field, level))
    return success();
  InFlightDiagnostic diag = op->emitOpError("names level ")
                            << level << ", but the path to the field has fewer";
  diag.attachNote(field.getLoc()) << "field defined here";
  return diag;
}

/// True if a field is below a list (a `dynamic` level); with `directly`, only
/// if it is in the list's own cells.
static bool isBelowList(FieldOp field, bool directly) {
  if (directly) {
    SNodeTypeInterface level = getLevelAbove(field, 1);
    return level && level.isList();
  }
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  return succeeded(layout) &&
         llvm::any_of(layout->path.levels, [](const PathLevel &level) {
           return level.type.isList();
         });
}

static LogicalResult verifyListAccess(Operation *op, FlatSymbolRefAttr name,
                                      size_t indices, Type valueType,
                                      SymbolTableCollection &symbols) {
  FieldOp field = lookupOrError(op, name, symbols);
  if (!field)
    return failure();
  if (!isBelowList(field, /*directly=*/bool(valueType))) {
    InFlightDiagnostic diag =
        op->emitOpError("expects a field below a 'dynamic' level");
    diag.attachNote(field.getLoc()) << "field defined here";
    return diag;
  }
  // Finds the innermost list above the field. No level above the list may
  // divide the axis along the list, because the op omits the index of this
  // axis.
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  ArrayRef<PathLevel> above = layout->path.levels;
  while (!above.back().type.isList())
    above = above.drop_back();
  unsigned along = above.back().type.getAxes().front();
  for (const PathLevel &level : above.drop_back())
    for (auto [axis, extent] :
         llvm::zip(level.type.getAxes(), level.type.getShape()))
      if (axis == along && extent != 1)
        return op->emitOpError("names a list along axis '")
               << getAxisLetter(axis)
               << "', which a level above divides as well; the indices do not "
                  "say which list it is";
  if (indices + 1 != field.getRank())
    return op->emitOpError("expects ")
           << field.getRank() - 1 << " indices, those of the list, but got "
           << indices;
  if (valueType && valueType != field.getType())
    return op->emitOpError("expects a value of type ")
           << field.getType() << ", but got " << valueType;
  return success();
}

LogicalResult VisitsAllOp::verifySymbolUses(SymbolTableCollection &symbols) {
  if (symbols.lookupNearestSymbolFrom<FieldOp>(*this, getFieldAttr()))
    return success();
  return emitOpError() << "names '" << getFieldAttr()
                       << "', which is not a field";
}
LogicalResult ActivateOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyLevelAccess(*this, getFieldAttr(), getIndices().size(),
                           getLevel(), symbols);
}
LogicalResult DeactivateOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyLevelAccess(*this, getFieldAttr(), getIndices().size(),
                           getLevel(), symbols);
}
LogicalResult IsActiveOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyLevelAccess(*this, getFieldAttr(), getIndices().size(),
                           getLevel(), symbols);
}
LogicalResult AppendOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyListAccess(*this, getFieldAttr(), getIndices().size(),
                          getValue().getType(), symbols);
}
LogicalResult LengthOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyListAccess(*this, getFieldAttr(), getIndices().size(), Type(),
                          symbols);
}

//===----------------------------------------------------------------------===//
// Host ops
//===----------------------------------------------------------------------===//

/// Rejects ops of host programs inside kernels.
static LogicalResult verifyOnHost(Operation *op) {
  // (launch_c3)
  Operation *around = op->getParentOp();
  while (around && !isa<FunctionOpInterface>(around))
    around = around->getParentOp();
  auto kernel = dyn_cast_if_present<KernelOp>(around);
  if (!kernel)
    return success();
  InFlightDiagnostic diag =
      op->emitOpError("stands in a kernel; only the host can launch and record "
                      "kernels. Move it into a 'func.func'");
  diag.attachNote(kernel.getLoc()) << "kernel defined here";
  return diag;
}

LogicalResult LaunchOp::verifySymbolUses(SymbolTableCollection &symbols) {
  if (failed(verifyOnHost(*this)))
    return failure();
  // (launch_c1)
  auto kernel =
      symbols.lookupNearestSymbolFrom<KernelOp>(*this, getKernelAttr());
  if (!kernel)
    return emitOpError() << "names '" << getKernelAttr()
                         << "', which is not a kernel";
  // (launch_c2)
  FunctionType type = kernel.getFunctionType();
  if (TypeRange(type.getInputs()) == getOperandTypes() &&
      TypeRange(type.getResults()) == getResultTypes())
    return success();
  InFlightDiagnostic diag = emitOpError("expects the type ")
                            << type << " of the kernel";
  diag.attachNote(kernel.getLoc()) << "kernel defined here";
  return diag;
}

/// Checks that the field `name` can be a loss: a scalar of a float type,
/// without dimensions, and with an adjoint.
static LogicalResult verifyLoss(Operation *op, FlatSymbolRefAttr name,
                                SymbolTableCollection &symbols) {
  FieldOp field = lookupOrError(op, name, symbols);
  if (!field)
    return failure();
  // (tape_c1)
  if (field.getRank() != 0 || !isa<FloatType>(field.getType())) {
    InFlightDiagnostic diag =
        op->emitOpError("expects the loss to be a float field of rank 0");
    diag.attachNote(field.getLoc()) << "field defined here";
    return diag;
  }
  // (tape_c2)
  if (!field.getAdjointAttr()) {
    InFlightDiagnostic diag =
        op->emitOpError("expects the loss to have an adjoint");
    diag.attachNote(field.getLoc()) << "field defined here";
    return diag;
  }
  return success();
}

LogicalResult tai::verifyTape(Operation *tape, FlatSymbolRefAttr loss,
                              SymbolTableCollection &symbols) {
  if (failed(verifyOnHost(tape)))
    return failure();
  // (tape_c4)
  for (Operation *op = tape->getParentOp(); op; op = op->getParentOp())
    if (op->hasTrait<RecordsLaunches>()) {
      InFlightDiagnostic diag =
          tape->emitOpError("stands in another tape; one is recorded at a "
                            "time. End the outer one first");
      diag.attachNote(op->getLoc()) << "the outer tape begins here";
      return diag;
    }
  if (failed(verifyLoss(tape, loss, symbols)))
    return failure();
  // (tape_c3)
  return verifyTapeValues(tape, symbols);
}

LogicalResult TapeOp::verifySymbolUses(SymbolTableCollection &symbols) {
  return verifyTape(*this, getLossAttr(), symbols);
}

LogicalResult
CheckpointAttr::verify(function_ref<InFlightDiagnostic()> emitError,
                       CheckpointKind kind, int64_t snapshots, int64_t budget) {
  if (snapshots < 0 || budget < 0)
    return emitError() << "the number of snapshots and the memory budget of a "
                          "tape must be positive";
  return success();
}
