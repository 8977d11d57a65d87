//===- DerivativePaths.cpp - Paths of derivatives -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Two worklists over values of all types: forward from inputs with a
// derivative, backward from outputs. Values in both sets are on a path. Local
// variables and local arrays are treated as values: every value stored to one
// of these reaches every value loaded from it.
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/DerivativePaths.h"
#include "mlir/Dialect/LLVMIR/LLVMDialect.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/Interfaces/CallInterfaces.h"
#include "mlir/Interfaces/ControlFlowInterfaces.h"
#include "mlir/Interfaces/SideEffectInterfaces.h"
#include "mlir/Interfaces/ViewLikeInterface.h"
#include "tai/Analysis/Activity.h"
#include "tai/Analysis/HelpfulPasses.h"
#include "tai/Dialect/Tai/IR/Tai.h"
#include "tai/Dialect/TaiRT/IR/TaiRT.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/StringSet.h"

using namespace mlir;
using namespace mlir::tai;

bool mlir::tai::isDiscrete(Operation *op) {
  // Ops are listed by name, because most of their dialects need not be loaded.
  static const llvm::StringSet<> names = {
      "arith.cmpi",
      "arith.cmpf",
      "arith.fptosi",
      "arith.fptoui",
      "complex.eq",
      "complex.neq",
      "index.cmp",
      "linalg.index",
      "llvm.fcmp",
      "llvm.fptosi",
      "llvm.fptoui",
      "llvm.icmp",
      "llvm.intr.is.fpclass",
      "llvm.intr.fptosi.sat",
      "llvm.intr.fptoui.sat",
      "llvm.intr.llrint",
      "llvm.intr.llround",
      "llvm.intr.lrint",
      "llvm.intr.lround",
      "math.isfinite",
      "math.isinf",
      "math.isnan",
      "math.isnormal",
      "memref.dim",
      "memref.rank",
      "tensor.dim",
      "tensor.rank",
      "vector.create_mask",
  };
  return names.contains(op->getName().getStringRef());
}

bool mlir::tai::carriesDerivative(OpOperand &operand) {
  if (auto op = dyn_cast<DifferentiableOpInterface>(operand.getOwner()))
    return op.carriesDerivative(operand);
  return !isDiscrete(operand.getOwner());
}

/// True if a value of this type may contain floats in a form other than bits.
static bool mayHoldFloats(Type type) {
  if (isa<FloatType>(type))
    return true;
  if (auto complex = dyn_cast<ComplexType>(type))
    return mayHoldFloats(complex.getElementType());
  if (isa<VectorType, TensorType>(type))
    return mayHoldFloats(getElementTypeOrSelf(type));
  if (auto structure = dyn_cast<LLVM::LLVMStructType>(type))
    return llvm::any_of(structure.getBody(), mayHoldFloats);
  if (auto array = dyn_cast<LLVM::LLVMArrayType>(type))
    return mayHoldFloats(array.getElementType());
  return isa<TupleType>(type);
}

/// True if the type can hold the bits of a float.
static bool mayHoldBits(Type type) {
  Type element = getElementTypeOrSelf(type);
  return isa<IntegerType>(element) && element.getIntOrFloatBitWidth() >= 16;
}

static bool isMemory(Type type) {
  return isa<BaseMemRefType, LLVM::LLVMPointerType>(type);
}

/// True if it is known that memory at `value` contains no float with a
/// derivative other than values stored in this function. Arguments for which no
/// derivative is requested count as constants.
static bool isUnderstood(Value value, FunctionOpInterface function) {
  while (Operation *op = value.getDefiningOp()) {
    if (isa<memref::AllocOp, memref::AllocaOp, memref::GetGlobalOp,
            LLVM::AllocaOp>(op))
      return true;
    if (auto address = dyn_cast<LLVM::AddressOfOp>(op)) {
      auto global = SymbolTable::lookupNearestSymbolFrom<LLVM::GlobalOp>(
          op, address.getGlobalNameAttr());
      return global && global.getConstant();
    }
    if (auto view = dyn_cast<ViewLikeOpInterface>(op))
      value = view.getViewSource();
    else if (isa<LLVM::GEPOp, LLVM::AddrSpaceCastOp, LLVM::BitcastOp>(op))
      value = op->getOperand(0);
    else
      return false;
  }
  auto argument = cast<BlockArgument>(value);
  return argument.getOwner()->getParentOp() == function &&
         isa<MemRefType>(value.getType());
}

