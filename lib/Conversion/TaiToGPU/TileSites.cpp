//===- TileSites.cpp - The cells that accesses touch ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Finds loads and stores whose index in each dimension is the index of the
// iteration plus a constant. Programs can keep copies of the accessed elements
// in shared memory: see docs/decisions/0012-fused-launches.md. Other accesses
// are allowed; they use global memory.
//
//===----------------------------------------------------------------------===//

#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/IRMapping.h"
#include "tai/Analysis/Index/IndexShift.h"
#include "tai/Conversion/TaiToGPU/LoopAccesses.h"
#include "tai/Conversion/TaiToHost/RuntimeCalls.h"
#include "tai/Transforms/Utils/FieldAddress.h"

using namespace mlir;
using namespace mlir::tai;
using runtime::DeviceAccess;
using runtime::TileSite;

/// A loop with more memory accesses than this is not taken for a stencil.
static constexpr size_t kMostSites = 64;
/// The largest number of dimensions of a tile.
static constexpr size_t kMostDimensions = 3;

bool LoopAccesses::canRunInTiles() {
  return isKnown && effects == Effects::LoadsAndStores && isGridStride && box &&
         !loop.getInductionVars().empty() &&
         loop.getInductionVars().size() <= kMostDimensions &&
         llvm::any_of(sites, [](const Site &site) {
           return site.address.access.kind == DeviceAccess::Write;
         });
}

void LoopAccesses::addSite(Operation *op, const Address &address, Value pointer,
                           DenseI64ArrayAttr digits) {
  if (effects != Effects::LoadsAndStores || !box ||
      sites.size() == kMostSites) {
    ruleOutTiles();
    return;
  }
  op->setAttr(kSiteAttrName,
              IntegerAttr::get(IntegerType::get(op->getContext(), 32),
                               static_cast<int64_t>(sites.size())));
  Site site;
  site.address = address;
  site.site.isCertain = op->getParentRegion() == &loop.getBody();
  site.site.digits.resize(loop.getInductionVars().size());
  Site regular = site;
  DeviceAccess &access = regular.address.access;
  access.offset = 0;
  access.window = access.size;
  access.step = access.unit = 0;
  access.strides.assign(access.strides.size(), 0);
  regular.address.terms.clear();
  bool isRegular = digits != nullptr, hasIndex = false;
  while (isRegular && !loop.isDefinedOutsideOfLoop(pointer)) {
    auto element = pointer.getDefiningOp<LLVM::GEPOp>();
    int64_t size =
        llvm::divideCeil(element.getElemType().getIntOrFloatBitWidth(), 8);
    auto index = element.getIndices()[0];
    if (auto constant = dyn_cast<IntegerAttr>(index)) {
      access.offset += constant.getInt() * size;
    } else {
      isRegular = !hasIndex && addRegularIndex(regular, cast<Value>(index),
                                               size, digits.asArrayRef());
      hasIndex = true;
    }
    pointer = element.getBase();
  }
  if (isRegular) {
    regular.site.isRegular = true;
    site = std::move(regular);
  }
  sites.push_back(std::move(site));
}

/// Analyses an index that is a sum of digits (parts of loop indices) times
/// their strides. At most one digit may follow each index of the loop.
bool LoopAccesses::addRegularIndex(Site &site, Value index, int64_t size,
                                   ArrayRef<int64_t> digits) {
  // The digits of the address seen so far; a digit that varies may occur only
  // once.
  llvm::SmallDenseSet<size_t> seen;
  for (auto [part, digit, factor] : getSummands(index)) {
    int64_t stride = factor * size;
    SmallVector<Value> variables;
    if (!collectIndexVariables(digit, loop.getBody(), variables))
      return false;
    if (variables.empty()) {
      if (!addTerms(site.address, part, size))
        return false;
      continue;
    }
    size_t at = 0;
    while (at + 2 < digits.size() && digits[at] != stride)
      at += 3;
    if (at + 2 >= digits.size() || !seen.insert(at).second ||
        variables.size() != 1)
      return false;
    auto *variable = llvm::find(loop.getInductionVars(), variables.front());
    if (variable == loop.getInductionVars().end())
      return false;
    size_t d = variable - loop.getInductionVars().begin();
    TileSite::Digit &found = site.site.digits[d];
    int64_t lower = box->lower[d], upper = box->upper[d];
    std::optional<IndexShift> shift =
        getIndexShift(digit, *variable, lower, upper);
    if (!shift || found.stride != 0)
      return false;
    // The constant `peeled` has been subtracted from the index, and is part of
    // the address.
    int64_t extent = digits[at + 1], peeled = -digits[at + 2];
    found = {stride, extent, shift->offset + peeled, shift->wraps};
    site.address.access.offset -= peeled * stride;
    if (shift->wraps) {
      if (peeled != 0 || lower != 0 || upper != extent)
        return false;
    } else if (site.site.isCertain &&
               (lower + found.shift < 0 || upper + found.shift > extent)) {
      return false;
    }
  }
  return true;
}

