//===- SavedProgram.cpp - A recorded tape as a module ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Modules/SavedProgram.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Dialect/Vector/IR/VectorOps.h"
#include "mlir/IR/Verifier.h"
#include "tai/Runtime/Tape/Tape.h"
#include "llvm/ADT/StringExtras.h"

using namespace mlir;
using namespace mlir::tai;

LogicalResult mlir::tai::checkSaved(ModuleOp module) {
  Attribute saved = module->getAttr(kSaved);
  if (!saved)
    return success();
  auto dictionary = dyn_cast<DictionaryAttr>(saved);
  auto version =
      dictionary ? dictionary.getAs<IntegerAttr>("version") : IntegerAttr();
  if (version && version.getType().isInteger(64) &&
      version.getInt() == kSavedVersion)
    return success();
  InFlightDiagnostic diag = module.emitError("this saved program is of ");
  if (version)
    diag << "version " << llvm::toString(version.getValue(), 10, true);
  else
    diag << "no version";
  return diag << ", and this tai reads version " << kSavedVersion
              << "; save it again";
}

namespace {
class Saver {
public:
  Saver(Session &session, const runtime::Tape &tape)
      : session(session), tape(tape), builder(session.getContext()),
        loc(builder.getUnknownLoc()), module(ModuleOp::create(loc)),
        symbols(*module) {}

  FailureOr<OwningOpRef<ModuleOp>> save(const runtime::Field &loss,
                                        ArrayRef<runtime::FieldPtr> wrt) {
    if (!loss.adjoint() || loss.rank() != 0 || !loss.elementShape().empty())
      return refuse("the loss '" + loss.name() +
                    "' is not a number with a gradient");
    if (failed(findLaunches()))
      return failure();
    SmallVector<Attribute> fields;
    for (const runtime::FieldPtr &field : wrt) {
      if (!field->adjoint())
        return refuse("field '" + field->name() + "' has no gradient");
      fields.push_back(builder.getAttr<FlatSymbolRefAttr>(field->name()));
    }
    auto lossName = builder.getAttr<FlatSymbolRefAttr>(loss.name());
    (*module)->setAttr(
        kSaved,
        builder.getDictionaryAttr(
            {builder.getNamedAttr("version",
                                  builder.getI64IntegerAttr(kSavedVersion)),
             builder.getNamedAttr("loss", lossName),
             builder.getNamedAttr("wrt", builder.getArrayAttr(fields))}));
    if (failed(session.declareUsed(*module)) || failed(takeContents()))
      return failure();
    if (failed(addFunction("run", nullptr)) ||
        failed(addFunction("gradient", lossName)))
      return failure();
    DiagnosticCollector collector(session.getContext());
    if (failed(verify(*module)))
      return session.fail(
          collector.take(FailureKind::Usage, "the tape cannot be saved"));
    return std::move(module);
  }

private:
  struct LaunchRecord {
    KernelOp kernel;
    const uint64_t *args;
  };

  LogicalResult refuse(const Twine &reason) {
    return session.fail(FailureKind::Usage,
                        "the tape cannot be saved: " + reason);
  }

  /// Returns the kernel of a record; null for a further part of the previous
  /// record's kernel.
  FailureOr<SessionKernel *> findKernel(int64_t record) {
    const runtime::Kernel *launched = tape.kernelOf(record);
    if (!launched)
      return refuse("record " + Twine(record) +
                    " is no launch but a function or a write of the host; do "
                    "it before, or in a kernel");
    for (SessionKernel &kernel : session.getKernels()) {
      if (kernel.kernel.get() == launched)
        return &kernel;
      if (!kernel.kernel->adjoint().hasParts())
        continue;
      // A split kernel is recorded as its parts, one after another.
      const std::vector<runtime::KernelPtr> &parts =
          kernel.kernel->adjoint().plan().parts;
      for (auto [i, part] : llvm::enumerate(parts))
        if (part.get() == launched)
          return i == 0 ? &kernel : nullptr;
    }
    return refuse("the kernel '" + launched->name() + "' of record " +
                  Twine(record) + " is gone");
  }

  LogicalResult findLaunches() {
    for (int64_t i = 0, e = tape.numRecords(); i != e; ++i) {
      FailureOr<SessionKernel *> kernel = findKernel(i);
      if (failed(kernel))
        return failure();
      if (!*kernel)
        continue;
      KernelOp &copy = kernels[*kernel];
      if (!copy && failed(addKernel(**kernel, copy)))
        return failure();
      launches.push_back({copy, tape.argsOf(i)});
    }
    if (launches.empty())
      return refuse("it has recorded no launch");
    return success();
  }

  /// Copies the kernel and its helpers into the module.
  LogicalResult addKernel(SessionKernel &kernel, KernelOp &copy) {
    OwningOpRef<ModuleOp> source(kernel.code->getModule().clone());
    KernelOp op = source->lookupSymbol<KernelOp>(kernel.code->getName());
    if (op.getGradientsAttr())
      return refuse("kernel '" + kernel.code->getName() +
                    "' is differentiated by arguments or results, which lie "
                    "in memory of the caller");
    for (Type type : op.getArgumentTypes())
      if (isa<MemRefType>(type))
        return refuse("kernel '" + kernel.code->getName() +
                      "' takes an array of the caller; use a field");
    for (const runtime::TreePtr &tree : kernel.code->getTrees())
      if (!tree->sparseNodes().empty())
        return refuse("kernel '" + kernel.code->getName() + "' uses tree '" +
                      tree->name() + "', which has sparse levels");
    // Kernels and helpers are renamed if their names are taken.
    for (Operation &held : llvm::make_early_inc_range(*source->getBody())) {
      auto name = SymbolTable::getSymbolName(&held);
      if (auto field = dyn_cast<FieldOp>(held)) {
        if (session.getRuntime().store().findField(name.str()) !=
            kernel.code->findField(name))
          return refuse("field '" + name.getValue() + "' of kernel '" +
                        kernel.code->getName() + "' is gone");
        held.erase();
      } else if (isa<TreeOp>(held)) {
        held.erase();
      } else if (symbols.lookup(name) || known.contains(name)) {
        auto other = builder.getStringAttr(getFreeName(name));
        if (failed(SymbolTable::replaceAllSymbolUses(&held, other, *source)))
          return refuse("'" + name.getValue() + "' cannot be renamed");
        SymbolTable::setSymbolName(&held, other);
        known.insert(other);
      } else {
        known.insert(name);
      }
    }
    for (Operation &held : llvm::make_early_inc_range(*source->getBody())) {
      held.remove();
      symbols.insert(&held);
    }
    copy = op;
    return success();
  }

