//===- OutlineLoop.cpp - Parallel loops become device functions -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The function of a loop is a grid-stride loop over all iterations, so that it
// is correct for any number of blocks and threads. Its parameters are the
// captured values, one for each.
//
//===----------------------------------------------------------------------===//

#include "Reductions/Sums.h"
#include "Reductions/WarpLoop.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "tai/Conversion/TaiToGPU/LoopAccesses.h"
#include "tai/Conversion/TaiToGPU/Offload.h"
#include "tai/Conversion/TaiToHost/Reductions/Accumulators.h"
#include "tai/Dialect/Tai/IR/Ownership.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "tai/Transforms/Utils/IndexMath.h"
#include "tai/Transforms/Utils/SumOrder.h"
#include "llvm/ADT/SetVector.h"

using namespace mlir;
using namespace mlir::tai;

/// The number of threads of a block, as given in the launch in the IR; the
/// runtime may choose another number.
constexpr int64_t kBlockDim = 256;

//===----------------------------------------------------------------------===//
// Iterations
//===----------------------------------------------------------------------===//

/// Emits the number of the current thread in the grid, and the number of
/// threads.
static std::pair<Value, Value> emitThread(OpBuilder &builder, Location loc) {
  IndexMath math(builder, loc);
  auto x = gpu::Dimension::x;
  Value block = gpu::BlockIdOp::create(builder, loc, x);
  Value size = gpu::BlockDimOp::create(builder, loc, x);
  Value thread = gpu::ThreadIdOp::create(builder, loc, x);
  Value blocks = gpu::GridDimOp::create(builder, loc, x);
  return {math.add(math.mul(block, size), thread), math.mul(blocks, size)};
}

namespace {
/// The loop over the iterations of one device thread, and the loop indices in
/// it.
struct Iterations {
  scf::ForOp loop;
  SmallVector<Value> indices;
};
} // namespace

