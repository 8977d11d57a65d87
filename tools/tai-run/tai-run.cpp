//===- tai-run.cpp - Run the program in an .mlir file ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Compiles the kernels of a file for this machine and runs its `func.func
// @main`, or one of its kernels. Ends with a non-zero status on any error and
// on a failed check, so that a file can test itself.
//
//===----------------------------------------------------------------------===//

#include "PrintField.h"
#include "mlir/Bytecode/BytecodeReader.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Parser/Parser.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/ExecutionEngine/Modules/Program.h"
#include "tai/ExecutionEngine/Modules/SavedProgram.h"
#include "tai/ExecutionEngine/Session/Plugins.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/Support/CommandLine.h"
#include "llvm/Support/InitLLVM.h"
#include "llvm/Support/MemoryBuffer.h"

using namespace mlir;
using namespace mlir::tai;

namespace cl = llvm::cl;

namespace {
/// The options of tai-run. Constructed in main, after LLVM's own options have
/// been removed, some of which have the same names.
struct Options {
  cl::opt<std::string> inputFile{cl::Positional, cl::init("-"),
                                 cl::desc("<file>")};
  cl::opt<std::string> kernelName{
      "kernel", cl::desc("Launch this kernel instead of @main")};
  cl::list<std::string> printedFields{
      "print-field", cl::desc("Print a field at the end (may be repeated)"),
      cl::value_desc("@x"), cl::CommaSeparated};
  cl::opt<std::string> arch{"arch", cl::init("cpu"),
                            cl::desc("Where kernels run: cpu or cuda")};
  cl::opt<bool> interpret{
      "interpret",
      cl::desc("Run the program as it stands, operation by operation, instead "
               "of compiling it: slow, and no pass has a say in the results")};
  cl::opt<std::string> interpretOrder{
      "interpret-order", cl::init("0"),
      cl::desc("With --interpret: run the iterations of parallel loops in an "
               "order drawn from this number; 0 for ascending"),
      cl::value_desc("seed")};
  cl::opt<unsigned> threads{"threads", cl::init(0),
                            cl::desc("Number of threads, 0 = all cores")};
  cl::opt<bool> deterministic{
      "deterministic", cl::desc("Bit-identical results from run to run")};
  cl::opt<bool> debug{"debug", cl::desc("Check assertions and indices")};
  cl::opt<std::string> bounds{
      "bounds", cl::init("off"),
      cl::desc("What happens to indices out of range that depend on data: off "
               "(undefined), clamp (the nearest element) or check (an error)"),
      cl::value_desc("mode")};
  cl::opt<bool> fastMath{"fast-math",
                         cl::desc("Reorder and approximate float math")};
  cl::opt<bool> strict{"strict", cl::desc("Round every operation by itself")};
  // Options of a context, with the values that they have in Python.
  cl::opt<std::string> precision{
      "precision", cl::init("default"),
      cl::desc("What kernels compute in: default, f64 or f32")};
  cl::opt<std::string> sums{
      "sums", cl::init("default"),
      cl::desc("How sums are kept: default, compensated or deterministic")};
  cl::opt<std::string> math{
      "math", cl::init("default"),
      cl::desc("default, fast, strict, or accurate functions")};
  cl::opt<bool> ftz{"ftz", cl::desc("Denormal numbers are zero")};
  cl::opt<std::string> adjoints{
      "adjoints", cl::init("default"),
      cl::desc("What gradients of fields are kept in: default or f64")};
  cl::opt<unsigned> optLevel{"opt-level", cl::init(3),
                             cl::desc("Effort of the optimiser, 0 to 3")};
  cl::opt<std::string> seed{"seed", cl::init("0"),
                            cl::desc("Seed of tai.random")};
  cl::opt<std::string> printIR{
      "print-ir",
      cl::desc("Print the IR of each kernel that is compiled: all, or "
               "some of tai,autodiff,scf,llvm,nvvm,ptx,llvmir,asm"),
      cl::value_desc("stages")};
  cl::opt<bool> noFuseLaunches{
      "no-fuse-launches",
      cl::desc("Run each launch by itself: neither make one kernel of those "
               "that @main launches in a row, nor one piece of work of "
               "recurring sequences on a GPU")};
  cl::opt<bool> noCache{"no-cache",
                        cl::desc("Do not keep or use compiled code")};
  cl::opt<std::string> cacheDir{"cache-dir",
                                cl::desc("Folder of compiled code")};
  cl::opt<bool> compileProfile{"compile-profile",
                               cl::desc("Print times of compilation")};
  cl::opt<std::string> skip{
      "tai-skip", cl::init("all"),
      cl::desc("What is left out where it is not needed: all, none, or names; "
               "-name takes one away"),
      cl::value_desc("names")};
  cl::list<std::string> dialectPlugins{
      "load-dialect-plugin", cl::value_desc("file"),
      cl::desc("Load a library of dialects, such as levels of other kinds")};
  cl::list<std::string> passPlugins{"load-pass-plugin", cl::value_desc("file"),
                                    cl::desc("Load a library of passes")};
  cl::opt<std::string> passPipeline{
      "pass-pipeline", cl::value_desc("passes"),
      cl::desc("Run these passes on the file first, such as those that lower "
               "the dialects of plugins")};
  cl::opt<bool> skips{"skips", cl::desc("Print what was left out")};
};
} // namespace