/// True for ops that only forward their operands to their results.
static bool isMove(Operation *op) {
  // Ops are listed by name, because most of their dialects need not be loaded.
  static const llvm::StringSet<> names = {
      "arith.select",
      "builtin.unrealized_conversion_cast",
      "llvm.extractelement",
      "llvm.extractvalue",
      "llvm.freeze",
      "llvm.insertelement",
      "llvm.insertvalue",
      "llvm.select",
      "llvm.shufflevector",
      "tensor.cast",
      "tensor.extract",
      "tensor.extract_slice",
      "tensor.from_elements",
      "tensor.insert",
      "tensor.insert_slice",
      "tensor.reshape",
      "tensor.splat",
      "ub.freeze",
      "vector.broadcast",
      "vector.deinterleave",
      "vector.extract",
      "vector.extract_strided_slice",
      "vector.from_elements",
      "vector.insert",
      "vector.insert_strided_slice",
      "vector.interleave",
      "vector.scalable.extract",
      "vector.scalable.insert",
      "vector.shape_cast",
      "vector.shuffle",
      "vector.to_elements",
      "vector.transpose",
  };
  return names.contains(op->getName().getStringRef());
}

/// True if the op reinterprets the bits of its operand as another type.
static bool isBitcast(Operation *op) {
  static const llvm::StringSet<> names = {
      "arith.bitcast",
      "llvm.bitcast",
      "tensor.bitcast",
      "vector.bitcast",
  };
  return names.contains(op->getName().getStringRef());
}

namespace {
class Paths {
public:
  Paths(FunctionOpInterface function, const DerivativeEnds &ends,
        function_ref<InFlightDiagnostic(Operation *, const Twine &)> emitError)
      : function(function), ends(ends), emitError(emitError) {}

  LogicalResult verify();

private:
  void collect();
  void collectAccess(DifferentiableAccessInterface access);
  void collectForeignAccess(FieldAccessOpInterface access);
  void collectRead(Operation *op);
  void addEdges(OperandRange operands, ValueRange inputs);
  void addEdge(OpOperand &use, Value target) {
    targets[&use].push_back(target);
    sources[target].push_back(use.get());
  }
  void findVaried(llvm::DenseSet<Value> &found, bool stopsAtRefused);
  void findUseful();
  bool isOnPath(Operation *op);
  LogicalResult refuse(Operation *op);
  LogicalResult checkStores();

  void markUseful(Value value) {
    if (useful.insert(value).second)
      worklist.push_back(value);
  }

  FunctionOpInterface function;
  const DerivativeEnds &ends;
  function_ref<InFlightDiagnostic(Operation *, const Twine &)> emitError;

  /// For operands and values: the values to which a value goes, or from which
  /// it comes, along branches, loops, local variables and local arrays.
  DenseMap<OpOperand *, SmallVector<Value, 2>> targets;
  DenseMap<Value, SmallVector<Value, 2>> sources;
  SmallVector<Value> starts, wanted, bits;
  /// Ops through which floats may enter unnoticed: reads of memory that this
  /// analysis does not follow, and casts of loaded bits to floats.
  llvm::SetVector<Operation *> opaque;
  SmallVector<DifferentiableAccessInterface> writes;

  llvm::DenseSet<Value> varied, useful;
  SmallVector<Value> worklist;
};
} // namespace

void Paths::addEdges(OperandRange operands, ValueRange inputs) {
  if (operands.empty())
    return;
  OpOperand *first = operands.getBase();
  for (auto [use, input] :
       llvm::zip(MutableArrayRef<OpOperand>(first, operands.size()), inputs))
    addEdge(use, input);
}

/// Returns the operand of `op` that is `value`.
static OpOperand *findOperand(Operation *op, Value value) {
  for (OpOperand &operand : op->getOpOperands())
    if (operand.get() == value)
      return &operand;
  return nullptr;
}

