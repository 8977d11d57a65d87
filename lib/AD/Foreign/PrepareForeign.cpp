//===- PrepareForeign.cpp - Functions of other dialects -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Recursion.h"
#include "mlir/Conversion/AffineToStandard/AffineToStandard.h"
#include "mlir/Conversion/ControlFlowToSCF/ControlFlowToSCF.h"
#include "mlir/Dialect/Affine/IR/AffineOps.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Arith/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/Bufferization/IR/Bufferization.h"
#include "mlir/Dialect/Bufferization/Transforms/FuncBufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/Bufferization/Transforms/OneShotAnalysis.h"
#include "mlir/Dialect/Complex/IR/Complex.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlow.h"
#include "mlir/Dialect/ControlFlow/IR/ControlFlowOps.h"
#include "mlir/Dialect/ControlFlow/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/GPU/IR/GPUDialect.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/Linalg/IR/Linalg.h"
#include "mlir/Dialect/Linalg/Passes.h"
#include "mlir/Dialect/Linalg/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/Linalg/Transforms/Transforms.h"
#include "mlir/Dialect/Math/IR/Math.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Dialect/SCF/IR/SCF.h"
#include "mlir/Dialect/SCF/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/SCF/Transforms/Passes.h"
#include "mlir/Dialect/SCF/Transforms/Transforms.h"
#include "mlir/Dialect/Tensor/IR/Tensor.h"
#include "mlir/Dialect/Tensor/IR/TensorInferTypeOpInterfaceImpl.h"
#include "mlir/Dialect/Tensor/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/Dialect/UB/IR/UBOps.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/Dialect/Vector/Transforms/BufferizableOpInterfaceImpl.h"
#include "mlir/IR/Dominance.h"
#include "mlir/IR/ImplicitLocOpBuilder.h"
#include "mlir/Pass/PassManager.h"
#include "mlir/Transforms/CFGToSCF.h"
#include "mlir/Transforms/DialectConversion.h"
#include "mlir/Transforms/Passes.h"
#include "tai/AD/Foreign/Foreign.h"
#include "tai/AD/Passes.h"
#include "tai/AD/Prepare/Selection.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "tai/Dialect/Tai/IR/Tai.h"

namespace mlir::tai {
#define GEN_PASS_DEF_PREPAREFOREIGN
#include "tai/AD/Passes.h.inc"
} // namespace mlir::tai

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Copies of functions prepared for differentiation, and their originals
//===----------------------------------------------------------------------===//

FunctionOpInterface mlir::tai::getOriginal(FunctionOpInterface function) {
  auto name = function->getAttrOfType<FlatSymbolRefAttr>(kPreparedFor);
  if (!name)
    return function;
  return SymbolTable::lookupNearestSymbolFrom<FunctionOpInterface>(
      function->getParentOp(), name);
}

void mlir::tai::erasePrepared(ModuleOp module) {
  for (auto function :
       llvm::make_early_inc_range(module.getOps<func::FuncOp>()))
    if (function->hasAttr(kPreparedFor))
      function.erase();
}

bool mlir::tai::isSplit(FunctionOpInterface function) {
  return isa_and_present<ArrayAttr>(function->getAttr(kSplit));
}

bool mlir::tai::isWrapped(FunctionOpInterface prepared) {
  return getOriginal(prepared).getArgumentTypes() !=
         prepared.getArgumentTypes();
}

//===----------------------------------------------------------------------===//
// Functions that need preparation
//===----------------------------------------------------------------------===//

static bool isSumOrUnused(memref::AtomicRMWOp atomic) {
  return atomic.getKind() == arith::AtomicRMWKind::addf &&
         atomic.getResult().use_empty();
}

