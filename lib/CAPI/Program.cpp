//===- Program.cpp - Whole files in the C API -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "Impl.h"
#include "mlir/CAPI/IR.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/ExecutionEngine/Modules/SavedProgram.h"
#include "tai/ExecutionEngine/Session/Plugins.h"
#include "tai/Runtime/Tape/HostProgram.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/raw_ostream.h"

using namespace mlir;
using namespace mlir::tai;

/// Refuses a null argument: `what` is its name.
static TaiStatus refuseNull(TaiContextImpl &context, StringRef what) {
  return context.usage("'" + what + "' is null");
}

static StringRef withoutAt(const char *name) {
  StringRef bare = name;
  bare.consume_front("@");
  return bare;
}

//===----------------------------------------------------------------------===//
// Modules and plugins
//===----------------------------------------------------------------------===//

TaiStatus taiContextLoadPlugin(TaiContext context, const char *path) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!path)
      return refuseNull(*context, "path");
    return context->status(loadPlugin(context->session, path));
  });
}

TaiStatus taiModuleRead(TaiContext context, const char *bytes, size_t size,
                        const char *file, MlirModule *module) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!bytes || !module)
      return refuseNull(*context, bytes ? "module" : "bytes");
    OwningOpRef<ModuleOp> read = Program::read(
        context->session, StringRef(bytes, size), file ? file : "");
    if (!read)
      return context->status(failure());
    *module = wrap(read.release());
    return TAI_OK;
  });
}

TaiStatus taiModuleRunPasses(TaiContext context, MlirModule module,
                             const char *pipeline) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!module.ptr || !pipeline)
      return refuseNull(*context, pipeline ? "module" : "pipeline");
    if (unwrap(module)->getContext() != context->session.getContext())
      return context->usage("the module belongs to another context");
    return context->status(
        runPasses(context->session, unwrap(module), pipeline));
  });
}

//===----------------------------------------------------------------------===//
// Programs
//===----------------------------------------------------------------------===//

static void listSymbols(TaiProgramImpl &program) {
  for (Operation &op : *program.program->getModule().getBody()) {
    int kind = llvm::TypeSwitch<Operation *, int>(&op)
                   .Case([](TreeOp) { return TAI_SYMBOL_TREE; })
                   .Case([](FieldOp) { return TAI_SYMBOL_FIELD; })
                   .Case([](KernelOp) { return TAI_SYMBOL_KERNEL; })
                   .Case([](func::FuncOp function) {
                     return function.isExternal() ? -1 : TAI_SYMBOL_FUNCTION;
                   })
                   .Default(-1);
    if (kind >= 0)
      program.symbols[kind].push_back(SymbolTable::getSymbolName(&op).str());
  }
  auto saved =
      program.program->getModule()->getAttrOfType<DictionaryAttr>(kSaved);
  if (!saved)
    return;
  auto add = [&](int to, Attribute name) {
    if (auto symbol = dyn_cast_if_present<FlatSymbolRefAttr>(name))
      program.symbols[to].push_back(symbol.getValue().str());
  };
  add(TAI_SYMBOL_LOSS, saved.get("loss"));
  if (auto wrt = saved.getAs<ArrayAttr>("wrt"))
    for (Attribute name : wrt)
      add(TAI_SYMBOL_WRT, name);
}

static TaiStatus load(TaiContextImpl &context, OwningOpRef<ModuleOp> module,
                      TaiProgram *program) {
  if (!module)
    return context.status(failure());
  auto loaded = Program::load(context.session, std::move(module));
  if (failed(loaded))
    return context.status(failure());
  std::unique_ptr<TaiProgramImpl> made(
      new TaiProgramImpl{context, std::move(*loaded), {}, {}});
  listSymbols(*made);
  *program = context.programs.add(std::move(made));
  return TAI_OK;
}

TaiStatus taiProgramCreate(TaiContext context, MlirModule module,
                           TaiProgram *program) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!module.ptr)
      return refuseNull(*context, "module");
    OwningOpRef<ModuleOp> owned(unwrap(module));
    if (!program)
      return refuseNull(*context, "program");
    if (owned->getContext() != context->session.getContext())
      return context->usage("the module belongs to another context");
    return load(*context, std::move(owned), program);
  });
}