/// Emits the loop over the iterations of this thread and moves the body into
/// it. Fused programs rely on which iterations a thread runs: see
/// FunctionAccesses::isGridStride.
static Iterations emitIterations(OpBuilder &builder, ParallelForOp loop,
                                 MutableArrayRef<Sum> sums,
                                 DeviceLowering &lowering) {
  RuntimeCalls &runtime = lowering.device.runtime;
  Location loc = loop.getLoc();
  IndexMath math(builder, loc);
  SmallVector<Value> extents;
  Value count = math.constant(1);
  // Constants are created anew in the function of the loop; other values are
  // captured later.
  auto inside = [&](Value value) -> Value {
    if (auto constant = getConstantIntValue(value))
      return math.constant(*constant);
    return value;
  };
  SmallVector<Value> lower;
  for (auto [from, to] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    lower.push_back(inside(from));
    extents.push_back(math.extent(lower.back(), inside(to)));
    count = math.mul(count, extents.back());
  }
  auto [thread, threads] = emitThread(builder, loc);
  Value end = count;
  WarpPart warp;
  if (loop.getInWarp()) {
    warp = emitWarpPart(builder, loop, thread, count, runtime);
    thread = warp.first;
    threads = warp.step;
  } else if (llvm::any_of(sums, [](const Sum &sum) { return sum.isPartial; })) {
    // The order of partial sums needs a fixed number of virtual threads. A
    // thread of the launch does the work of one or several virtual threads.
    auto standIns = scf::ForOp::create(
        builder, loc, thread, math.constant(getSumThreads(loop)), threads);
    builder.setInsertionPointToStart(standIns.getBody());
    for (Sum &sum : sums)
      if (sum.isPartial)
        emitSlotStore(builder, loc,
                      arith::ConstantOp::create(
                          builder, loc, getLaneStart(sum.kind, sum.kept)),
                      sum.slot);
    // In this order, a virtual thread is a lane of a chunk of iterations.
    // Chunks beyond the last one are empty.
    IndexMath in(builder, loc);
    Value number = standIns.getInductionVar();
    Value length = emitChunkLength(builder, loc, count);
    Value chunk = in.div(number, SumOrder::kLanes);
    Value chunks = in.div(in.add(count, in.sub(length, 1)), length);
    Value isThere = arith::CmpIOp::create(
        builder, loc, arith::CmpIPredicate::slt, chunk, chunks);
    Value first = in.mul(
        arith::SelectOp::create(builder, loc, isThere, chunk, in.constant(0)),
        length);
    Value last = in.add(first, in.min(length, in.sub(count, first)));
    auto strides = in.constant(SumOrder::kLanes);
    thread = in.add(first, in.rem(number, SumOrder::kLanes));
    end = arith::SelectOp::create(builder, loc, isThere, last, in.constant(0));
    threads = strides;
    builder.setInsertionPoint(standIns.getBody()->getTerminator());
    for (Sum &sum : sums)
      if (sum.isPartial)
        emitStore(builder, loc, emitSlotLoad(builder, loc, sum.kept, sum.slot),
                  emitPointer(builder, loc, getStorageType(sum.kept),
                              sum.target, standIns.getInductionVar()),
                  AliasScopes());
    builder.setInsertionPointAfter(end.getDefiningOp());
  }
  if (warp.lane)
    emitWarpBarrier(builder, loc, warp, runtime);
  auto iterations = scf::ForOp::create(builder, loc, thread, end, threads);
  // The induction variable exceeds the number of iterations by up to the stride
  // of the grid. That number may be close to the largest index, so the
  // comparison must be unsigned.
  if (extents.size() == 1 && !getConstantIntValue(count) && !warp.lane)
    iterations.setUnsignedCmp(true);
  if (warp.lane)
    emitWarpBarrier(builder, loc, warp, runtime);
  Block *block = iterations.getBody();
  builder.setInsertionPointToStart(block);
  IndexMath in(builder, loc);
  Value rest = iterations.getInductionVar(), isActive;
  if (warp.lane) {
    Value mine = in.add(rest, warp.lane);
    isActive = arith::CmpIOp::create(builder, loc, arith::CmpIPredicate::slt,
                                     mine, count);
    rest = in.min(mine, in.sub(count, 1));
  }
  SmallVector<Value> indices(extents.size());
  for (size_t d = extents.size(); d-- > 0;) {
    Value digit = d == 0 ? rest : in.rem(rest, extents[d]);
    if (d != 0)
      rest = in.div(rest, extents[d]);
    indices[d] = in.add(lower[d], digit);
  }
  Block &body = loop.getBody().front();
  for (auto [argument, index] : llvm::zip(body.getArguments(), indices))
    argument.replaceAllUsesWith(index);
  body.getTerminator()->erase();
  block->getOperations().splice(block->getTerminator()->getIterator(),
                                body.getOperations());
  if (isActive)
    orderAdditions(block, isActive, loop.getOrder() == LoopOrder::Common,
                   runtime);
  return {iterations, std::move(indices)};
}

//===----------------------------------------------------------------------===//
// Parameters
//===----------------------------------------------------------------------===//

namespace {
/// Turns the values of the host part that a device function uses into
/// parameters of the function.
class Parameters {
public:
  Parameters(LLVM::LLVMFuncOp function, Operation *launch,
             RuntimeCalls &runtime)
      : function(function), launch(launch), runtime(runtime),
        entry(function.getContext()) {}

  LogicalResult capture();
  /// The number of the parameter that holds a captured value; for an address,
  /// also its offset from the address that the parameter holds.
  std::optional<std::pair<int64_t, int64_t>> find(Value outer) const {
    int64_t distance = 0;
    for (auto next = near.find(outer); next != near.end();
         next = near.find(outer)) {
      distance += next->second.second;
      outer = next->second.first;
    }
    auto found = numbers.find(outer);
    if (found == numbers.end())
      return std::nullopt;
    return std::pair(found->second, distance);
  }
  /// The values of the host part that the launch passes to the device function
  /// as parameters.
  ArrayRef<Value> getOperands() const { return operands; }

private:
  FailureOr<Value> get(Value outer);
  Value addParameter(Value outer);
  void collectAddress(Value outer);
  Value findNeighbour(Value outer);