void Paths::collectAccess(DifferentiableAccessInterface access) {
  Storage storage = access.getAccessedStorage();
  Value value = access.getAccessedValue();
  bool isRead = access.getAccessKind() == AccessKind::Read;
  bool isLocal =
      storage.memref && isa_and_present<memref::AllocOp, memref::AllocaOp>(
                            storage.memref.getDefiningOp());
  if (isLocal) {
    if (!isRead)
      if (OpOperand *operand = findOperand(access, value))
        addEdge(*operand, storage.memref);
    for (Value result : access->getResults())
      if (OpOperand *operand = findOperand(access, storage.memref))
        addEdge(*operand, result);
    return;
  }
  if (!isRead)
    writes.push_back(access);
  if (isFloatOrVector(value.getType()) && !isScalableVector(value.getType())) {
    if (ends.hasDerivative(storage)) {
      if (!isRead)
        wanted.push_back(value);
      llvm::append_range(starts, access->getResults());
    } else if (storage.memref && !isUnderstood(storage.memref, function)) {
      opaque.insert(access);
    }
    return;
  }
  if (mayHoldFloats(value.getType()))
    opaque.insert(access);
  else if (mayHoldBits(value.getType()))
    llvm::append_range(bits, access->getResults());
}

/// Collects an access to a field by an op without a derivative rule.
void Paths::collectForeignAccess(FieldAccessOpInterface access) {
  if (!access.isElementAccess() ||
      !ends.hasDerivative(Storage(access.getFieldAttr())))
    return;
  opaque.insert(access);
  if (access.writesField())
    wanted.push_back(access.getAccessedValue());
}

/// Collects reads of memory by an op without a derivative rule.
void Paths::collectRead(Operation *op) {
  if (op->getNumRegions() != 0 || isa<DifferentiableOpInterface>(op) ||
      isa<CallOpInterface>(op) ||
      isa_and_present<TaiDialect>(op->getDialect()) ||
      llvm::none_of(op->getResultTypes(), [](Type type) {
        return mayHoldFloats(type) || mayHoldBits(type);
      }))
    return;
  auto effects = dyn_cast<MemoryEffectOpInterface>(op);
  if (isMemoryEffectFree(op) ||
      (effects && !effects.hasEffect<MemoryEffects::Read>()))
    return;
  bool reads = llvm::any_of(op->getOperands(), [&](Value operand) {
    return isMemory(operand.getType()) && !isUnderstood(operand, function) &&
           !ends.hasDerivative(Storage(operand));
  });
  if (!reads)
    return;
  if (llvm::any_of(op->getResultTypes(), mayHoldFloats))
    opaque.insert(op);
  else
    llvm::append_range(bits, op->getResults());
}

void Paths::collect() {
  llvm::append_range(starts, ends.inputs);
  llvm::append_range(wanted, ends.outputs);
  function.walk([&](Operation *op) {
    if (auto access = dyn_cast<DifferentiableAccessInterface>(op))
      return collectAccess(access);
    if (auto access = dyn_cast<FieldAccessOpInterface>(op))
      return collectForeignAccess(access);
    if (isa<LocalStoreOp, StackPushOp>(op))
      return addEdge(op->getOpOperand(0), op->getOperand(1));
    if (isa<LocalLoadOp, StackPopOp>(op))
      return addEdge(op->getOpOperand(0), op->getResult(0));
    if (auto branch = dyn_cast<RegionBranchOpInterface>(op))
      return forEachForwarding(branch,
                               [&](OperandRange operands, ValueRange inputs) {
                                 addEdges(operands, inputs);
                               });
    collectRead(op);
  });
  // The bits loaded from memory are followed: if they are only moved and then
  // cast to a float, the cast is where the float is read.
  llvm::DenseSet<Value> seen(bits.begin(), bits.end());
  while (!bits.empty()) {
    Value value = bits.pop_back_val();
    for (OpOperand &use : value.getUses()) {
      Operation *user = use.getOwner();
      SmallVector<Value> next;
      if (auto it = targets.find(&use); it != targets.end())
        next.append(it->second.begin(), it->second.end());
      else if (isBitcast(user) && mayHoldFloats(user->getResult(0).getType()))
        opaque.insert(user);
      else if (isMove(user) || isBitcast(user))
        llvm::append_range(next, user->getResults());
      for (Value result : next)
        if (seen.insert(result).second)
          bits.push_back(result);
    }
  }
}