static bool isForeign(Operation *op) {
  StringRef dialect = op->getName().getDialectNamespace();
  if (llvm::is_contained({"affine", "bufferization", "cf", "complex", "linalg",
                          "llvm", "tensor", "tosa"},
                         dialect))
    return true;
  if (auto atomic = dyn_cast<memref::AtomicRMWOp>(op))
    return !isSumOrUnused(atomic);
  if (auto parallel = dyn_cast<scf::ParallelOp>(op))
    return llvm::any_of(parallel.getBody()->getTerminator()->getRegions(),
                        [](Region &region) {
                          return !isa<arith::AddFOp>(region.front().front());
                        });
  if (auto loop = dyn_cast<scf::ForOp>(op); loop && loop.getUnsignedCmp())
    return true;
  if (isa<arith::SelectOp, scf::ForOp, scf::IfOp, scf::WhileOp>(op))
    return llvm::any_of(op->getResultTypes(),
                        [](Type type) { return isa<BaseMemRefType>(type); });
  if (isa<memref::MemRefDialect>(op->getDialect()))
    return !isa<memref::LoadOp, memref::StoreOp, memref::DimOp,
                memref::GetGlobalOp>(op);
  return isa<func::CallIndirectOp, func::CallOp, gpu::LaunchOp,
             scf::ExecuteRegionOp, scf::ForallOp, scf::IndexSwitchOp,
             vector::CompressStoreOp, vector::ContractionOp,
             vector::DeinterleaveOp, vector::ExpandLoadOp,
             vector::ExtractStridedSliceOp, vector::GatherOp,
             vector::InsertStridedSliceOp, vector::InterleaveOp, vector::LoadOp,
             vector::MaskedLoadOp, vector::MaskedStoreOp,
             vector::MultiDimReductionOp, vector::OuterProductOp,
             vector::PrintOp, vector::ScanOp, vector::ScatterOp,
             vector::StoreOp, vector::TransferReadOp, vector::TransferWriteOp>(
      op);
}

static bool isTensor(Type type) { return isa<TensorType>(type); }

static bool needsPreparation(func::FuncOp function) {
  if (llvm::any_of(function.getArgumentTypes(), isTensor) ||
      llvm::any_of(function.getResultTypes(), isTensor) ||
      !function.getBody().hasOneBlock())
    return true;
  return function
      .walk([](Operation *op) {
        return op->getDialect() && isForeign(op) ? WalkResult::interrupt()
                                                 : WalkResult::advance();
      })
      .wasInterrupted();
}

//===----------------------------------------------------------------------===//
// Control flow
//===----------------------------------------------------------------------===//

/// Replaces the blocks of a region by structured control flow.
static LogicalResult liftBlocks(func::FuncOp function) {
  SmallVector<Region *> regions;
  function.walk([&](Operation *op) {
    for (Region &region : op->getRegions())
      if (!region.empty() && !region.hasOneBlock())
        regions.push_back(&region);
  });
  for (Region *region : regions) {
    ControlFlowToSCFTransformation transformation;
    DominanceInfo dominance(function);
    if (failed(transformCFGToSCF(*region, transformation, dominance)))
      return function.emitError(
          "cannot make structured control flow of the blocks of this function");
  }
  // The value of a poison op is never used, and a zero replaces it.
  function.walk([](ub::PoisonOp poison) {
    OpBuilder b(poison);
    Type type = poison.getType();
    if (!isa<IntegerType, IndexType, FloatType>(type))
      return;
    poison.replaceAllUsesWith(
        arith::ConstantOp::create(b, poison.getLoc(), b.getZeroAttr(type))
            .getResult());
    poison.erase();
  });
  return success();
}