  LLVM::LLVMFuncOp function;
  Operation *launch;
  RuntimeCalls &runtime;
  OpBuilder entry;
  SmallVector<Value> operands;
  llvm::DenseMap<Value, Value> known;
  llvm::DenseMap<Value, int64_t> numbers;
  /// addresses: for each origin, the captured addresses derived from it, by
  /// their distance. near: for an address, a lower address close by that has a
  /// parameter, and the distance.
  llvm::MapVector<Value, SmallVector<std::pair<int64_t, Value>>> addresses;
  llvm::DenseMap<Value, std::pair<Value, int64_t>> near;
};
} // namespace

/// Adds a parameter of a type that a device function can have.
Value Parameters::addParameter(Value outer) {
  Block *block = &function.getBody().front();
  OpBuilder host(launch);
  Location loc = launch->getLoc();
  Type type = outer.getType();
  Type passed = type;
  if (type.isIndex())
    passed = entry.getI64Type();
  else if (type.isInteger(1))
    passed = entry.getI8Type();
  Value operand = outer;
  if (type.isIndex())
    operand = arith::IndexCastOp::create(host, loc, passed, outer);
  else if (passed != type)
    operand = arith::ExtUIOp::create(host, loc, passed, outer);
  numbers[outer] = operands.size();
  operands.push_back(operand);
  Value parameter = block->addArgument(passed, outer.getLoc());
  entry.setInsertionPointToStart(block);
  if (type.isIndex())
    return arith::IndexCastOp::create(entry, loc, type, parameter);
  if (passed != type)
    return arith::TruncIOp::create(entry, loc, type, parameter);
  return parameter;
}

/// The address in the host part that `address` is derived from, and the
/// constant distance between the two.
static std::pair<Value, int64_t> getOrigin(Value address) {
  int64_t distance = 0;
  while (auto element = address.getDefiningOp<LLVM::GEPOp>()) {
    auto indices = element.getIndices();
    if (indices.size() != 1 || !element.getElemType().isInteger(8))
      break;
    auto constant = dyn_cast<IntegerAttr>(indices[0]);
    APInt offset;
    if (constant)
      offset = constant.getValue();
    else if (!matchPattern(cast<Value>(indices[0]), m_ConstantInt(&offset)))
      break;
    distance += offset.getSExtValue();
    address = element.getBase();
  }
  return {address, distance};
}

/// Returns the known alignment of an address in the host part.
static int64_t getAddressAlignment(Value address) {
  auto [origin, distance] = getOrigin(address);
  Operation *definition = origin.getDefiningOp();
  auto known = definition
                   ? definition->getAttrOfType<IntegerAttr>(kAlignmentAttrName)
                   : nullptr;
  return known ? llvm::MinAlign(known.getInt(), distance) : 1;
}

void Parameters::collectAddress(Value outer) {
  if (!isa<LLVM::LLVMPointerType>(outer.getType()))
    return;
  auto [origin, distance] = getOrigin(outer);
  addresses[origin].push_back({distance, outer});
}

/// Returns the first address that is at most 128 bytes before `outer`:
/// addresses of fields in one cell share a parameter, so that LLVM knows their
/// distance.
Value Parameters::findNeighbour(Value outer) {
  constexpr int64_t close = 128;
  auto [origin, distance] = getOrigin(outer);
  int64_t first = distance;
  Value neighbour;
  for (auto [other, address] : addresses.lookup(origin))
    if (other < first && distance - other < close) {
      first = other;
      neighbour = address;
    }
  if (neighbour)
    near[outer] = {neighbour, distance - first};
  return neighbour;
}