/// Finds the values that depend on an input with a derivative. With
/// `stopsAtRefused`, dependences through ops without a rule do not count.
void Paths::findVaried(llvm::DenseSet<Value> &found, bool stopsAtRefused) {
  auto markVaried = [&](Value value) {
    if (found.insert(value).second)
      worklist.push_back(value);
  };
  llvm::for_each(starts, [&](Value value) { markVaried(value); });
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    for (OpOperand &use : value.getUses()) {
      Operation *user = use.getOwner();
      if (auto it = targets.find(&use); it != targets.end()) {
        for (Value target : it->second)
          markVaried(target);
        continue;
      }
      bool isEnd = user->hasTrait<OpTrait::IsTerminator>();
      if (isa<DifferentiableAccessInterface>(user) ||
          (isEnd && user->getParentOp() == function))
        continue;
      // An operand that is not forwarded is a condition or a bound, unless the
      // op does not describe its control flow.
      Operation *op = isEnd ? user->getParentOp() : user;
      if (stopsAtRefused && isOnPath(op))
        continue;
      if (!isEnd && user->getNumRegions() == 0) {
        if (carriesDerivative(use))
          for (Value result : user->getResults())
            markVaried(result);
        continue;
      }
      bool isSaid = isa<RegionBranchOpInterface>(op) &&
                    (!isEnd || isa<RegionBranchTerminatorOpInterface>(user));
      if (isFloatOrVector(value.getType()) || !isSaid)
        for (Value result : op->getResults())
          markVaried(result);
    }
  }
}

void Paths::findUseful() {
  llvm::for_each(wanted, [&](Value value) { markUseful(value); });
  while (!worklist.empty()) {
    Value value = worklist.pop_back_val();
    if (auto it = sources.find(value); it != sources.end()) {
      for (Value source : it->second)
        markUseful(source);
      continue;
    }
    Operation *op = value.getDefiningOp();
    if (!op || isa<DifferentiableAccessInterface>(op))
      continue;
    if (op->getNumRegions() != 0) {
      // If `op` describes its control flow, its operands that are no floats are
      // conditions and bounds, through which no derivative passes.
      bool isKnown = isa<RegionBranchOpInterface>(op);
      auto mark = [&](Operation *user) {
        for (Value operand : user->getOperands())
          if (!isKnown || isFloatOrVector(operand.getType()))
            markUseful(operand);
      };
      mark(op);
      for (Region &region : op->getRegions())
        for (Block &block : region)
          if (!block.empty())
            mark(&block.back());
      continue;
    }
    for (OpOperand &operand : op->getOpOperands())
      if (carriesDerivative(operand))
        markUseful(operand.get());
  }
}

/// True if a derivative would have to pass through an op without a rule.
/// Scalable vectors have no rules: their number of components is unknown.
bool Paths::isOnPath(Operation *op) {
  auto isPassedOn = [&](Value result) {
    return varied.contains(result) && useful.contains(result);
  };
  if (llvm::any_of(op->getResults(), [&](Value result) {
        return isScalableVector(result.getType()) && isPassedOn(result);
      }))
    return true;
  if (isa<DifferentiableOpInterface, DifferentiableAccessInterface,
          AdjointLoopInterface, RegionBranchOpInterface, CallOpInterface,
          LocalLoadOp, LocalStoreOp, StackPopOp, StackPushOp>(op) ||
      op->hasTrait<OpTrait::IsTerminator>() || op->getNumResults() == 0)
    return false;
  // An op that creates a local array stands for the contents of the array. It
  // only forwards these, and needs no rule.
  bool isMade = op->getNumOperands() == 0 && op->getNumRegions() == 0;
  if (isMade || isMemory(op->getResultTypes().front()))
    return false;
  return llvm::any_of(op->getResults(), isPassedOn);
}

LogicalResult Paths::refuse(Operation *op) {
  StringRef mode = ends.isForward ? "tangent" : "gradient";
  StringRef rule = ends.isForward ? "tangent" : "derivative";
  bool isScalable = llvm::any_of(op->getResultTypes(), isScalableVector);
  InFlightDiagnostic diag =
      emitError(op, "'" + op->getName().getStringRef() + "' has no " + rule +
                        " rule" + (isScalable ? " for scalable vectors" : "") +
                        ", but a " + mode + " passes through it");
  if (!isScalable && attachHelpfulPass(diag, op))
    return failure();
  diag.attachNote()
      << (isScalable ? "use vectors of a fixed length, " : "")
      << "compute the value from differentiable ops, or keep it out of what "
         "the "
      << (ends.isForward ? "derivative" : "gradient") << " is taken of";
  return failure();
}

