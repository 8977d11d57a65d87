//===- LoopAccesses.h - Accesses of a parallel loop -------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CONVERSION_TAITOGPU_LOOPACCESSES_H
#define TAI_CONVERSION_TAITOGPU_LOOPACCESSES_H

#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/IR/BuiltinAttributes.h"
#include "tai/ABI/DeviceAccesses.h"
#include "tai/Analysis/Index/IndexBuilder.h"
#include "tai/Analysis/LoopBox.h"

namespace mlir::tai {

class RuntimeCalls;

/// The attribute of a device function that holds its accesses to memory, as
/// FunctionAccesses encodes them.
constexpr llvm::StringLiteral kAccessesAttrName = "tai.accesses";

/// Attribute of a device function that can run in tiles: the lower bounds of
/// its loop and its access sites, as FunctionAccesses::encodeSites encodes
/// them.
constexpr llvm::StringLiteral kTilesAttrName = "tai.tiles";

/// Attribute of a load or store in the body of a loop that can run in tiles:
/// the number of this access site.
constexpr llvm::StringLiteral kSiteAttrName = "tai.site";

/// Collects the addresses in a loop whose accesses have been lowered to memory,
/// before it is outlined. Constructed from the loop; encoded when the
/// parameters of the outlined function are known.
class LoopAccesses {
public:
  explicit LoopAccesses(ParallelForOp loop);

  /// Adds the memory of a sum over all iterations: the sum is stored at the
  /// address `target`, or its `threads` partial sums from `target` on.
  void addSum(Value target, Type type, bool isAddition, int64_t threads);

  /// Maps a captured value to the number of the parameter that holds it, and an
  /// address to a parameter and its offset from that parameter.
  using ParameterFinder =
      llvm::function_ref<std::optional<std::pair<int64_t, int64_t>>(Value)>;

  /// Encodes the memory accesses of the loop, with captured values as the
  /// numbers of their parameters; null if not all accesses are known.
  DenseI64ArrayAttr encode(ParameterFinder getParameter);

  /// True if iterations access memory by loads and stores alone, so that they
  /// can be repeated in overlapping tiles. If so, numbers these loads and
  /// stores.
  bool canRunInTiles();
  DenseI64ArrayAttr encodeSites(ParameterFinder getParameter);

private:
  /// The address of an access in terms of captured values, which are not yet
  /// parameters.
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
  void ruleOutTiles() { effects = std::max(effects, Effects::Other); }
  void foldIterations();
  bool addIndex(Address &address, Value index, int64_t size,
                ArrayRef<int64_t> digits);
  bool addTerms(Address &address, Value value, int64_t scale);
  static void widen(Address &address, int64_t count, int64_t step);

  ParallelForOp loop;
  IndexBuilder expressions;
  std::optional<LoopBox> box;
  bool isKnown = true;
  bool isGridStride = true;
  /// Tiles repeat iterations, so only loads and stores allow them.
  enum class Effects { LoadsAndStores, Other, Sums };
  Effects effects = Effects::LoadsAndStores;
  SmallVector<Address> addresses;
  std::vector<Site> sites;
};

/// Makes the function of one iteration from `function`, which runs all
/// iterations in the loop `iterations`; the indices become its last parameters.
/// The address of each site goes through a call of `tai_tile_site`, by which
/// programs redirect it to an overlay. Null where the uses of the indices
/// cannot be separated.
LLVM::LLVMFuncOp makeTileFunction(LLVM::LLVMFuncOp function,
                                  scf::ForOp iterations,
                                  ArrayRef<Value> indices, RuntimeCalls &calls);

/// Removes the unused device state from the parameters of `tile` and attaches
/// `sites` to it; erases `tile` if `sites` is null.
void finishTileFunction(LLVM::LLVMFuncOp tile, LLVM::LLVMFuncOp function,
                        DenseI64ArrayAttr sites);

} // namespace mlir::tai

#endif // TAI_CONVERSION_TAITOGPU_LOOPACCESSES_H