static LogicalResult setOptions(Session &session, const Options &given) {
  auto text = [](bool on) { return on ? "true" : "false"; };
  SmallVector<std::pair<StringRef, std::string>> options = {
      {"arch", given.interpret ? "interpreter" : given.arch.getValue()},
      {"order_seed", given.interpretOrder},
      {"threads", std::to_string(given.threads)},
      {"fuse_launches", text(!given.noFuseLaunches)},
      {"deterministic", text(given.deterministic)},
      {"debug", text(given.debug)},
      {"bounds", given.bounds},
      {"fast_math", text(given.fastMath)},
      {"strict", text(given.strict)},
      {"precision", given.precision},
      {"sums", given.sums},
      {"math", given.math},
      {"ftz", text(given.ftz)},
      {"adjoints", given.adjoints},
      {"opt_level", std::to_string(given.optLevel)},
      {"seed", given.seed},
      {"print_ir", given.printIR},
      {"compile_profile", text(given.compileProfile)},
      {"skip", given.skip}};
  if (given.noCache)
    options.push_back({"cache_dir", ""});
  else if (given.cacheDir.getNumOccurrences())
    options.push_back({"cache_dir", given.cacheDir});
  for (const auto &[name, value] : options)
    if (failed(session.setOption(name, value)))
      return failure();
  return success();
}

/// Reads and verifies the file.
static OwningOpRef<ModuleOp> parse(Session &session, const Options &given) {
  DiagnosticCollector collector(session.getContext());
  auto file = llvm::MemoryBuffer::getFileOrSTDIN(given.inputFile);
  if (!file) {
    (void)session.fail(FailureKind::Usage,
                       "cannot read '" + given.inputFile +
                           "': " + file.getError().message());
    return {};
  }
  // Bytecode without a checksum is read as other tools read it, at the user's
  // own risk.
  StringRef bytes = (*file)->getBuffer();
  ParserConfig config(session.getContext());
  OwningOpRef<ModuleOp> module;
  if (!isBytecode(**file))
    module = readModule(bytes, config, (*file)->getBufferIdentifier());
  else if (checkText(bytes, session.getContext(), given.inputFile))
    module = parseSourceString<ModuleOp>(bytes, config, given.inputFile);
  if (!module)
    (void)session.fail(
        collector.take(FailureKind::Syntax, "the file does not parse"));
  return module;
}

static LogicalResult launchKernel(Session &session, const Program &program,
                                  StringRef name) {
  SessionKernel *kernel = program.findKernel(name);
  if (!kernel)
    return session.fail(FailureKind::Usage,
                        "the file holds no kernel '" + name + "'");
  if (kernel->kernel->argSlots() > 0)
    return session.fail(FailureKind::Usage,
                        "kernel '" + name +
                            "' takes arguments; launch it from a @main");
  std::vector<uint64_t> results(kernel->kernel->resultSlots());
  return session.launch(*kernel, nullptr, 0, results.data());
}

static LogicalResult run(Session &session, const Options &given) {
  if (failed(setOptions(session, given)))
    return failure();
  // Each library is loaded once, because it may have been named as a plugin of
  // both kinds.
  llvm::SetVector<StringRef> plugins;
  for (const std::string &plugin : given.dialectPlugins)
    plugins.insert(plugin);
  for (const std::string &plugin : given.passPlugins)
    plugins.insert(plugin);
  for (StringRef plugin : plugins)
    if (failed(loadPlugin(session, plugin)))
      return failure();
  OwningOpRef<ModuleOp> file = parse(session, given);
  if (!file)
    return failure();
  if (given.passPipeline.getNumOccurrences() &&
      failed(runPasses(session, *file, given.passPipeline)))
    return failure();
  auto program = Program::load(session, std::move(file));
  if (failed(program))
    return failure();
  if (given.kernelName.getNumOccurrences())
    return launchKernel(session, **program,
                        StringRef(given.kernelName).ltrim('@'));
  ModuleOp module = (*program)->getModule();
  if (module->hasAttr(kSaved))
    return (*program)->run("gradient");
  if (!module.lookupSymbol<func::FuncOp>("main"))
    return session.fail(FailureKind::Usage,
                        "the file holds no 'func.func @main'; name a kernel "
                        "with --kernel to launch it alone");
  return (*program)->run("main");
}

static LogicalResult printFields(Session &session, const Options &given) {
  for (const std::string &name : given.printedFields) {
    StringRef bare = StringRef(name).ltrim('@');
    runtime::FieldPtr field =
        session.getRuntime().store().findField(bare.str());
    if (!field)
      return session.fail(FailureKind::Usage,
                          "there is no field '" + bare + "' to print");
    if (failed(session.check(printField(llvm::outs(), *field))))
      return failure();
  }
  return success();
}

int main(int argc, char **argv) {
  llvm::InitLLVM initialize(argc, argv);
  cl::ResetCommandLineParser();
  Options options;
  // Options without a category get a new one: the help lists options by
  // category, and their default category was removed with LLVM's options.
  cl::OptionCategory category("Options of tai-run");
  for (auto &[name, option] : cl::getRegisteredOptions())
    if (llvm::is_contained(option->Categories, &cl::getGeneralCategory()))
      option->addCategory(category);
  cl::ParseCommandLineOptions(argc, argv,
                              "Runs the program in an .mlir file.\n");
  Session session;
  if (succeeded(run(session, options)) &&
      succeeded(printFields(session, options))) {
    if (options.skips)
      llvm::outs() << session.getRuntime().skipTable();
    return 0;
  }
  llvm::outs().flush();
  llvm::errs() << session.getFailure().text;
  return 1;
}