static void lowerSwitches(func::FuncOp function) {
  SmallVector<scf::IndexSwitchOp> ops;
  function.walk([&](scf::IndexSwitchOp op) { ops.push_back(op); });
  for (scf::IndexSwitchOp op : ops) {
    ImplicitLocOpBuilder b(op.getLoc(), op);
    SmallVector<Value> results;
    scf::IfOp first;
    auto takeRegion = [](Region &from, Region &to) {
      to.getBlocks().clear();
      to.takeBody(from);
    };
    OpBuilder::InsertionGuard guard(b);
    for (auto [value, region] : llvm::zip(op.getCases(), op.getCaseRegions())) {
      Value wanted = arith::ConstantIndexOp::create(b, value);
      Value isCase = arith::CmpIOp::create(b, arith::CmpIPredicate::eq,
                                           op.getArg(), wanted);
      auto branch = scf::IfOp::create(b, op.getResultTypes(), isCase,
                                      /*withElseRegion=*/true);
      takeRegion(region, branch.getThenRegion());
      if (first) {
        // The else region around this branch yields the results of the branch.
        b.setInsertionPointAfter(branch);
        scf::YieldOp::create(b, branch.getResults());
      } else {
        first = branch;
      }
      Block *other = branch.elseBlock();
      other->clear();
      b.setInsertionPointToEnd(other);
    }
    if (first) {
      // The default case of the scf.index_switch goes into the innermost else
      // region.
      Block *end = b.getInsertionBlock();
      end->getOperations().splice(end->end(),
                                  op.getDefaultBlock().getOperations());
      op->replaceAllUsesWith(first.getResults());
    } else {
      Block &block = op.getDefaultBlock();
      Operation *yield = block.getTerminator();
      op->replaceAllUsesWith(yield->getOperands());
      yield->erase();
      op->getBlock()->getOperations().splice(op->getIterator(),
                                             block.getOperations());
    }
    op.erase();
  }
}

//===----------------------------------------------------------------------===//
// Calls
//===----------------------------------------------------------------------===//

namespace {
class Inlining {
public:
  explicit Inlining(ModuleOp module) : symbols(module) {}

  LogicalResult run(func::FuncOp function) {
    SmallVector<func::CallOp> calls;
    do {
      calls.clear();
      function.walk([&](func::CallOp call) {
        if (!kept.contains(call))
          calls.push_back(call);
      });
      for (func::CallOp call : calls)
        if (failed(inlineCall(call)))
          return failure();
    } while (!calls.empty());
    return success();
  }

private:
  LogicalResult inlineCall(func::CallOp call) {
    auto callee = symbols.lookup<func::FuncOp>(call.getCallee());
    if (!callee || callee.isExternal()) {
      // A call without results that takes numbers alone, such as one that
      // prints, has no influence on derivatives.
      bool takesNumbers = llvm::all_of(call.getOperandTypes(), [](Type type) {
        return isa<IntegerType, IndexType, FloatType, VectorType>(type);
      });
      if (call.getNumResults() == 0 && takesNumbers)
        call.erase();
      else
        kept.insert(call);
      return success();
    }
    func::FuncOp body = callee.clone();
    OwningOpRef<func::FuncOp> owner(body);
    // Lifting blocks to structured control flow looks up symbols, so the
    // function must be in a module meanwhile.
    symbols.getOp()->getRegion(0).front().push_back(body);
    bool isLifted =
        succeeded(liftBlocks(body)) && succeeded(unrollRecursion(body));
    body->remove();
    if (!isLifted)
      return failure();
    OpBuilder b(call);
    IRMapping mapping;
    mapping.map(body.getArguments(), call.getOperands());
    for (Operation &op : body.getBody().front().without_terminator())
      b.clone(op, mapping)->walk([&](Operation *made) {
        made->setLoc(CallSiteLoc::get(made->getLoc(), call.getLoc()));
      });
    SmallVector<Value> results;
    for (Value value : body.getBody().front().getTerminator()->getOperands())
      results.push_back(mapping.lookupOrDefault(value));
    call.replaceAllUsesWith(results);
    call.erase();
    return success();
  }

  SymbolTable symbols;
  DenseSet<Operation *> kept;
};
} // namespace

/// Makes calls of constant functions direct.
static void callDirectly(func::FuncOp function) {
  SmallVector<func::CallIndirectOp> calls;
  function.walk([&](func::CallIndirectOp call) { calls.push_back(call); });
  for (func::CallIndirectOp call : calls) {
    auto callee = call.getCallee().getDefiningOp<func::ConstantOp>();
    if (!callee)
      continue;
    OpBuilder b(call);
    auto direct =
        func::CallOp::create(b, call.getLoc(), callee.getValueAttr(),
                             call.getResultTypes(), call.getCalleeOperands());
    call.replaceAllUsesWith(direct);
    call.erase();
  }
}