DenseI64ArrayAttr LoopAccesses::encodeSites(ParameterFinder getParameter) {
  runtime::FunctionAccesses result;
  result.lower.assign(box->lower.begin(), box->lower.end());
  for (Site &site : sites) {
    if (!complete(site.address, getParameter))
      return {};
    site.site.access = std::move(site.address.access);
    result.sites.push_back(std::move(site.site));
  }
  return DenseI64ArrayAttr::get(loop.getContext(), result.encodeSites());
}

LLVM::LLVMFuncOp tai::makeTileFunction(LLVM::LLVMFuncOp function,
                                       scf::ForOp iterations,
                                       ArrayRef<Value> indices,
                                       RuntimeCalls &calls) {
  llvm::SmallDenseSet<Value> known;
  for (Value index : indices)
    if (getConstantIntValue(index) || !known.insert(index).second)
      return nullptr;
  OpBuilder builder(function);
  builder.setInsertionPointAfter(function);
  IRMapping mapping;
  auto tile = cast<LLVM::LLVMFuncOp>(builder.clone(*function, mapping));
  tile.setSymName((function.getSymName() + runtime::tileSuffix).str());
  auto loop = cast<scf::ForOp>(mapping.lookup(iterations.getOperation()));
  Location loc = function.getLoc();
  builder.setInsertionPoint(loop);
  for (Value index : indices) {
    Value argument =
        tile.getBody().front().addArgument(builder.getI32Type(), loc);
    Value number = arith::IndexCastOp::create(builder, loc,
                                              builder.getIndexType(), argument);
    mapping.lookup(index).replaceAllUsesWith(number);
  }
  // The remaining users of the induction variable have no uses themselves, so
  // it may be replaced by any value.
  loop.getInductionVar().replaceAllUsesWith(loop.getLowerBound());
  Block *body = loop.getBody();
  body->getTerminator()->erase();
  loop->getBlock()->getOperations().splice(loop->getIterator(),
                                           body->getOperations());
  loop.erase();
  tile.walk([&](Operation *op) {
    auto number = op->getAttrOfType<IntegerAttr>(kSiteAttrName);
    if (!number)
      return;
    op->removeAttr(kSiteAttrName);
    unsigned operand = isa<LLVM::StoreOp>(op) ? 1 : 0;
    builder.setInsertionPoint(op);
    Value pointer = op->getOperand(operand);
    op->setOperand(
        operand,
        calls.call(
            builder, op->getLoc(), runtime::tileSiteFunction, pointer.getType(),
            {pointer, calls.i32(builder, op->getLoc(), number.getInt())}));
  });
  return tile;
}

void tai::finishTileFunction(LLVM::LLVMFuncOp tile, LLVM::LLVMFuncOp function,
                             DenseI64ArrayAttr sites) {
  if (!sites)
    return tile.erase();
  function->setAttr(kTilesAttrName, sites);
  tile.getBody().front().eraseArgument(0);
  tile.setFunctionType(LLVM::LLVMFunctionType::get(
      LLVM::LLVMVoidType::get(tile.getContext()),
      llvm::to_vector(tile.getBody().getArgumentTypes())));
}