FailureOr<Value> Parameters::get(Value outer) {
  if (Value value = known.lookup(outer))
    return value;
  Operation *definition = outer.getDefiningOp();
  Value value;
  if (definition && definition->hasTrait<OpTrait::ConstantLike>()) {
    entry.setInsertionPointToStart(&function.getBody().front());
    value = entry.clone(*definition)->getResult(0);
  } else if (definition && definition->hasAttr(kDeviceSlotAttrName)) {
    FailureOr<Value> slot = get(definition->getOperand(0));
    if (failed(slot))
      return failure();
    entry.setInsertionPointAfterValue(*slot);
    value = emitSlotLoad(entry, launch->getLoc(), outer.getType(), *slot);
    if (isa<LLVM::LLVMPointerType>(outer.getType()))
      value = markHandedOn(entry, launch->getLoc(), value, runtime);
  } else if (Value neighbour = findNeighbour(outer)) {
    FailureOr<Value> base = get(neighbour);
    if (failed(base))
      return failure();
    entry.setInsertionPointAfterValue(*base);
    value = LLVM::GEPOp::create(
        entry, launch->getLoc(), outer.getType(), entry.getI8Type(), *base,
        ArrayRef<LLVM::GEPArg>{static_cast<int32_t>(near[outer].second)},
        LLVM::GEPNoWrapFlags::inbounds | LLVM::GEPNoWrapFlags::nuw);
  } else if (outer.getType().isIntOrIndexOrFloat() ||
             isa<LLVM::LLVMPointerType>(outer.getType())) {
    value = addParameter(outer);
  } else {
    InFlightDiagnostic diag = launch->emitOpError("uses a value of type ")
                              << outer.getType()
                              << " from outside; expects scalars";
    diag.attachNote(outer.getLoc()) << "value defined here";
    return diag;
  }
  known[outer] = value;
  return value;
}

LogicalResult Parameters::capture() {
  Region &region = function.getBody();
  region.walk([&](Operation *op) {
    for (Value operand : op->getOperands())
      if (!region.isAncestor(operand.getParentRegion()))
        collectAddress(operand);
  });
  return replaceOutside(
      region,
      [&](Value value) { return !region.isAncestor(value.getParentRegion()); },
      [&](Value outer) { return get(outer); });
}

/// Marks loads from memory that the function does not write as invariant, so
/// that they use the read-only cache.
static void markInvariantLoads(LLVM::LLVMFuncOp function, ArrayRef<Sum> sums) {
  llvm::DenseSet<Attribute> written;
  bool writesUnknown = false;
  auto addWrite = [&](ArrayAttr scope) {
    if (scope)
      written.insert(scope);
  };
  for (const Sum &sum : sums)
    addWrite(sum.scope);
  function.walk([&](Operation *op) {
    if (auto store = dyn_cast<LLVM::StoreOp>(op))
      addWrite(store.getAliasScopesAttr());
    else if (auto update = dyn_cast<LLVM::AtomicRMWOp>(op))
      addWrite(update.getAliasScopesAttr());
    else if (auto scope = op->getAttr(kOrderedScopeAttrName)) {
      addWrite(dyn_cast<ArrayAttr>(scope));
      writesUnknown |= !isa<ArrayAttr>(scope);
      op->removeAttr(kOrderedScopeAttrName);
    } else if (isa<LLVM::AtomicCmpXchgOp>(op))
      writesUnknown = true;
    else if (isa<ActivateCellOp, DeactivateCellOp, AppendCellOp>(op))
      writesUnknown = true;
  });
  if (writesUnknown)
    return;
  function.walk([&](LLVM::LoadOp load) {
    ArrayAttr scope = load.getAliasScopesAttr();
    if (scope && !written.contains(scope) &&
        load.getOrdering() == LLVM::AtomicOrdering::not_atomic)
      load.setInvariant(true);
  });
}

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

/// Emits the number of iterations of the loop if the host knows or can predict
/// it, else returns null.
static Value emitCount(OpBuilder &builder, ParallelForOp loop) {
  IndexMath math(builder, loop.getLoc());
  Value count = math.constant(1);
  for (auto [from, to] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    Value guessed = to;
    for (Value bound : {from, to})
      if (Operation *definition = bound.getDefiningOp())
        if (definition->hasAttr(kDeviceSlotAttrName)) {
          if (bound != to || definition->getNumOperands() < 2)
            return Value();
          guessed = definition->getOperand(1);
        }
    count = math.mul(count, math.extent(from, guessed));
  }
  return count;
}

