//===- LoopAccesses.h - What a parallel loop touches ------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_CONVERSION_TAITOGPU_LOOPACCESSES_H
#define TAI_LIB_CONVERSION_TAITOGPU_LOOPACCESSES_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "tai/ABI/DeviceAccesses.h"
#include "tai/Analysis/LoopBox.h"

namespace mlir::tai {

class RuntimeCalls;

/// On a device function: what it touches, as FunctionAccesses encodes it.
constexpr llvm::StringLiteral kAccessesAttrName = "tai.accesses";

/// The same, of what can run in tiles: where the loop begins and its sites, as
/// FunctionAccesses::encodeSites does.
constexpr llvm::StringLiteral kTilesAttrName = "tai.tiles";

/// On a load or store in the body of such a loop: its number.
constexpr llvm::StringLiteral kSiteAttrName = "tai.site";

/// Follows the addresses in a loop whose accesses have been lowered to those of
/// memory, before it becomes a function. Made as long as the loop is whole;
/// asked when the parameters of the function are known.
class LoopAccesses {
public:
  LoopAccesses(ParallelForOp loop, bool deterministic);

  /// A sum of all iterations that goes to this address, or whose `threads`
  /// partial sums are stored from there on.
  void addSum(Value target, Type type, bool isAddition, int64_t threads);

  /// Finds the number of the parameter that a value from outside has become,
  /// and how far behind that an address is.
  using ParameterFinder =
      llvm::function_ref<std::optional<std::pair<int64_t, int64_t>>(Value)>;

  /// The list, with values from outside by the numbers of their parameters;
  /// null where it is not known what the loop touches.
  DenseI64ArrayAttr encode(ParameterFinder getParameter);

  /// Whether iterations touch memory by loads and stores alone, so that they
  /// can be run again; these are then numbered.
  bool canRunInTiles();
  DenseI64ArrayAttr encodeSites(ParameterFinder getParameter);

private:
  /// An address with values from outside, which have no numbers yet.
  struct Address {
    runtime::DeviceAccess access;
    Value base;
    SmallVector<std::pair<Value, int64_t>> terms;
  };

  struct Site {
    Address address;
    runtime::TileSite site;
  };

  void visit(Operation *op);
  void addSite(Operation *op, const Address &address, Value pointer,
               DenseI64ArrayAttr digits);
  bool addRegularIndex(Site &site, Value index, int64_t size,
                       ArrayRef<int64_t> digits);
  bool complete(Address &address, ParameterFinder getParameter);
  void addSlot(Value value);
  bool follow(Address &address, Value pointer, DenseI64ArrayAttr digits);
  void add(Value pointer, Type type, runtime::DeviceAccess::Kind kind,
           DenseI64ArrayAttr digits, Operation *op = nullptr);
  void mergeNeighbours();
  void foldIterations();
  bool addIndex(Address &address, Value index, int64_t size,
                ArrayRef<int64_t> digits);
  bool addTerm(Address &address, Value value, int64_t scale, unsigned depth);
  static void widen(Address &address, int64_t count, int64_t step);

  ParallelForOp loop;
  bool deterministic;
  std::optional<LoopBox> box;
  bool isKnown = true;
  bool isPlain = true;
  bool hasSums = false;
  bool isTileable = true;
  SmallVector<Address> addresses;
  std::vector<Site> sites;
};

/// Makes the function of one iteration, whose indices come behind the other
/// parameters, from that of all, which has them in `iterations`. Each address
/// that is a site goes through `tai_tile_site`, for programs that keep its cell
/// somewhere else. Null where the indices cannot be told apart.
LLVM::LLVMFuncOp makeTileFunction(LLVM::LLVMFuncOp function,
                                  scf::ForOp iterations,
                                  ArrayRef<Value> indices, RuntimeCalls &calls);

/// Takes the state of the device, which it does not use, from the parameters of
/// that, and notes its sites; without any, it goes.
void finishTileFunction(LLVM::LLVMFuncOp tile, LLVM::LLVMFuncOp function,
                        DenseI64ArrayAttr sites);

/// An integer constant of at most 64 bits.
std::optional<int64_t> getWholeConstant(Value value);

/// The parts of a sum.
void collectParts(Value sum, SmallVectorImpl<Value> &parts);

} // namespace mlir::tai

#endif // TAI_LIB_CONVERSION_TAITOGPU_LOOPACCESSES_H
