//===- TaiKernelOps.cpp - Kernels and parallel loops ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "DiscardableAttrs.h"
#include "mlir/IR/Builders.h"
#include "mlir/IR/Matchers.h"
#include "mlir/IR/PatternMatch.h"
#include "mlir/Interfaces/FunctionImplementation.h"
#include "tai/Dialect/Tai/IR/Layout.h"
#include "tai/Dialect/Tai/IR/Modes.h"
#include "tai/Dialect/Tai/IR/Tai.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// KernelOp, ReturnOp
//===----------------------------------------------------------------------===//

void KernelOp::build(OpBuilder &builder, OperationState &state, StringRef name,
                     FunctionType type) {
  auto &props = state.getOrAddProperties<Properties>();
  props.sym_name = builder.getStringAttr(name);
  props.function_type = TypeAttr::get(type);
  Block &entry = state.addRegion()->emplaceBlock();
  for (Type input : type.getInputs())
    entry.addArgument(input, state.location);
}

/// Checks the types of the attributes, as generated parsers do: otherwise an
/// attribute of the wrong type would be dropped silently.
template <typename Op>
static ParseResult checkAttributes(OpAsmParser &parser, SMLoc where,
                                   OperationState &result) {
  return Op::verifyInherentAttrs(result.name, result.attributes, [&] {
    return parser.emitError(where)
           << "'" << result.name.getStringRef() << "' op ";
  });
}

ParseResult KernelOp::parse(OpAsmParser &parser, OperationState &result) {
  SMLoc where = parser.getCurrentLocation();
  auto buildType = [](Builder &builder, ArrayRef<Type> inputs,
                      ArrayRef<Type> results,
                      function_interface_impl::VariadicFlag, std::string &) {
    return builder.getFunctionType(inputs, results);
  };
  if (function_interface_impl::parseFunctionOp(
          parser, result, /*allowVariadic=*/false,
          getFunctionTypeAttrName(result.name), buildType,
          getArgAttrsAttrName(result.name), getResAttrsAttrName(result.name)))
    return failure();
  for (const RenamedAttr &renamed : getRenamedKernelAttrs()) {
    Attribute value = result.attributes.get(renamed.old);
    if (!value)
      continue;
    if (result.attributes.get(renamed.name))
      return parser.emitError(where)
             << "'" << renamed.name << "' is given twice: '" << renamed.old
             << "' is an older name of it";
    result.attributes.erase(renamed.old);
    result.attributes.append(renamed.name, value);
  }
  return checkAttributes<KernelOp>(parser, where, result);
}

void KernelOp::print(OpAsmPrinter &printer) {
  function_interface_impl::printFunctionOp(
      printer, *this, /*isVariadic=*/false, getFunctionTypeAttrName(),
      getArgAttrsAttrName(), getResAttrsAttrName());
}

/// True for types of values in a kernel's signature: scalars, and vectors of
/// fixed length.
static bool isKernelValueType(Type type) {
  if (auto vector = dyn_cast<VectorType>(type))
    return !vector.isScalable() &&
           vector.getElementType().isIntOrIndexOrFloat();
  return type.isIntOrIndexOrFloat();
}

/// True for types of kernel arguments: scalars, small vectors, and memrefs of
/// these.
static bool isKernelArgumentType(Type type) {
  if (auto memref = dyn_cast<MemRefType>(type))
    return memref.getLayout().isIdentity() &&
           isKernelValueType(memref.getElementType());
  return isKernelValueType(type);
}

LogicalResult KernelOp::verify() {
  // (kernel_c1)
  if (!getBody().hasOneBlock())
    return emitOpError("expects a body of one block");
  FunctionType type = getFunctionType();
  // (kernel_c2)
  for (auto [i, input] : llvm::enumerate(type.getInputs()))
    if (!isKernelArgumentType(input))
      return emitOpError("argument ")
             << i << " has type " << input
             << "; expects a scalar, a vector, or a memref of them with the "
                "identity layout";
  // (kernel_c3)
  if (type.getNumResults() > 1)
    return emitOpError("expects at most one result, but got ")
           << type.getNumResults();
  for (Type result : type.getResults())
    if (!isKernelValueType(result))
      return emitOpError("returns ")
             << result << "; expects a scalar or a vector";
  // (kernel_c4)
  if (DictionaryAttr modes = getModesAttr();
      modes && failed(verifyModes(*this, modes)))
    return failure();
  // (kernel_c1) A body that was parsed in the generic form of the op possibly
  // ends in another op, or is empty.
  Block &block = getBody().front();
  if (block.empty() || !isa<ReturnOp>(block.back()))
    return emitOpError("expects a body that ends with 'tai.return'");
  return success();
}