TaiStatus taiProgramLoad(TaiContext context, const char *bytes, size_t size,
                         const char *file, TaiProgram *program) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!bytes || !program)
      return refuseNull(*context, bytes ? "program" : "bytes");
    return load(*context,
                Program::read(context->session, StringRef(bytes, size),
                              file ? file : ""),
                program);
  });
}

TaiStatus taiProgramLoadFile(TaiContext context, const char *path,
                             TaiProgram *program) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!path || !program)
      return refuseNull(*context, path ? "program" : "path");
    auto file = llvm::MemoryBuffer::getFile(path);
    if (!file)
      return context->usage(Twine("cannot read '") + path +
                            "': " + file.getError().message());
    return load(*context,
                Program::read(context->session, (*file)->getBuffer(), path),
                program);
  });
}

void taiProgramDestroy(TaiProgram program) {
  if (!program)
    return;
  callQuietly(program->context, [&] {
    TaiContextImpl &context = program->context;
    context.session.getRuntime().launcher().running().waitForVisits();
    for (auto &kernel : program->kernels)
      context.kernels.drop(kernel.second);
    context.programs.drop(program);
  });
}

const char *taiProgramGetSymbol(TaiProgram program, TaiSymbolKind kind,
                                int64_t number) {
  if (!program || static_cast<size_t>(kind) >= program->symbols.size())
    return nullptr;
  const std::vector<std::string> &names = program->symbols[kind];
  if (number < 0 || number >= static_cast<int64_t>(names.size()))
    return nullptr;
  return names[number].c_str();
}

/// A phrase that lists names, for messages: "; there are @a, @b".
static std::string describeNames(ArrayRef<std::string> names) {
  if (names.empty())
    return "; there are none";
  std::string text = "; there are @" + llvm::join(names.take_front(20), ", @");
  return names.size() > 20 ? text + " and others" : text;
}

TaiStatus taiProgramGetKernel(TaiProgram program, const char *name,
                              TaiKernel *kernel) {
  if (!program)
    return TAI_ERROR_USAGE;
  return call(program->context, [&]() -> TaiStatus {
    TaiContextImpl &context = program->context;
    if (!name || !kernel)
      return refuseNull(context, name ? "kernel" : "name");
    StringRef bare = withoutAt(name);
    SessionKernel *found = program->program->findKernel(bare);
    if (!found)
      return context.usage("the program has no kernel '" + bare + "'" +
                           describeNames(program->symbols[TAI_SYMBOL_KERNEL]));
    TaiKernel &handle = program->kernels[bare];
    if (!handle)
      handle = context.kernels.add(std::unique_ptr<TaiKernelImpl>(
          new TaiKernelImpl{context, found, "", program}));
    *kernel = handle;
    return TAI_OK;
  });
}

TaiStatus taiTapeSave(TaiTape tape, const char *path, TaiField loss,
                      const TaiField *fields, int64_t count) {
  if (!tape)
    return TAI_ERROR_USAGE;
  return call(tape->context, [&]() -> TaiStatus {
    TaiContextImpl &context = tape->context;
    if (!path || !loss || (count > 0 && !fields))
      return refuseNull(context, !path ? "path" : !loss ? "loss" : "fields");
    std::vector<runtime::FieldPtr> wrt;
    for (int64_t i = 0; i < count; ++i) {
      if (!fields[i])
        return refuseNull(context, "fields[" + std::to_string(i) + "]");
      wrt.push_back(fields[i]->field);
    }
    auto module = saveTape(context.session, *tape->tape, *loss->field, wrt);
    if (failed(module))
      return context.status(failure());
    // The file is written completely or not at all.
    llvm::Error error =
        llvm::writeToOutput(path, [&](llvm::raw_ostream &stream) {
          return succeeded(writeModule(**module, stream))
                     ? llvm::Error::success()
                     : llvm::createStringError("no bytecode can be made");
        });
    if (error)
      return context.usage(Twine("cannot write '") + path +
                           "': " + llvm::toString(std::move(error)));
    return TAI_OK;
  });
}

TaiStatus taiProgramRun(TaiProgram program, const char *function) {
  if (!program)
    return TAI_ERROR_USAGE;
  return call(program->context, [&]() -> TaiStatus {
    if (!function)
      return refuseNull(program->context, "function");
    return program->context.status(program->program->run(withoutAt(function)));
  });
}

//===----------------------------------------------------------------------===//
// Fields and gradients
//===----------------------------------------------------------------------===//