/// Refuses stores of values with a derivative under a type that has none.
LogicalResult Paths::checkStores() {
  LogicalResult result = success();
  auto report = [&](Operation *op, Type type) {
    result = failure();
    InFlightDiagnostic diag =
        emitError(op, "a derivative is lost: what has one is stored as ")
        << type << ", which has none";
    if (attachHelpfulPass(diag, op))
      return;
    diag.attachNote()
        << "store it to a field or an array of floats, or make it a constant "
           "by 'tai.stop_gradient' first (in Python, 'ti.stop_grad')";
  };
  for (DifferentiableAccessInterface write : writes) {
    Type type = write.getAccessedValue().getType();
    if (!varied.contains(write.getAccessedValue()))
      continue;
    if (!isFloatOrVector(type) || isScalableVector(type)) {
      report(write, type);
      continue;
    }
    // It is unknown which array a loop carries; stores to other arrays are
    // checked elsewhere.
    Storage storage = write.getAccessedStorage();
    auto argument = dyn_cast_if_present<BlockArgument>(storage.memref);
    if (!argument || argument.getOwner()->getParentOp() == function ||
        ends.hasDerivative(storage))
      continue;
    emitError(write, "a derivative is lost in an array that is not followed")
            .attachNote(argument.getLoc())
        << "access an argument of the function by its own name";
    result = failure();
  }
  if (!ends.isForward)
    return result;
  // In reverse mode, all ops with side effects are checked elsewhere.
  function.walk([&](Operation *op) {
    if (isa<DifferentiableAccessInterface, DifferentiableOpInterface, PrintOp,
            AssertOp, LocalStoreOp, StackPushOp, CallOpInterface>(op) ||
        op->getNumRegions() != 0 || isMemoryEffectFree(op))
      return;
    for (Value operand : op->getOperands())
      if (varied.contains(operand) && !isFloatOrVector(operand.getType()) &&
          !isMemory(operand.getType()) &&
          !isa<LocalType, StackType>(operand.getType()))
        return report(op, operand.getType());
  });
  return result;
}

LogicalResult Paths::verify() {
  // After the pass tai-lower-layout, an address does not tell which field it
  // belongs to.
  WalkResult lowered = function->walk([&](TreeBaseOp op) {
    emitError(op, "cannot differentiate accesses that are lowered already")
            .attachNote(function.getLoc())
        << "run 'tai-make-adjoint' and 'tai-forward-diff' before "
           "'tai-lower-layout'";
    return WalkResult::interrupt();
  });
  if (lowered.wasInterrupted())
    return failure();
  collect();
  findVaried(varied, /*stopsAtRefused=*/false);
  findUseful();
  LogicalResult result = success();
  for (Operation *op : opaque) {
    if (auto access = dyn_cast<FieldAccessOpInterface>(op);
        access && access.writesField() &&
        varied.contains(access.getAccessedValue())) {
      result = refuse(op);
      continue;
    }
    if (llvm::none_of(op->getResults(),
                      [&](Value value) { return useful.contains(value); }))
      continue;
    result = failure();
    emitError(op, "'" + op->getName().getStringRef() +
                      "' reads floats from memory that derivatives are not "
                      "followed through")
            .attachNote()
        << "load it from a field or from an argument that is a memref of "
           "floats, or make it a constant by 'tai.stop_gradient' (in Python, "
           "'ti.stop_grad')";
  }
  // Only the first op without a rule on each path is reported.
  llvm::DenseSet<Value> reached;
  findVaried(reached, /*stopsAtRefused=*/true);
  function.walk<WalkOrder::PreOrder>([&](Operation *op) {
    if (op == function || !isOnPath(op) || opaque.contains(op))
      return;
    bool isFirst =
        op->getNumRegions() != 0 ||
        llvm::any_of(op->getOpOperands(), [&](OpOperand &operand) {
          return reached.contains(operand.get()) && carriesDerivative(operand);
        });
    if (isFirst)
      result = refuse(op);
  });
  if (failed(checkStores()))
    result = failure();
  return result;
}

LogicalResult mlir::tai::verifyDerivativePaths(
    FunctionOpInterface function, const DerivativeEnds &ends,
    function_ref<InFlightDiagnostic(Operation *, const Twine &)> emitError) {
  return Paths(function, ends, emitError).verify();
}
