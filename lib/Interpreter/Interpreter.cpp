//===- Interpreter.cpp - Programs, and how they are run -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Interpreter/Interpreter.h"
#include "Program.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "tai/Runtime/Threads/Safepoint.h"
#include "llvm/ADT/StringMap.h"

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
  std::unique_ptr<Program> program =
      Program::create(*module, function, options);
  if (!program)
    return nullptr;
  std::shared_ptr<Interpreter> made(new Interpreter());
  made->module = std::move(module);
  made->program = std::move(program);
  return made;
}

int32_t Interpreter::run(TaiFrame *frame) const {
  return Run(*program, frame).run();
}

//===----------------------------------------------------------------------===//
// Program
//===----------------------------------------------------------------------===//

std::unique_ptr<Program> Program::create(ModuleOp module, StringRef function,
                                         const InterpreterOptions &options) {
  std::unique_ptr<Program> program(new Program());
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

LogicalResult Program::prepareField(Operation *user, StringAttr name) {
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

LogicalResult Program::prepare(Operation *function) {
  if (!prepared.insert(function).second)
    return success();
  if (cast<FunctionOpInterface>(function).isExternal())
    return function->emitError("the interpreter needs a body here");
  bool good = true;
  function->walk([&](Operation *op) {
    if (op == function)
      return;
    StringRef name = op->getName().getStringRef();
    if (ScalarFunction scalar = findScalarFunction(name))
      scalarFunctions[op] = scalar;
    else if (Handler handler = Run::findHandler(name))
      handlers[op] = handler;
    else
      good = failed(op->emitError("the interpreter does not know '" + name +
                                  "'")) &&
             false;
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
    if (auto access = op->getAttrOfType<FlatSymbolRefAttr>("field");
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

//===----------------------------------------------------------------------===//
// Handlers
//===----------------------------------------------------------------------===//

Handler Run::findHandler(StringRef name) {
  static const llvm::StringMap<Handler> handlers = {
      {"arith.constant", &Run::runConstant},
      {"arith.select", &Run::runSelect},
      {"func.call", &Run::runCall},
      {"func.return", &Run::runTerminator},
      {"math.sincos", &Run::runSinCos},
      {"memref.alloc", &Run::runAlloc},
      {"memref.alloca", &Run::runAlloc},
      {"memref.atomic_rmw", &Run::runArrayAtomic},
      {"memref.dealloc", &Run::runNothing},
      {"memref.dim", &Run::runDim},
      {"memref.load", &Run::runArrayLoad},
      {"memref.store", &Run::runArrayStore},
      {"scf.condition", &Run::runTerminator},
      {"scf.for", &Run::runFor},
      {"scf.if", &Run::runIf},
      {"scf.index_switch", &Run::runSwitch},
      {"scf.parallel", &Run::runScfParallel},
      {"scf.reduce", &Run::runTerminator},
      {"scf.reduce.return", &Run::runTerminator},
      {"scf.while", &Run::runWhile},
      {"scf.yield", &Run::runTerminator},
      {"tai.activate", &Run::runActivate},
      {"tai.alloca", &Run::runAlloca},
      {"tai.append", &Run::runAppend},
      {"tai.assert", &Run::runAssert},
      {"tai.atomic", &Run::runAtomic},
      {"tai.check_close", &Run::runCheckClose},
      {"tai.check_gradient", &Run::runCheckGradient},
      {"tai.cross", &Run::runCross},
      {"tai.deactivate", &Run::runDeactivate},
      {"tai.determinant", &Run::runDeterminant},
      {"tai.dot", &Run::runDot},
      {"tai.inverse", &Run::runInverse},
      {"tai.is_active", &Run::runIsActive},
      {"tai.launch", &Run::runLaunch},
      {"tai.length", &Run::runLength},
      {"tai.load", &Run::runLoad},
      {"tai.local_load", &Run::runLocalLoad},
      {"tai.local_store", &Run::runLocalStore},
      {"tai.matmul", &Run::runMatmul},
      {"tai.norm", &Run::runNorm},
      {"tai.outer", &Run::runOuter},
      {"tai.parallel_for", &Run::runParallelFor},
      {"tai.polar", &Run::runPolar},
      {"tai.precondition", &Run::runNothing},
      {"tai.print", &Run::runPrint},
      {"tai.random", &Run::runRandom},
      {"tai.return", &Run::runTerminator},
      {"tai.solve", &Run::runSolve},
      {"tai.stack_create", &Run::runAlloca},
      {"tai.stack_destroy", &Run::runNothing},
      {"tai.stack_pop", &Run::runStackPop},
      {"tai.stack_push", &Run::runStackPush},
      {"tai.stop_gradient", &Run::runForward},
      {"tai.store", &Run::runStore},
      {"tai.sum", &Run::runSum},
      {"tai.svd", &Run::runSvd},
      {"tai.sym_eig", &Run::runSymEig},
      {"tai.tape", &Run::runTape},
      {"tai.trace", &Run::runTrace},
      {"tai.transpose", &Run::runTranspose},
      {"tai.visits_all", &Run::runVisitsAll},
      {"tai.yield", &Run::runTerminator},
      {"vector.broadcast", &Run::runBroadcast},
      {"vector.extract", &Run::runExtract},
      {"vector.from_elements", &Run::runFromElements},
      {"vector.insert", &Run::runInsert},
      {"vector.reduction", &Run::runReduction},
      {"vector.shape_cast", &Run::runForward},
      {"vector.shuffle", &Run::runShuffle},
      {"vector.to_elements", &Run::runToElements},
  };
  return handlers.lookup(name);
}

//===----------------------------------------------------------------------===//
// Run
//===----------------------------------------------------------------------===//

std::string interpreter::describePlaceOf(Operation *op) {
  std::string text;
  op->getLoc()->walk([&](Location inner) {
    auto file = dyn_cast<FileLineColLoc>(inner);
    if (!file)
      return WalkResult::advance();
    llvm::raw_string_ostream(text) << file.getFilename().getValue() << ":"
                                   << file.getLine() << ":" << file.getColumn();
    return WalkResult::interrupt();
  });
  return text;
}

LogicalResult Run::fail(Operation *op, const Twine &message, int32_t kind) {
  tai_rt_fail(frame, kind, message.str().c_str(), describePlaceOf(op).c_str(),
              0, nullptr, nullptr, nullptr);
  return failure();
}

void Run::report(Operation *op, StringRef message, ValueRange reported,
                 int32_t kind) {
  Message packed = getMessage(reported);
  tai_rt_fail(frame, kind, message.str().c_str(), describePlaceOf(op).c_str(),
              packed.shapes.size(), packed.kinds.data(), packed.shapes.data(),
              packed.slots.data());
}

LogicalResult Run::passSafepoint() {
  if (LLVM_LIKELY(runtime::safepoint::now() == frame->tick))
    return success();
  return failure(tai_rt_safepoint(frame) != 0);
}

SmallVector<int64_t> Run::getIndices(ValueRange indices) {
  SmallVector<int64_t> result;
  for (Value index : indices)
    result.push_back(toIndex(getNumber(index)));
  return result;
}

LogicalResult Run::execute(Operation *op) {
  if (program.getScalarFunction(op))
    return runScalars(op);
  return (this->*program.getHandler(op))(op);
}

LogicalResult Run::runBlock(Block &block, ArrayRef<Datum> arguments) {
  for (auto [argument, datum] :
       llvm::zip_equal(block.getArguments(), arguments))
    set(argument, datum);
  for (Operation &op : block)
    if (failed(execute(&op)))
      return failure();
  return success();
}

int32_t Run::run() {
  FunctionOpInterface function = program.getFunction();
  keepsActivity = function->hasAttr(kKeepsActivityAttrName);
  Block &body = function.getFunctionBody().front();
  Data arguments;
  readArguments(function, arguments);
  for (auto [argument, datum] : llvm::zip(body.getArguments(), arguments))
    set(argument, datum);
  if (failed(checkPreconditions(body)) || failed(runBlock(body, arguments)))
    return 1;
  writeResults(body.getTerminator());
  return tai_rt_failed(frame) ? 1 : 0;
}

/// A slot of eight bytes for each component, a pointer and extents for an
/// array.
void Run::readArguments(FunctionOpInterface function, Data &arguments) {
  const uint64_t *slot = frame->args;
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
}

void Run::writeResults(Operation *terminator) {
  uint64_t *slot = frame->results;
  for (Value operand : terminator->getOperands())
    for (const Number &number : get(operand).numbers)
      writeNumber(number, reinterpret_cast<char *>(slot++));
}