/// True if a function reaches itself by calls of other functions.
static bool callsItself(func::FuncOp function, SymbolTable &symbols) {
  DenseSet<Operation *> seen;
  SmallVector<func::FuncOp> pending = {function};
  bool found = false;
  while (!pending.empty() && !found)
    pending.pop_back_val().walk([&](func::CallOp call) {
      auto callee = symbols.lookup<func::FuncOp>(call.getCallee());
      found |= callee == function &&
               call->getParentOfType<func::FuncOp>() != function;
      if (callee && seen.insert(callee).second)
        pending.push_back(callee);
    });
  return found;
}

/// Refuses a call of a function that calls itself, or that has a derivative of
/// its own, which inlining would ignore.
static LogicalResult checkCalls(func::FuncOp function, SymbolTable &symbols) {
  llvm::SetVector<Operation *> reached;
  // For each reached function, the call in `function` that leads to it.
  DenseMap<Operation *, func::CallOp> reachedBy;
  reached.insert(function);
  for (size_t i = 0; i != reached.size(); ++i) {
    Operation *caller = reached[i];
    WalkResult result = caller->walk([&](func::CallOp call) {
      auto callee = symbols.lookup<func::FuncOp>(call.getCallee());
      if (!callee || callee.isExternal())
        return WalkResult::advance();
      func::CallOp first =
          caller == function.getOperation() ? call : reachedBy.lookup(caller);
      auto rule = callee->getAttrOfType<FlatSymbolRefAttr>("tai.adjoint");
      bool isMade = rule && callee->hasAttr("tai.differentiate") &&
                    rule.getValue() == (callee.getName() + "_grad").str();
      bool isRecursive = callsItself(callee, symbols);
      if (!isRecursive && (!rule || isMade)) {
        if (reached.insert(callee))
          reachedBy[callee] = first;
        return WalkResult::advance();
      }
      InFlightDiagnostic diag =
          first.emitError("cannot differentiate this call: '@")
          << callee.getName()
          << (isRecursive ? "' calls itself" : "' has a derivative of its own");
      Diagnostic &note = diag.attachNote(callee.getLoc());
      if (isRecursive)
        note << "by another function; write a loop, 'scf.for' or 'scf.while'";
      else
        note << "the derivative of a caller does not use " << rule
             << "; remove 'tai.adjoint' here, or call both functions where the "
                "gradient is put together";
      return WalkResult::interrupt();
    });
    if (result.wasInterrupted())
      return failure();
  }
  return success();
}

//===----------------------------------------------------------------------===//
// Tensors
//===----------------------------------------------------------------------===//

static MemRefType getBufferType(Type type) {
  if (auto tensor = dyn_cast<RankedTensorType>(type))
    return MemRefType::get(tensor.getShape(), tensor.getElementType());
  return MemRefType::get({}, type);
}

static bool hasFloats(Type type) {
  return isa<FloatType>(getElementTypeOrSelf(type)) &&
         isa<FloatType, RankedTensorType>(type);
}