  std::string getFreeName(StringAttr name) {
    std::string other;
    do
      other = name.str() + "." + std::to_string(next++);
    while (known.contains(builder.getStringAttr(other)));
    return other;
  }

  /// Makes the current contents of fields their initial values, except for
  /// gradients and fields of zeros.
  LogicalResult takeContents() {
    for (FieldOp op : module->getOps<FieldOp>()) {
      runtime::FieldPtr field =
          session.getRuntime().store().findField(op.getSymName().str());
      if (!field)
        return refuse("field '" + op.getSymName() + "' is gone");
      if (field->isAdjoint())
        continue;
      int64_t count = field->numElements() * field->numComponents();
      std::vector<char> array(
          static_cast<size_t>(count * runtime::byteSize(field->scalar())));
      if (failed(session.check(
              session.getRuntime().copies().copyOut(*field, array.data()))))
        return failure();
      if (llvm::all_of(array, [](char byte) { return byte == 0; }))
        continue;
      SmallVector<int64_t> shape(field->shape().begin(), field->shape().end());
      llvm::append_range(shape, field->elementShape());
      auto type =
          RankedTensorType::get(shape, getElementTypeOrSelf(op.getType()));
      if (type.getElementType().isInteger(1)) {
        SmallVector<bool> bits(array.begin(), array.end());
        op.setInitialAttr(DenseElementsAttr::get(type, ArrayRef<bool>(bits)));
      } else {
        op.setInitialAttr(DenseElementsAttr::getFromRawBuffer(type, array));
      }
    }
    return success();
  }

  /// Emits a constant of type `type` with the value in the argument slot.
  Value makeNumber(OpBuilder &inside, Type type, const uint64_t *slot) {
    unsigned bits = isa<IndexType>(type) ? 64 : type.getIntOrFloatBitWidth();
    APInt value(
        bits, *slot & (bits == 64 ? ~uint64_t(0) : (uint64_t(1) << bits) - 1));
    TypedAttr attr =
        isa<FloatType>(type)
            ? TypedAttr(FloatAttr::get(
                  type,
                  APFloat(cast<FloatType>(type).getFloatSemantics(), value)))
            : TypedAttr(IntegerAttr::get(type, value));
    return arith::ConstantOp::create(inside, loc, attr);
  }

  void addLaunch(OpBuilder &inside, LaunchRecord record) {
    SmallVector<Value> operands;
    const uint64_t *slot = record.args;
    for (Type type : record.kernel.getArgumentTypes()) {
      auto vector = dyn_cast<VectorType>(type);
      if (!vector) {
        operands.push_back(makeNumber(inside, type, slot++));
        continue;
      }
      SmallVector<Value> components;
      for (int64_t i = 0; i != vector.getNumElements(); ++i)
        components.push_back(
            makeNumber(inside, vector.getElementType(), slot++));
      operands.push_back(
          vector::FromElementsOp::create(inside, loc, vector, components));
    }
    LaunchOp::create(inside, loc, record.kernel.getResultTypes(),
                     record.kernel.getSymName(), operands);
  }

  /// Adds a function with all launches of the tape to the module; with a loss,
  /// the launches are under a tape.
  LogicalResult addFunction(StringRef name, FlatSymbolRefAttr loss) {
    if (symbols.lookup(name))
      return refuse("a kernel or a helper is named '" + name +
                    "', as a function of a saved program is");
    auto function =
        func::FuncOp::create(loc, name, builder.getFunctionType({}, {}));
    symbols.insert(function);
    OpBuilder inside = OpBuilder::atBlockBegin(function.addEntryBlock());
    func::ReturnOp::create(inside, loc);
    inside.setInsertionPointToStart(&function.front());
    if (loss) {
      auto tapeOp = TapeOp::create(inside, loc, loss, CheckpointAttr());
      TapeOp::ensureTerminator(tapeOp.getBody(), inside, loc);
      inside.setInsertionPointToStart(&tapeOp.getBody().front());
    }
    for (LaunchRecord record : launches)
      addLaunch(inside, record);
    return success();
  }

  Session &session;
  const runtime::Tape &tape;
  OpBuilder builder;
  Location loc;
  OwningOpRef<ModuleOp> module;
  SymbolTable symbols;
  DenseSet<StringAttr> known;
  unsigned next = 0;
  llvm::DenseMap<SessionKernel *, KernelOp> kernels;
  std::vector<LaunchRecord> launches;
};
} // namespace

FailureOr<OwningOpRef<ModuleOp>>
mlir::tai::saveTape(Session &session, const runtime::Tape &tape,
                    const runtime::Field &loss,
                    ArrayRef<runtime::FieldPtr> wrt) {
  return Saver(session, tape).save(loss, wrt);
}
