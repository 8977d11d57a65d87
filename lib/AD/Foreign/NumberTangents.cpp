//===- NumberTangents.cpp - Tangents of arguments and results -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// In forward mode, memory has tangents. Numbers that a function takes or
// returns, and whose tangents are asked for by position, pass through memory.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/AD/Signature.h"
#include "tai/Interfaces/Differentiable.h"

using namespace mlir;
using namespace mlir::tai;

static bool isArray(Type type) { return isa<BaseMemRefType>(type); }

static bool hasTangent(Type type) {
  auto array = dyn_cast<MemRefType>(type);
  return isFloatOrVector(array ? array.getElementType() : type);
}

/// An array of zeros of the shape of `array`.
static Value createZeros(ImplicitLocOpBuilder &b, Value array) {
  auto type = cast<MemRefType>(array.getType());
  Value begin = arith::ConstantIndexOp::create(b, 0);
  Value step = arith::ConstantIndexOp::create(b, 1);
  SmallVector<Value> sizes, unknown;
  for (int64_t i = 0; i != type.getRank(); ++i) {
    sizes.push_back(b.createOrFold<memref::DimOp>(array, i));
    if (type.isDynamicDim(i))
      unknown.push_back(sizes.back());
  }
  auto plain =
      MemRefType::get(type.getShape(), type.getElementType(),
                      MemRefLayoutAttrInterface(), type.getMemorySpace());
  Value made = memref::AllocOp::create(b, plain, unknown);
  Value zero =
      arith::ConstantOp::create(b, b.getZeroAttr(type.getElementType()));
  SmallVector<Value> lower(sizes.size(), begin), steps(sizes.size(), step);
  scf::buildLoopNest(b, b.getLoc(), lower, sizes, steps,
                     [&](OpBuilder &nested, Location loc, ValueRange ivs) {
                       memref::StoreOp::create(nested, loc, zero, made, ivs);
                     });
  return made;
}

void mlir::tai::passNumbers(func::FuncOp function,
                            const AdjointSignature &signature) {
  ImplicitLocOpBuilder b(function.getLoc(), function.getContext());
  Block &block = function.getBody().front();
  b.setInsertionPointToStart(&block);
  for (unsigned position : signature.arguments) {
    BlockArgument argument = block.getArgument(position);
    Type type = argument.getType();
    if (isArray(type))
      continue;
    argument.setType(MemRefType::get({}, type));
    auto value = memref::LoadOp::create(b, argument, ValueRange());
    argument.replaceAllUsesExcept(value, value);
  }
  Operation *end = block.getTerminator();
  b.setInsertionPoint(end);
  for (Value result : end->getOperands()) {
    Value out = block.addArgument(MemRefType::get({}, result.getType()),
                                  function.getLoc());
    memref::StoreOp::create(b, result, out, ValueRange());
  }
  end->setOperands({});
  function.setType(b.getFunctionType(block.getArgumentTypes(), {}));
  function.setAllArgAttrs(SmallVector<DictionaryAttr>(block.getNumArguments(),
                                                      b.getDictionaryAttr({})));
  function.setAllResultAttrs(ArrayRef<DictionaryAttr>());
}

func::FuncOp mlir::tai::wrapNumbers(func::FuncOp original, func::FuncOp inner,
                                    const AdjointSignature &signature) {
  ImplicitLocOpBuilder b(inner.getLoc(), inner.getContext());
  SmallVector<Type> inputs(original.getArgumentTypes());
  SmallVector<Type> results(original.getResultTypes());
  unsigned count = inputs.size();
  for (unsigned position : signature.arguments)
    inputs.push_back(original.getArgumentTypes()[position]);
  for (unsigned position : signature.results)
    results.push_back(original.getResultTypes()[position]);
  b.setInsertionPoint(inner);
  auto wrapper = func::FuncOp::create(b, inner.getName(),
                                      b.getFunctionType(inputs, results));
  Block *block = wrapper.addEntryBlock();
  b.setInsertionPointToStart(block);
  auto createCell = [&](Type type, Value value) -> Value {
    Value cell = memref::AllocaOp::create(b, MemRefType::get({}, type));
    if (value)
      memref::StoreOp::create(b, value, cell, ValueRange());
    return cell;
  };
  auto getZero = [&](Type type) -> Value {
    return arith::ConstantOp::create(b, b.getZeroAttr(type));
  };
  // The tangents follow the arguments of the original and the memory of its
  // results, one for each memref of floats among both.
  SmallVector<Value> given, tangents, outs, outTangents, released;
  unsigned next = count;
  for (BlockArgument argument : block->getArguments().take_front(count)) {
    Type type = argument.getType();
    bool isActive =
        llvm::is_contained(signature.arguments, argument.getArgNumber());
    Value tangent = isActive ? block->getArgument(next++) : Value();
    if (isArray(type)) {
      given.push_back(argument);
      if (!isActive && hasTangent(type)) {
        tangent = createZeros(b, argument);
        released.push_back(tangent);
        if (tangent.getType() != type)
          tangent = memref::CastOp::create(b, type, tangent);
      }
    } else {
      given.push_back(isActive ? createCell(type, argument) : Value(argument));
      if (isActive)
        tangent = createCell(type, tangent);
    }
    if (tangent)
      tangents.push_back(tangent);
  }
  for (Type type : original.getResultTypes()) {
    outs.push_back(createCell(type, Value()));
    outTangents.push_back(hasTangent(type) ? createCell(type, getZero(type))
                                           : Value());
  }
  llvm::append_range(given, outs);
  llvm::append_range(given, tangents);
  for (Value tangent : outTangents)
    if (tangent)
      given.push_back(tangent);
  IRMapping mapping;
  mapping.map(inner.getArguments(), given);
  for (Operation &op : inner.getBody().front().without_terminator())
    b.clone(op, mapping);
  SmallVector<Value> returned;
  for (Value out : outs)
    returned.push_back(memref::LoadOp::create(b, out, ValueRange()));
  for (unsigned position : signature.results)
    returned.push_back(
        memref::LoadOp::create(b, outTangents[position], ValueRange()));
  for (Value array : released)
    memref::DeallocOp::create(b, array);
  func::ReturnOp::create(b, returned);
  for (NamedAttribute attr : inner->getDiscardableAttrs())
    wrapper->setAttr(attr.getName(), attr.getValue());
  inner.erase();
  return wrapper;
}