/// Gives the prepared copy of a function memrefs in place of tensors, and an
/// additional memref for each result with floats; other results are dropped.
static LogicalResult passMemory(func::FuncOp function) {
  auto isArray = [](Type type) { return isa<BaseMemRefType>(type); };
  if (function->hasAttr("tai.gradients"))
    return function.emitError("a function of tensors is differentiated with "
                              "respect to all tensors of floats: leave out "
                              "'tai.gradients'");
  if (llvm::any_of(function.getArgumentTypes(), isArray))
    return function.emitError("cannot differentiate a function of tensors and "
                              "memrefs; use one of them");
  if (llvm::none_of(
          function.getArgumentTypes(),
          [](Type type) { return isTensor(type) && hasFloats(type); }) ||
      llvm::none_of(function.getResultTypes(), hasFloats))
    return function.emitError("there is nothing to differentiate: this "
                              "function takes or returns no tensor of floats");
  for (Type type : function.getResultTypes())
    if (auto tensor = dyn_cast<TensorType>(type); tensor && !tensor.hasRank())
      return function.emitError("cannot differentiate a function that returns ")
             << type << "; expects tensors with a rank";
  ImplicitLocOpBuilder b(function.getLoc(), function.getContext());
  Block &block = function.getBody().front();
  for (BlockArgument argument : block.getArguments()) {
    if (!isTensor(argument.getType()))
      continue;
    auto type = dyn_cast<RankedTensorType>(argument.getType());
    if (!type)
      return function.emitError("cannot differentiate a function of a tensor "
                                "whose rank is not known");
    argument.setType(getBufferType(type));
    b.setInsertionPointToStart(&block);
    auto tensor = bufferization::ToTensorOp::create(b, type, argument,
                                                    /*restrict=*/true);
    argument.replaceAllUsesExcept(tensor.getResult(), tensor);
  }
  Operation *end = block.getTerminator();
  b.setInsertionPoint(end);
  for (Value result : end->getOperands()) {
    if (!hasFloats(result.getType()))
      continue;
    Value out =
        block.addArgument(getBufferType(result.getType()), function.getLoc());
    if (!isTensor(result.getType())) {
      memref::StoreOp::create(b, result, out, ValueRange());
      continue;
    }
    auto store =
        bufferization::MaterializeInDestinationOp::create(b, result, out);
    store.setRestrict(true);
    store.setWritable(true);
  }
  end->setOperands({});
  function.setType(b.getFunctionType(block.getArgumentTypes(), {}));
  function.setAllArgAttrs(SmallVector<DictionaryAttr>(block.getNumArguments(),
                                                      b.getDictionaryAttr({})));
  function.setAllResultAttrs(ArrayRef<DictionaryAttr>());
  return success();
}

static LogicalResult bufferize(func::FuncOp function) {
  bufferization::OneShotBufferizationOptions options;
  options.allowUnknownOps = true;
  options.allowReturnAllocsFromLoops = true;
  options.setFunctionBoundaryTypeConversion(
      bufferization::LayoutMapOption::IdentityLayoutMap);
  bufferization::BufferizationState state;
  return bufferization::runOneShotBufferize(function, options, state);
}

//===----------------------------------------------------------------------===//
// Wrappers
//===----------------------------------------------------------------------===//

namespace {
/// Builds a function of values around a derivative that takes and returns
/// memrefs.
class Wrapper {
public:
  Wrapper(func::FuncOp original, func::FuncOp inner)
      : original(original), inner(inner),
        b(inner.getLoc(), inner.getContext()) {}

  func::FuncOp create(bool isForward);

private:
  Value createBuffer(Type type, Value like);
  Value createFilled(Value value);
  Value createZeros(Type type, Value like);
  Value take(Type type, Value buffer);
  void release(Value buffer) { released.push_back(buffer); }

  func::FuncOp original, inner;
  ImplicitLocOpBuilder b;
  SmallVector<Value> released;
};
} // namespace

/// Allocates a buffer for a value of tensor or scalar type; dynamic sizes are
/// taken from `like`.
Value Wrapper::createBuffer(Type type, Value like) {
  MemRefType buffer = getBufferType(type);
  SmallVector<Value> sizes;
  for (int64_t i = 0; i != buffer.getRank(); ++i)
    if (buffer.isDynamicDim(i))
      sizes.push_back(tensor::DimOp::create(b, like, i));
  return memref::AllocOp::create(b, buffer, sizes);
}

Value Wrapper::createFilled(Value value) {
  Value buffer = createBuffer(value.getType(), value);
  if (!isTensor(value.getType())) {
    memref::StoreOp::create(b, value, buffer, ValueRange());
    return buffer;
  }
  Value source = bufferization::ToBufferOp::create(
      b, getBufferType(value.getType()), value, /*read_only=*/true);
  memref::CopyOp::create(b, source, buffer);
  return buffer;
}