static void emitLaunch(ParallelForOp loop, LLVM::LLVMFuncOp function,
                       ValueRange operands, DeviceLowering &lowering) {
  OpBuilder builder(loop);
  Location loc = loop.getLoc();
  IndexMath math(builder, loc);
  Value one = math.constant(1);
  // The function of a loop in one warp specifies its own block size.
  bool inWarp = loop.getInWarp();
  Value threads =
      inWarp ? one : math.constant(loop.getBlockDim().value_or(kBlockDim));
  // A launch with zero blocks stands for a number that only the device knows.
  Value blocks = math.constant(0);
  if (inWarp) {
    blocks = one;
  } else if (Value count = emitCount(builder, loop)) {
    std::optional<int64_t> constant = getConstantIntValue(count);
    if (constant && *constant <= 1 && !loop.getBlockDim())
      threads = one;
    int64_t size = *getConstantIntValue(threads);
    blocks = math.div(math.add(count, math.constant(size - 1)), size);
    if (!constant)
      // A loop without iterations must not look like a loop of unknown length.
      blocks = math.max(blocks, one);
  }
  auto kernel =
      SymbolRefAttr::get(lowering.kernels.getSymNameAttr(),
                         {FlatSymbolRefAttr::get(function.getSymNameAttr())});
  gpu::LaunchFuncOp::create(builder, loc, kernel,
                            gpu::KernelDim3{blocks, one, one},
                            gpu::KernelDim3{threads, one, one},
                            /*dynamicSharedMemorySize=*/Value(), operands);
}

/// Returns the trees in which code below `op` activates or deactivates cells,
/// and for each whether it deactivates any.
static llvm::MapVector<Value, bool> findActivated(Operation *op) {
  llvm::MapVector<Value, bool> trees;
  op->walk([&](Operation *inner) {
    if (isa<ActivateCellOp, DeactivateCellOp, AppendCellOp>(inner))
      trees[inner->getOperand(0)] |= isa<DeactivateCellOp>(inner);
  });
  return trees;
}

/// True if one thread runs the whole loop.
static bool runsAlone(ParallelForOp loop) {
  for (auto [lower, upper] :
       llvm::zip(loop.getLowerBounds(), loop.getUpperBounds())) {
    auto first = getConstantIntValue(lower), end = getConstantIntValue(upper);
    if (!first || !end || *end > *first + 1)
      return false;
  }
  return true;
}