LogicalResult ReturnOp::verify() {
  auto kernel = cast<KernelOp>((*this)->getParentOp());
  // (return_c1)
  ArrayRef<Type> expected = kernel.getResultTypes();
  if (TypeRange(expected) == getOperandTypes())
    return success();
  InFlightDiagnostic diag = emitOpError("expects operands of types (")
                            << expected << "), but got (" << getOperandTypes()
                            << ")";
  diag.attachNote(kernel.getLoc()) << "kernel defined here";
  return diag;
}

LogicalResult YieldOp::verify() {
  // (yield_c1)
  Operation *parent = (*this)->getParentOp();
  if (isa<ParallelForOp>(parent) || parent->hasTrait<RecordsLaunches>())
    return success();
  return emitOpError("ends a 'tai.parallel_for', a 'tai.tape' or what records "
                     "launches as that does, not a '")
         << parent->getName() << "'";
}

//===----------------------------------------------------------------------===//
// ParallelForOp
//===----------------------------------------------------------------------===//

/// Adds a body to a loop op: a block with `rank` indices as arguments, and its
/// terminator.
static void addBody(OpBuilder &builder, OperationState &state, size_t rank) {
  OpBuilder::InsertionGuard guard(builder);
  Region *region = state.addRegion();
  Block *block = builder.createBlock(region);
  for (size_t i = 0; i != rank; ++i)
    block->addArgument(builder.getIndexType(), state.location);
  ParallelForOp::ensureTerminator(*region, builder, state.location);
}

void ParallelForOp::build(OpBuilder &builder, OperationState &state,
                          ValueRange lowerBounds, ValueRange upperBounds) {
  state.addOperands(lowerBounds);
  state.addOperands(upperBounds);
  auto &props = state.getOrAddProperties<Properties>();
  props.operandSegmentSizes = {static_cast<int32_t>(lowerBounds.size()),
                               static_cast<int32_t>(upperBounds.size())};
  addBody(builder, state, lowerBounds.size());
}

void ParallelForOp::build(OpBuilder &builder, OperationState &state,
                          FlatSymbolRefAttr field, unsigned rank) {
  auto &props = state.getOrAddProperties<Properties>();
  props.field = field;
  props.operandSegmentSizes = {0, 0};
  addBody(builder, state, rank);
}

// parallel-for ::= `tai.parallel_for` `(` ssa-ids `)`
//                  (`=` `(` bounds `)` `to` `(` bounds `)` |
//                   `in` symbol (`level` integer)?)
//                  (`serialize`)? (`block_dim` integer)? region attr-dict
ParseResult ParallelForOp::parse(OpAsmParser &parser, OperationState &result) {
  Builder &builder = parser.getBuilder();
  auto &props = result.getOrAddProperties<Properties>();
  SmallVector<OpAsmParser::Argument> ivs;
  if (parser.parseArgumentList(ivs, OpAsmParser::Delimiter::Paren))
    return failure();
  for (OpAsmParser::Argument &iv : ivs)
    iv.type = builder.getIndexType();

  SmallVector<OpAsmParser::UnresolvedOperand> lower, upper;
  if (succeeded(parser.parseOptionalKeyword("in"))) {
    FlatSymbolRefAttr field;
    if (parser.parseAttribute(field))
      return failure();
    props.field = field;
    if (succeeded(parser.parseOptionalKeyword("level"))) {
      int64_t level;
      if (parser.parseInteger(level))
        return failure();
      props.level = builder.getI64IntegerAttr(level);
    }
  } else {
    if (parser.parseEqual() ||
        parser.parseOperandList(lower, ivs.size(),
                                OpAsmParser::Delimiter::Paren) ||
        parser.parseKeyword("to") ||
        parser.parseOperandList(upper, ivs.size(),
                                OpAsmParser::Delimiter::Paren) ||
        parser.resolveOperands(lower, builder.getIndexType(),
                               result.operands) ||
        parser.resolveOperands(upper, builder.getIndexType(), result.operands))
      return failure();
  }
  props.operandSegmentSizes = {static_cast<int32_t>(lower.size()),
                               static_cast<int32_t>(upper.size())};
  if (succeeded(parser.parseOptionalKeyword("serialize")))
    props.serialize = builder.getUnitAttr();
  if (succeeded(parser.parseOptionalKeyword("block_dim"))) {
    int64_t size;
    if (parser.parseInteger(size))
      return failure();
    props.block_dim = builder.getI64IntegerAttr(size);
  }
  Region *body = result.addRegion();
  SMLoc attributes;
  if (parser.parseRegion(*body, ivs) ||
      parser.getCurrentLocation(&attributes) ||
      parser.parseOptionalAttrDict(result.attributes) ||
      checkAttributes<ParallelForOp>(parser, attributes, result))
    return failure();
  ParallelForOp::ensureTerminator(*body, builder, result.location);
  return success();
}