Value Wrapper::createZeros(Type type, Value like) {
  Value buffer = createBuffer(type, like);
  auto memory = cast<MemRefType>(buffer.getType());
  Value zero =
      arith::ConstantOp::create(b, b.getZeroAttr(memory.getElementType()));
  Value begin = arith::ConstantIndexOp::create(b, 0);
  Value step = arith::ConstantIndexOp::create(b, 1);
  SmallVector<Value> sizes;
  for (int64_t i = 0; i != memory.getRank(); ++i)
    sizes.push_back(b.createOrFold<memref::DimOp>(buffer, i));
  SmallVector<Value> lower(sizes.size(), begin), steps(sizes.size(), step);
  scf::buildLoopNest(b, b.getLoc(), lower, sizes, steps,
                     [&](OpBuilder &nested, Location loc, ValueRange ivs) {
                       memref::StoreOp::create(nested, loc, zero, buffer, ivs);
                     });
  return buffer;
}

Value Wrapper::take(Type type, Value buffer) {
  if (isTensor(type))
    return bufferization::ToTensorOp::create(b, type, buffer,
                                             /*restrict=*/true,
                                             /*writable=*/true);
  Value value = memref::LoadOp::create(b, buffer, ValueRange());
  release(buffer);
  return value;
}

func::FuncOp Wrapper::create(bool isForward) {
  SmallVector<Type> inputs(original.getArgumentTypes()), results;
  SmallVector<Type> active, made;
  for (Type type : original.getArgumentTypes())
    if (isTensor(type) && hasFloats(type))
      active.push_back(type);
  for (Type type : original.getResultTypes())
    if (hasFloats(type))
      made.push_back(type);
  size_t count = inputs.size();
  llvm::append_range(inputs, isForward ? active : made);
  if (isForward) {
    llvm::append_range(results, made);
    llvm::append_range(results, made);
  } else {
    results = active;
  }
  b.setInsertionPoint(inner);
  auto wrapper = func::FuncOp::create(b, inner.getName(),
                                      b.getFunctionType(inputs, results));
  Block *block = wrapper.addEntryBlock();
  b.setInsertionPointToStart(block);

  // Collects the arguments of the call of `inner`, in its order: arguments of
  // the original function, memory for results, then derivatives of both.
  SmallVector<Value> given, shadows;
  auto extra = block->getArguments().drop_front(count).begin();
  auto values = block->getArguments().take_front(count);
  for (BlockArgument value : values) {
    bool isArray = isTensor(value.getType());
    given.push_back(isArray ? Value(bufferization::ToBufferOp::create(
                                  b, getBufferType(value.getType()), value,
                                  /*read_only=*/true))
                            : Value(value));
    if (!isArray || !hasFloats(value.getType())) {
      // For a memref among the original arguments, the caller passes a shadow
      // (memref of derivatives), which stays among the last arguments.
      continue;
    }
    shadows.push_back(isForward ? createFilled(*extra++)
                                : createZeros(value.getType(), value));
  }
  SmallVector<Value> outs, outShadows;
  for (Type type : made) {
    // The sizes of a result's buffer: in reverse mode, the sizes of the adjoint
    // that the caller passes; in forward mode, sizes must be static.
    Value like = isForward ? Value() : Value(*extra);
    outs.push_back(createBuffer(type, like));
    outShadows.push_back(isForward ? createZeros(type, like)
                                   : createFilled(*extra++));
  }
  llvm::append_range(given, outs);
  llvm::append_range(given, shadows);
  llvm::append_range(given, outShadows);
  IRMapping mapping;
  mapping.map(inner.getArguments(), given);
  for (Operation &op : inner.getBody().front().without_terminator())
    b.clone(op, mapping);
  SmallVector<Value> returned;
  if (isForward) {
    for (auto [type, out] : llvm::zip(made, outs))
      returned.push_back(take(type, out));
    for (auto [type, out] : llvm::zip(made, outShadows))
      returned.push_back(take(type, out));
    llvm::append_range(released, shadows);
  } else {
    for (auto [type, shadow] : llvm::zip(active, shadows))
      returned.push_back(take(type, shadow));
    llvm::append_range(released, outs);
    llvm::append_range(released, outShadows);
  }
  for (Value buffer : released)
    memref::DeallocOp::create(b, buffer);
  func::ReturnOp::create(b, returned);
  return wrapper;
}