LogicalResult tai::outlineLoop(ParallelForOp loop, Value frame, StringRef name,
                               DeviceLowering &lowering) {
  Location loc = loop.getLoc();
  MLIRContext *context = loop.getContext();
  RuntimeCalls &runtime = lowering.device.runtime;
  SmallVector<Sum> sums = collectSums(loop, lowering.device.fields);
  if (loop.getInWarp())
    prepareWarpLoop(loop);
  llvm::MapVector<Value, bool> activated = findActivated(loop);
  LoopAccesses accesses(loop);
  for (const Sum &sum : sums)
    accesses.addSum(sum.target, sum.isPartial ? sum.kept : sum.type,
                    sum.kind == AtomicKind::Add,
                    sum.isPartial ? getSumThreads(loop) : 0);

  // Loops inside this loop run serially within a thread.
  SmallVector<ParallelForOp> inner;
  loop.getBody().walk([&](ParallelForOp other) { inner.push_back(other); });
  for (ParallelForOp other : inner)
    if (failed(lowerSerially(other, lowering.device.fields)))
      return failure();

  OpBuilder builder =
      OpBuilder::atBlockEnd(&lowering.kernels.getBodyRegion().front());
  auto voidType = LLVM::LLVMVoidType::get(context);
  auto function = LLVM::LLVMFuncOp::create(
      builder, loc, name, LLVM::LLVMFunctionType::get(voidType, {}));
  function.setNoUnwind(true);
  markLowered(function);
  // The threads of a warp synchronise in the function, so its calls must not be
  // duplicated.
  if (loop.getInWarp())
    function.setConvergent(true);
  Block *entry = function.addEntryBlock(builder);
  // The first argument of the function is a placeholder for the device state
  // until it is known whether the function uses it.
  Value state = entry->addArgument(runtime.getPointerType(), loc);
  builder.setInsertionPointToEnd(entry);
  auto ret = LLVM::ReturnOp::create(builder, loc, ValueRange());
  builder.setInsertionPoint(ret);
  for (Sum &sum : sums)
    emitSumStart(builder, loc, sum);
  builder.setInsertionPoint(ret);
  Iterations iterations = emitIterations(builder, loop, sums, lowering);
  for (Sum &sum : sums)
    rewriteUpdates(sum);
  builder.setInsertionPoint(ret);
  for (Sum &sum : sums) {
    if (!sum.isPartial) {
      emitSumEnd(builder, loc, sum, runtime);
    } else if (loop.getInWarp()) {
      auto [thread, threads] = emitThread(builder, loc);
      storeParts(builder, loc, sum, thread, threads, getSumThreads(loop));
    }
  }

  Parameters parameters(function, loop, runtime);
  if (failed(parameters.capture()))
    return failure();
  LLVM::LLVMFuncOp tile;
  if (accesses.canRunInTiles())
    tile = makeTileFunction(function, iterations.loop, iterations.indices,
                            runtime);
  function.walk([](Operation *op) { op->removeAttr(kSiteAttrName); });
  markInvariantLoads(function, sums);
  if (failed(lowerLeafOps(function, lowering.device)) ||
      (tile && failed(lowerLeafOps(tile, lowering.device))))
    return failure();
  // Where the threads of a warp synchronise inside loops, no thread may exit
  // alone, so such loops do not poll.
  if (!loop.getInWarp())
    pollLongLoops(function, iterations.loop, runsAlone(loop),
                  lowering.countless.contains(loop), runtime);
  guardAllocations(function, runtime);

  SmallVector<Value> operands(parameters.getOperands());
  bool usesState = !state.use_empty();
  // The numbering of parameters includes the device state if the function uses
  // it.
  auto getParameter = [&](Value outer) {
    auto number = parameters.find(outer);
    if (number)
      number->first += usesState;
    return number;
  };
  DenseI64ArrayAttr list = accesses.encode(getParameter);
  if (list)
    function->setAttr(kAccessesAttrName, list);
  // Code that may print or fail must not be repeated in tiles.
  if (tile)
    finishTileFunction(tile, function,
                       list && !usesState && tile.getArgument(0).use_empty()
                           ? accesses.encodeSites(getParameter)
                           : DenseI64ArrayAttr());
  if (!usesState) {
    entry->eraseArgument(0);
  } else {
    RuntimeCalls &host = lowering.host.runtime;
    OpBuilder before(loop);
    operands.insert(operands.begin(),
                    host.tai_rt_device_state(before, loc, frame));
  }
  function.setFunctionType(LLVM::LLVMFunctionType::get(
      voidType, llvm::to_vector(entry->getArgumentTypes())));
  // With the alignment of a parameter, LLVM can combine accesses to
  // neighbouring elements.
  for (auto [i, operand] : llvm::enumerate(operands))
    if (isa<LLVM::LLVMPointerType>(operand.getType()))
      if (int64_t alignment = getAddressAlignment(operand); alignment > 1)
        function.setArgAttr(
            i, LLVM::LLVMDialect::getAlignAttrName(),
            IntegerAttr::get(IntegerType::get(context, 64), alignment));
  function->setAttr(gpu::GPUDialect::getKernelFuncAttrName(),
                    UnitAttr::get(context));
  noteSizes(loop, function);
  emitLaunch(loop, function, operands, lowering);
  // The launch makes the host's record of active cells out of date.
  OpBuilder after(loop);
  RuntimeCalls &hostCalls = lowering.host.runtime;
  for (auto [tree, removes] : activated)
    hostCalls.tai_rt_device_activates(after, loc, frame, tree,
                                      hostCalls.i32(after, loc, removes));
  loop.erase();
  return success();
}