void ParallelForOp::print(OpAsmPrinter &printer) {
  printer << " (";
  llvm::interleaveComma(getInductionVars(), printer.getStream(),
                        [&](BlockArgument iv) { printer << iv; });
  printer << ")";
  if (isStructFor())
    printer << " in " << getFieldAttr();
  if (getLevel())
    printer << " level " << *getLevel();
  if (!isStructFor())
    printer << " = (" << getLowerBounds() << ") to (" << getUpperBounds()
            << ")";
  if (getSerialize())
    printer << " serialize";
  if (getBlockDim())
    printer << " block_dim " << *getBlockDim();
  printer << " ";
  printer.printRegion(getBody(), /*printEntryBlockArgs=*/false,
                      /*printBlockTerminators=*/false);
  printer.printOptionalAttrDict(
      (*this)->getAttrs(),
      {getOperandSegmentSizesAttrName(), getFieldAttrName(), getLevelAttrName(),
       getSerializeAttrName(), getBlockDimAttrName()});
}

LogicalResult ParallelForOp::verify() {
  // (parallel_for_c1)
  size_t rank = getBody().getNumArguments();
  for (BlockArgument iv : getBody().getArguments())
    if (!iv.getType().isIndex())
      return emitOpError(
                 "expects induction variables of type 'index', but got ")
             << iv.getType();
  // (parallel_for_c2)
  if (getBlockDim().value_or(1) < 1)
    return emitOpError("expects a positive block_dim, but got ")
           << *getBlockDim();
  // (parallel_for_c3)
  if ((*this)->getParentOfType<ParallelForOp>())
    return emitOpError("cannot stand in another parallel loop; use 'scf.for'");
  // (parallel_for_c5)
  if (isStructFor()) {
    if (!getLowerBounds().empty())
      return emitOpError("runs over a field and cannot take bounds");
    return success();
  }
  // (parallel_for_c4)
  if (getLevel())
    return emitOpError("names a level, but runs over a box");
  if (rank == 0)
    return emitOpError("expects at least one dimension");
  if (getLowerBounds().size() != rank || getUpperBounds().size() != rank)
    return emitOpError("expects ")
           << rank << " lower and upper bounds, but got "
           << getLowerBounds().size() << " and " << getUpperBounds().size();
  return success();
}

LogicalResult ParallelForOp::verifySymbolUses(SymbolTableCollection &symbols) {
  // (parallel_for_c5)
  if (!isStructFor())
    return success();
  auto field = symbols.lookupNearestSymbolFrom<FieldOp>(*this, getFieldAttr());
  if (!field)
    return emitOpError() << "names '" << getFieldAttr()
                         << "', which is not a field";
  if (field.getRank() != getBody().getNumArguments()) {
    InFlightDiagnostic diag = emitOpError("expects ")
                              << field.getRank() << " indices, but got "
                              << getBody().getNumArguments();
    diag.attachNote(field.getLoc()) << "field defined here";
    return diag;
  }
  // (parallel_for_c6)
  if (!getLevel())
    return success();
  FailureOr<FieldLayout> layout = getFieldLayout(field);
  if (failed(layout) || *getLevel() <= layout->path.levels.size())
    return success();
  InFlightDiagnostic diag = emitOpError("names level ")
                            << *getLevel() << " above " << getFieldAttr()
                            << ", which has " << layout->path.levels.size();
  diag.attachNote(field.getLoc()) << "field defined here";
  return diag;
}

void ParallelForOp::copyNotesFrom(ParallelForOp other) {
  (*this)->setDiscardableAttrs(other->getDiscardableAttrDictionary());
  setBlockDimAttr(other.getBlockDimAttr());
  setReachAttr(other.getReachAttr());
  setOuterDimsAttr(other.getOuterDimsAttr());
  setFixedCostAttr(other.getFixedCostAttr());
  setInWarp(other.getInWarp());
  setInOrder(other.getInOrder());
  setOrderAttr(other.getOrderAttr());
}

/// True if one of the ranges of indices is empty, whatever the launch.
static bool hasEmptyRange(ParallelForOp loop) {
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    APInt first, end;
    if (matchPattern(lower, m_ConstantInt(&first)) &&
        matchPattern(upper, m_ConstantInt(&end)) && first.sge(end))
      return true;
  }
  return false;
}