void mlir::tai::takeInterface(func::FuncOp original, func::FuncOp derivative) {
  derivative.setVisibility(original.getVisibility());
  constexpr StringLiteral name = "llvm.emit_c_interface";
  if (Attribute attr = original->getAttr(name))
    derivative->setAttr(name, attr);
}

func::FuncOp mlir::tai::wrapDerivative(func::FuncOp original,
                                       func::FuncOp derivative,
                                       bool isForward) {
  func::FuncOp wrapper = Wrapper(original, derivative).create(isForward);
  for (NamedAttribute attr : derivative->getDiscardableAttrs())
    wrapper->setAttr(attr.getName(), attr.getValue());
  wrapper->removeAttr("tai.reads_before");
  derivative.erase();
  return wrapper;
}

//===----------------------------------------------------------------------===//
// The pass
//===----------------------------------------------------------------------===//

/// Decomposes ops that stand for several ops, such as a softmax.
static LogicalResult decomposeOps(func::FuncOp function) {
  SmallVector<linalg::AggregatedOpInterface> ops;
  function.walk([&](linalg::AggregatedOpInterface op) {
    if (op->getNumResults() != 0 &&
        llvm::all_of(op->getResultTypes(), isTensor))
      ops.push_back(op);
  });
  for (linalg::AggregatedOpInterface op : ops) {
    OpBuilder b(op);
    FailureOr<SmallVector<Value>> made = op.decomposeOperation(b);
    if (failed(made))
      return op->emitError("cannot differentiate this form of '")
             << op->getName() << "'";
    op->replaceAllUsesWith(*made);
    op->erase();
  }
  return success();
}

namespace {
struct PrepareForeign : tai::impl::PrepareForeignBase<PrepareForeign> {
  using Base::Base;

  static void addLowering(OpPassManager &pm) {
    pm.addPass(createConvertLinalgToLoopsPass());
    pm.addPass(createForallToParallelLoopPass());
    pm.addPass(createLowerAffinePass());
  }
  static void addCleaning(OpPassManager &pm) {
    pm.addPass(createCanonicalizerPass());
    pm.addPass(createCSEPass());
  }

  void getDependentDialects(DialectRegistry &registry) const override {
    Base::getDependentDialects(registry);
    registry
        .insert<affine::AffineDialect, arith::ArithDialect,
                bufferization::BufferizationDialect, cf::ControlFlowDialect,
                complex::ComplexDialect, func::FuncDialect,
                linalg::LinalgDialect, LLVM::LLVMDialect, math::MathDialect,
                memref::MemRefDialect, scf::SCFDialect, tensor::TensorDialect,
                ub::UBDialect, vector::VectorDialect>();
    arith::registerBufferizableOpInterfaceExternalModels(registry);
    bufferization::func_ext::registerBufferizableOpInterfaceExternalModels(
        registry);
    cf::registerBufferizableOpInterfaceExternalModels(registry);
    linalg::registerBufferizableOpInterfaceExternalModels(registry);
    scf::registerBufferizableOpInterfaceExternalModels(registry);
    tensor::registerBufferizableOpInterfaceExternalModels(registry);
    tensor::registerInferTypeOpInterfaceExternalModels(registry);
    vector::registerBufferizableOpInterfaceExternalModels(registry);
  }