static TaiField keep(TaiContextImpl &context, runtime::FieldPtr field) {
  return context.fields.add(std::unique_ptr<TaiFieldImpl>(
      new TaiFieldImpl{context, std::move(field)}));
}

TaiStatus taiContextFindField(TaiContext context, const char *name,
                              TaiField *field) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!name || !field)
      return refuseNull(*context, name ? "field" : "name");
    StringRef bare = withoutAt(name);
    runtime::Runtime &rt = context->session.getRuntime();
    runtime::FieldPtr found = rt.store().findField(bare.str());
    if (!found) {
      SmallVector<std::string> names;
      for (const runtime::FieldPtr &other : rt.store().fields())
        names.push_back(other->name());
      return context->usage("there is no field '" + bare + "'" +
                            describeNames(names));
    }
    *field = keep(*context, std::move(found));
    return TAI_OK;
  });
}

TaiStatus taiFieldGetAdjoint(TaiField field, TaiField *adjoint) {
  if (!field)
    return TAI_ERROR_USAGE;
  return call(field->context, [&]() -> TaiStatus {
    TaiContextImpl &context = field->context;
    if (!adjoint)
      return refuseNull(context, "adjoint");
    const runtime::Field *found = field->field->adjoint();
    if (!found)
      return context.usage("field '" + field->field->name() +
                           "' has no adjoint; its declaration names it: "
                           "'tai.field … adjoint @…'");
    return taiContextFindField(&context, found->name().c_str(), adjoint);
  });
}

TaiStatus taiCheckGradient(TaiContext context, TaiField loss,
                           const TaiField *fields, int64_t count,
                           double tolerance, TaiRun run, void *user) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!loss || !run || (count > 0 && !fields))
      return refuseNull(*context, !loss ? "loss" : !run ? "run" : "fields");
    if (count <= 0)
      return context->usage("there is no field to check a gradient by");
    if (!(tolerance >= 0))
      return context->usage("a tolerance is a number that is not negative");
    std::vector<runtime::FieldPtr> wrt;
    for (int64_t i = 0; i < count; ++i) {
      if (!fields[i])
        return refuseNull(*context, "fields[" + std::to_string(i) + "]");
      wrt.push_back(fields[i]->field);
    }
    for (TaiField field : llvm::concat<const TaiField>(
             ArrayRef(loss), ArrayRef(fields, static_cast<size_t>(count))))
      if (&field->context != context)
        return context->usage("field '" + field->field->name() +
                              "' belongs to another context");
    return context->status(runtime::checkGradient(
        context->session.getRuntime(), loss->field, wrt, tolerance, [&] {
          return callBack(*context, run, user,
                          "the function of the gradient check failed");
        }));
  });
}

//===----------------------------------------------------------------------===//
// Functions compiled ahead of time
//===----------------------------------------------------------------------===//

TaiStatus taiContextRunFunction(TaiContext context, TaiFunction function,
                                const char *const *trees, int64_t numTrees,
                                const uint64_t *args, uint64_t *results) {
  if (!context)
    return TAI_ERROR_USAGE;
  return call(*context, [&]() -> TaiStatus {
    if (!function || (numTrees > 0 && !trees))
      return refuseNull(*context, function ? "trees" : "function");
    runtime::Runtime &rt = context->session.getRuntime();
    const runtime::Recorder *tape = rt.recordings().current();
    if (tape && !tape->isSuspended())
      return context->usage("a tape cannot record code that was compiled ahead "
                            "of time: it does not know the accesses; suspend "
                            "the tape, or launch a kernel of a program");
    std::vector<runtime::TreePtr> given;
    for (int64_t i = 0; i < numTrees; ++i) {
      if (!trees[i])
        return refuseNull(*context, "trees[" + std::to_string(i) + "]");
      given.push_back(rt.store().findTree(withoutAt(trees[i]).str()));
      if (!given.back())
        return context->usage(Twine("there is no tree '") + trees[i] + "'");
    }
    runtime::HostModule module;
    module.findKernel = [&](std::string_view name) -> runtime::Kernel * {
      SessionKernel *kernel = context->session.findKernel(name);
      return kernel ? kernel->kernel.get() : nullptr;
    };
    return context->status(
        runtime::runHost(rt, function, given, module, args, results));
  });
}