/// True if nothing outside of the loop can tell that it has run: it reads
/// memory at most, and writes to memory that an iteration makes itself.
static bool hasNoEffect(ParallelForOp loop) {
  auto isOwn = [&](Value value) {
    Operation *op = value ? value.getDefiningOp() : nullptr;
    return op && loop->isProperAncestor(op) &&
           hasEffect<MemoryEffects::Allocate>(op, value);
  };
  WalkResult result = loop.getBody().walk([&](Operation *op) {
    if (op->hasTrait<OpTrait::HasRecursiveMemoryEffects>() ||
        isMemoryEffectFree(op))
      return WalkResult::advance();
    auto interface = dyn_cast<MemoryEffectOpInterface>(op);
    if (!interface)
      return WalkResult::interrupt();
    SmallVector<MemoryEffects::EffectInstance> effects;
    interface.getEffects(effects);
    for (const MemoryEffects::EffectInstance &effect : effects)
      if (!isa<MemoryEffects::Read>(effect.getEffect()) &&
          !isOwn(effect.getValue()))
        return WalkResult::interrupt();
    return WalkResult::advance();
  });
  return !result.wasInterrupted();
}

LogicalResult ParallelForOp::canonicalize(ParallelForOp op,
                                          PatternRewriter &rewriter) {
  if (!hasEmptyRange(op) && !hasNoEffect(op))
    return failure();
  rewriter.eraseOp(op);
  return success();
}

SmallVector<Region *> ParallelForOp::getLoopRegions() { return {&getRegion()}; }

std::optional<SmallVector<Value>> ParallelForOp::getLoopInductionVars() {
  return SmallVector<Value>(getInductionVars());
}

/// Returns the first index that a loop over a field may visit along a
/// dimension, and the end of the indices. Passes that query induction variables
/// expect bounds for each.
static std::pair<int64_t, int64_t> getVisitedRange(ParallelForOp loop,
                                                   unsigned dimension) {
  if (auto field = SymbolTable::lookupNearestSymbolFrom<FieldOp>(
          loop, loop.getFieldAttr()))
    if (FailureOr<FieldLayout> layout = getFieldLayout(field);
        succeeded(layout) && dimension < layout->shape.size()) {
      int64_t first = layout->offset.empty() ? 0 : layout->offset[dimension];
      return {first, first + layout->shape[dimension]};
    }
  return {std::numeric_limits<int64_t>::min(),
          std::numeric_limits<int64_t>::max()};
}

static SmallVector<OpFoldResult> getBounds(ParallelForOp loop, bool upper) {
  if (!loop.isStructFor())
    return getAsOpFoldResult(upper ? loop.getUpperBounds()
                                   : loop.getLowerBounds());
  Builder builder(loop.getContext());
  SmallVector<OpFoldResult> bounds;
  for (unsigned i = 0, e = loop.getInductionVars().size(); i < e; ++i) {
    auto [first, end] = getVisitedRange(loop, i);
    bounds.push_back(builder.getIndexAttr(upper ? end : first));
  }
  return bounds;
}

std::optional<SmallVector<OpFoldResult>> ParallelForOp::getLoopLowerBounds() {
  return getBounds(*this, /*upper=*/false);
}

std::optional<SmallVector<OpFoldResult>> ParallelForOp::getLoopUpperBounds() {
  return getBounds(*this, /*upper=*/true);
}

std::optional<SmallVector<OpFoldResult>> ParallelForOp::getLoopSteps() {
  return SmallVector<OpFoldResult>(getInductionVars().size(),
                                   Builder(getContext()).getIndexAttr(1));
}

//===----------------------------------------------------------------------===//
// Locals, asserts
//===----------------------------------------------------------------------===//

LogicalResult AllocaOp::verify() {
  Type type = cast<LocalType>(getLocal().getType()).getElementType();
  Type element = getElementTypeOrSelf(type);
  if (element.isIntOrIndexOrFloat() &&
      (!isa<ShapedType>(type) || isa<VectorType>(type)))
    return success();
  return emitOpError("expects a scalar or a vector, but got ") << type;
}

LogicalResult AllocaOp::canonicalize(AllocaOp op, PatternRewriter &rewriter) {
  // A local that nobody reads.
  for (Operation *user : op->getUsers())
    if (!isa<LocalStoreOp>(user))
      return failure();
  for (Operation *user : llvm::make_early_inc_range(op->getUsers()))
    rewriter.eraseOp(user);
  rewriter.eraseOp(op);
  return success();
}

LogicalResult AssertOp::canonicalize(AssertOp op, PatternRewriter &rewriter) {
  if (!matchPattern(op.getCondition(), m_One()))
    return failure();
  rewriter.eraseOp(op);
  return success();
}

LogicalResult PreconditionOp::canonicalize(PreconditionOp op,
                                           PatternRewriter &rewriter) {
  if (!matchPattern(op.getCondition(), m_One()))
    return failure();
  rewriter.eraseOp(op);
  return success();
}