  void runOnOperation() override {
    SmallVector<func::FuncOp> functions;
    SymbolTable symbols(getOperation());
    bool isGood = true;
    for (auto function : getOperation().getOps<func::FuncOp>()) {
      bool isNamed = llvm::is_contained(kernels, function.getName());
      if (function.isExternal() ||
          !(kernels.empty() ? function->hasAttr("tai.differentiate")
                            : isNamed) ||
          ((function->hasAttr("tai.adjoint") || isSplit(function)) &&
           function->hasAttr("tai.tangent")) ||
          function->hasAttr(kPreparedFor) || !needsPreparation(function))
        continue;
      if (succeeded(checkCalls(function, symbols)))
        functions.push_back(function);
      else
        isGood = false;
    }
    for (func::FuncOp function : functions)
      isGood &= succeeded(prepare(function));
    if (!isGood)
      signalPassFailure();
  }

  LogicalResult prepare(func::FuncOp function) {
    func::FuncOp copy = function.clone();
    copy.setName((function.getName() + "_prepared").str());
    for (StringRef name : {"tai.adjoint", "tai.tangent", "tai.split",
                           "llvm.emit_c_interface", "sym_visibility"})
      copy->removeAttr(name);
    copy->setAttr("tai.differentiate", UnitAttr::get(&getContext()));
    copy->setAttr(kPreparedFor, FlatSymbolRefAttr::get(function));
    SymbolTable(getOperation())
        .insert(copy, std::next(function->getIterator()));
    if (succeeded(lower(copy)))
      return success();
    copy.erase();
    return failure();
  }

  /// Memory of the LLVM dialect becomes SSA values, and its arithmetic ops
  /// become ops of arith and math.
  LogicalResult promoteSlots(func::FuncOp copy) {
    WalkResult found = copy.walk([](Operation *op) {
      return isa_and_present<LLVM::LLVMDialect>(op->getDialect())
                 ? WalkResult::interrupt()
                 : WalkResult::advance();
    });
    if (!found.wasInterrupted())
      return success();
    OpPassManager promotion(func::FuncOp::getOperationName());
    promotion.addPass(createSROA());
    promotion.addPass(createMem2Reg());
    if (failed(runPipeline(promotion, copy)))
      return failure();
    liftArithmetic(copy);
    return success();
  }

  LogicalResult lower(func::FuncOp copy) {
    callDirectly(copy);
    SymbolTable symbols(getOperation());
    if (failed(checkCalls(copy, symbols)) || failed(liftBlocks(copy)) ||
        failed(Inlining(getOperation()).run(copy)))
      return failure();
    copy.walk([](Operation *op) {
      if (isa<vector::PrintOp, cf::AssertOp, memref::PrefetchOp>(op))
        op->erase();
    });
    bool hasTensors = llvm::any_of(copy.getArgumentTypes(), isTensor) ||
                      llvm::any_of(copy.getResultTypes(), isTensor);
    if (hasTensors && failed(passMemory(copy)))
      return failure();
    copy.walk([&](Operation *op) {
      hasTensors |= llvm::any_of(op->getResultTypes(), isTensor);
    });
    if (failed(decomposeOps(copy)) || (hasTensors && failed(bufferize(copy))))
      return failure();
    if (hasComplexArrays(copy)) {
      // Accesses of such arrays are split below, and so must be loads and
      // stores.
      OpPassManager early(func::FuncOp::getOperationName());
      addLowering(early);
      if (failed(runPipeline(early, copy)))
        return failure();
    }
    if (failed(splitComplex(copy)) || failed(promoteSlots(copy)))
      return failure();
    lowerLoops(copy);
    OpPassManager lowering(func::FuncOp::getOperationName());
    addLowering(lowering);
    if (failed(runPipeline(lowering, copy)))
      return failure();
    lowerSwitches(copy);
    if (failed(lowerVectors(copy)))
      return failure();
    keepMadeArrays(copy, hasTensors);
    OpPassManager cleaning(func::FuncOp::getOperationName());
    addCleaning(cleaning);
    if (failed(runPipeline(cleaning, copy)) || failed(normalizeMemory(copy)))
      return failure();
    OpPassManager again(func::FuncOp::getOperationName());
    addCleaning(again);
    return runPipeline(again, copy);
  }
};
} // namespace
