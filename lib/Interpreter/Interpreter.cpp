//===- Interpreter.cpp - Prepares and runs programs -----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Interpreter/Interpreter.h"
#include "Handlers.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"

using namespace mlir;
using namespace mlir::tai;
using namespace mlir::tai::interpreter;

//===----------------------------------------------------------------------===//
// Interpreter
//===----------------------------------------------------------------------===//

Interpreter::~Interpreter() = default;

std::shared_ptr<const Interpreter>
Interpreter::create(OwningOpRef<ModuleOp> module, StringRef function,
                    const InterpreterOptions &options) {
  std::unique_ptr<FunctionCode> program =
      FunctionCode::create(*module, function, options);
  if (!program)
    return nullptr;
  std::shared_ptr<Interpreter> made(new Interpreter());
  made->module = std::move(module);
  made->program = std::move(program);
  return made;
}

/// Reads the arguments of a function: a slot of eight bytes for each component
/// of a number, and a pointer and extents for an array.
static Data readArguments(FunctionOpInterface function, const uint64_t *slot) {
  Data arguments;
  for (Type type : function.getArgumentTypes()) {
    Datum datum;
    if (auto memref = dyn_cast<MemRefType>(type)) {
      datum.array = std::make_shared<Array>();
      datum.array->data = reinterpret_cast<char *>(*slot++);
      datum.array->element = memref.getElementType();
      for (int64_t i = 0; i != memref.getRank(); ++i)
        datum.array->extents.push_back(static_cast<int64_t>(*slot++));
    } else {
      auto vector = dyn_cast<VectorType>(type);
      int64_t count = vector ? vector.getNumElements() : 1;
      for (int64_t i = 0; i != count; ++i)
        datum.numbers.push_back(
            readNumber(reinterpret_cast<const char *>(slot++),
                       getElementTypeOrSelf(type)));
    }
    arguments.push_back(std::move(datum));
  }
  return arguments;
}

static void writeResults(Run &run, Operation *terminator) {
  uint64_t *slot = run.frame->results;
  for (Value operand : terminator->getOperands())
    for (const Number &number : run.get(operand).numbers)
      writeNumber(number, reinterpret_cast<char *>(slot++));
}

int32_t Interpreter::run(TaiFrame *frame) const {
  FunctionOpInterface function = program->getFunction();
  Block &body = function.getFunctionBody().front();
  Run run(*program, frame);
  if (auto kernel = dyn_cast<KernelOp>(function.getOperation()))
    run.keepsActivity = kernel.getKeepsActivity();
  Data arguments = readArguments(function, frame->args);
  for (auto [argument, datum] : llvm::zip(body.getArguments(), arguments))
    run.set(argument, datum);
  if (failed(checkPreconditions(run, body)) ||
      failed(run.runBlock(body, arguments)))
    return 1;
  writeResults(run, body.getTerminator());
  return tai_rt_failed(frame) ? 1 : 0;
}

//===----------------------------------------------------------------------===//
// Handlers
//===----------------------------------------------------------------------===//

static const Handlers &getHandlers() {
  static const Handlers handlers = [] {
    Handlers all;
    addControlFlowHandlers(all);
    addMemoryHandlers(all);
    addServiceHandlers(all);
    addVectorHandlers(all);
    return all;
  }();
  return handlers;
}

//===----------------------------------------------------------------------===//
// FunctionCode
//===----------------------------------------------------------------------===//

std::unique_ptr<FunctionCode>
FunctionCode::create(ModuleOp module, StringRef function,
                     const InterpreterOptions &options) {
  std::unique_ptr<FunctionCode> program(new FunctionCode());
  program->options = options;
  program->module = module;
  program->function = dyn_cast_if_present<FunctionOpInterface>(
      SymbolTable::lookupSymbolIn(module, function));
  if (!program->function) {
    module.emitError("holds no function '") << function << "'";
    return nullptr;
  }
  if (failed(program->prepare(program->function)))
    return nullptr;
  return program;
}

LogicalResult FunctionCode::prepareField(Operation *user, StringAttr name) {
  auto &slot = fields[name];
  if (slot)
    return success();
  auto field = module.lookupSymbol<FieldOp>(name);
  FailureOr<FieldLayout> layout =
      field ? getFieldLayout(field) : FailureOr<FieldLayout>(failure());
  if (failed(layout))
    return user->emitOpError("names ") << name << ", which is not a field";
  auto place = std::make_unique<FieldPlace>();
  DataLayout dataLayout = DataLayout::closest(field);
  place->layout = *layout;
  place->storage = getFieldStorage(*layout, dataLayout);
  place->nodes = getSparseNodes(layout->tree.getLayout(), dataLayout);
  Type type = layout->path.getElementType();
  place->scalar = getElementTypeOrSelf(type);
  if (auto vector = dyn_cast<VectorType>(type))
    llvm::append_range(place->elementShape, vector.getShape());
  place->tree = 0;
  for (TreeOp tree : module.getOps<TreeOp>()) {
    if (tree == layout->tree)
      break;
    ++place->tree;
  }
  slot = std::move(place);
  return success();
}

LogicalResult FunctionCode::prepare(Operation *function) {
  if (!prepared.insert(function).second)
    return success();
  if (cast<FunctionOpInterface>(function).isExternal())
    return function->emitError("the interpreter needs a body here");
  bool good = true;
  function->walk([&](Operation *op) {
    if (op == function)
      return;
    StringRef name = op->getName().getStringRef();
    if (ScalarFunction scalar = findScalarFunction(name)) {
      scalarFunctions[op] = scalar;
      handlers[op] = runScalars;
    } else if (Handler handler = getHandlers().lookup(name)) {
      handlers[op] = handler;
    } else {
      good = failed(op->emitError("the interpreter does not know '" + name +
                                  "'")) &&
             false;
    }
    for (Type type : op->getResultTypes())
      if (auto memref = dyn_cast<MemRefType>(type);
          memref && !memref.getLayout().isIdentity())
        good = failed(op->emitError("the interpreter knows no arrays with "
                                    "strides")) &&
               false;
    for (Region &region : op->getRegions())
      if (!region.empty() && !region.hasOneBlock())
        good = failed(op->emitError("the interpreter knows no branches between "
                                    "blocks")) &&
               false;
    if (FlatSymbolRefAttr access = getNamedField(op);
        access && op->getName().getDialectNamespace() == "tai")
      good &= succeeded(prepareField(op, access.getAttr()));
    if (auto call = dyn_cast<func::CallOp>(op)) {
      auto callee = module.lookupSymbol<func::FuncOp>(call.getCallee());
      callees[call] = callee;
      if (!callee)
        good =
            failed(call.emitOpError("calls what is not a function")) && false;
      else
        good &= succeeded(prepare(callee));
    }
  });
  return success(good);
}
