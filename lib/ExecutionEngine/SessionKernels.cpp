//===- SessionKernels.cpp - Kernels of a session --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Makes kernels, compiles them when they are needed or a little before, and
// runs host programs.
//
//===----------------------------------------------------------------------===//

#include "RunInParallel.h"
#include "mlir/Dialect/Arith/IR/Arith.h"
#include "mlir/Dialect/Func/IR/FuncOps.h"
#include "mlir/Transforms/Passes.h"
#include "tai/AD/Signature.h"
#include "tai/ExecutionEngine/AdjointNeeds.h"
#include "tai/ExecutionEngine/ModuleFile.h"
#include "tai/ExecutionEngine/Session.h"
#include "tai/Pipelines/Pipelines.h"
#include "tai/Transforms/Passes.h"
#include "llvm/Support/FormatVariadic.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Kernels
//===----------------------------------------------------------------------===//

/// What the adjoint of a kernel is given besides the arguments.
static FailureOr<runtime::CallerAdjoints> getCallerAdjoints(KernelOp kernel,
                                                            Failure &problem) {
  DiagnosticCollector collector(kernel.getContext());
  FailureOr<AdjointSignature> signature =
      AdjointSignature::get(kernel, /*arrays=*/false);
  if (failed(signature)) {
    problem = collector.take(FailureKind::Type, "the kernel is not valid");
    return failure();
  }
  runtime::CallerAdjoints adjoints;
  adjoints.hasTargets = !signature->arguments.empty();
  SmallVector<MemRefType> types = signature->getShadowTypes(kernel);
  for (auto [i, type] : llvm::enumerate(types)) {
    if (i >= signature->arguments.size())
      adjoints.results.push_back(
          {adjoints.slots,
           type.getNumElements() * type.getElementTypeBitWidth() / 8});
    else
      adjoints.hasArrays |=
          isa<MemRefType>(kernel.getArgumentTypes()[signature->arguments[i]]);
    adjoints.slots += countSlots(type);
  }
  return adjoints;
}

static std::vector<runtime::ArrayArgument> findArrays(KernelOp kernel) {
  std::vector<runtime::ArrayArgument> arrays;
  int64_t slot = 0;
  for (Type type : kernel.getArgumentTypes()) {
    if (auto array = dyn_cast<MemRefType>(type)) {
      Type element = array.getElementType();
      unsigned bits =
          element.isIntOrFloat() ? element.getIntOrFloatBitWidth() : 64;
      arrays.push_back({slot, array.getRank(), (bits + 7) / 8});
    }
    slot += countSlots(type);
  }
  return arrays;
}

/// That a device does not take our code is a bug of ours.
static std::function<std::string(const std::string &)>
explainRefusal(KernelCode &code, CompileRequest::Goal goal, bool forward) {
  return [weak = code.weak_from_this(), goal,
          forward](const std::string &reason) {
    Failure failure = Failure::get(FailureKind::Internal, reason);
    if (std::shared_ptr<KernelCode> code = weak.lock())
      code->compiler.addReproducer({*code->module, code->name, goal, forward},
                                   code->options, failure);
    return failure.message;
  };
}

FailureOr<std::pair<std::shared_ptr<KernelCode>, runtime::KernelPtr>>
Session::makeKernel(OwningOpRef<ModuleOp> module, StringRef name) {
  auto op = module->lookupSymbol<KernelOp>(name);
  if (!op)
    return fail(FailureKind::Usage,
                "the module holds no kernel of the name '" + name + "'");
  if (failed(declareUsed(*module)) || failed(verifyModule(*module)) ||
      failed(clampIndices(*module)))
    return failure();

  Failure problem;
  FailureOr<runtime::CallerAdjoints> adjoints = getCallerAdjoints(op, problem);
  if (failed(adjoints))
    return fail(std::move(problem));

  auto code = std::make_shared<KernelCode>(*compiler, background, codeNames,
                                           name, options);
  runtime::KernelInfo info;
  info.name = code->name;
  info.place = code->place = describePlace(op.getLoc());
  info.argSlots = code->argSlots = countSlots(op.getArgumentTypes());
  info.resultSlots = countSlots(op.getResultTypes());
  info.arrays = findArrays(op);
  info.callerAdjoints = std::move(*adjoints);
  info.summary = summarize(*module, op);
  for (TreeOp tree : module->getOps<TreeOp>())
    code->trees.push_back(rt->findTree(tree.getSymName().str()));
  for (FieldOp field : module->getOps<FieldOp>())
    if (runtime::FieldPtr known = rt->findField(field.getSymName().str()))
      code->fields[field.getSymName()] = known;
  info.trees = code->trees;
  info.explainRefusal =
      explainRefusal(*code, CompileRequest::Goal::Primal, /*forward=*/false);
  info.resolve = [this, code](runtime::Kernel &runtimeKernel,
                              TaiKernelFn &function) {
    return compilePrimal(*code, runtimeKernel, function);
  };
  info.makeAdjoint = [this, code](runtime::Kernel &runtimeKernel,
                                  runtime::KernelPtr &adjoint) {
    return compileAdjoint(*code, runtimeKernel, /*takes=*/false,
                          /*stored=*/false, adjoint);
  };
  info.makeTakingAdjoint = [this, code](runtime::Kernel &runtimeKernel,
                                        runtime::KernelPtr &adjoint) {
    return compileAdjoint(*code, runtimeKernel, /*takes=*/true,
                          /*stored=*/false, adjoint);
  };
  info.makeStoredAdjoint = [this, code](runtime::Kernel &runtimeKernel,
                                        bool takes,
                                        runtime::KernelPtr &adjoint) {
    return compileAdjoint(*code, runtimeKernel, takes, /*stored=*/true,
                          adjoint);
  };
  info.findFlows = [code, summary = info.summary] {
    return findFlows(code->module->lookupSymbol<KernelOp>(code->name), summary);
  };
  info.makeChecked = [this, code](runtime::CheckedKernel &checked) {
    return compileChecked(*code, checked);
  };
  info.planAdjoint = [this, code](runtime::Kernel &runtimeKernel,
                                  runtime::AdjointPlan &plan) {
    return planAdjoint(*code, runtimeKernel, plan);
  };
  info.makeTangent = [this, code](runtime::KernelPtr &tangent) {
    return compileTangent(*code, CompileRequest::Goal::Primal, tangent);
  };
  code->resultSlots = info.resultSlots;
  code->module = std::move(module);
  runtime::KernelPtr kernel = rt->createKernel(std::move(info));
  return std::make_pair(std::move(code), std::move(kernel));
}

/// True if a reverse sweep may launch the adjoint: the kernel reads a field
/// that has one, and changes such a field.
static bool carriesGradients(const runtime::Kernel &kernel) {
  bool reads = kernel.callerAdjoints().hasTargets;
  bool changes = kernel.callerAdjoints().hasSources();
  for (const runtime::Access &access : kernel.summary())
    if (access.field->adjoint())
      (access.kind == runtime::AccessKind::Read ? reads : changes) = true;
  return reads && changes;
}

LogicalResult Session::compileEagerly(runtime::Kernel &kernel) {
  runtime::Kernel *adjoint = nullptr;
  runtime::Status status = kernel.resolve();
  if (!status.ok())
    return fail(status);
  // That there is no gradient is an error for those who ask for it.
  if (carriesGradients(kernel))
    (void)kernel.resolveAdjoint(adjoint);
  return success();
}

FailureOr<SessionKernel *> Session::createKernel(OwningOpRef<ModuleOp> module,
                                                 StringRef name) {
  auto made = makeKernel(std::move(module), name);
  if (failed(made))
    return failure();
  kernels.push_back({std::move(made->first), std::move(made->second)});
  SessionKernel &kernel = kernels.back();
  kernel.place = std::prev(kernels.end());
  rt->skipCounters().bump(SkipCount::KernelsDefined);
  if (!rt->skips(Skip::LazyCompilation) &&
      failed(compileEagerly(*kernel.kernel)))
    return failure();
  return &kernel;
}

FailureOr<SessionKernel *> Session::parseKernel(StringRef bytes, StringRef file,
                                                StringRef name) {
  OwningOpRef<ModuleOp> module;
  {
    DiagnosticCollector collector(context.get());
    // Verified once it has the declarations that it refers to.
    ParserConfig config(context.get(), /*verifyAfterParse=*/false);
    module = readModule(bytes, config, file);
    if (!module)
      return fail(
          collector.take(FailureKind::Syntax, "the kernel does not parse"));
  }
  return createKernel(std::move(module), name);
}

KernelCode::~KernelCode() {
  if (ahead)
    background.cancel(*ahead);
  for (const Compiler::Function &function : functions)
    compiler.unload(function);
  names.drop(name);
}

void Session::destroyKernel(SessionKernel *kernel) {
  rt->running().waitForVisits();
  kernels.erase(kernel->place);
}

SessionKernel *Session::findKernel(StringRef name) {
  for (SessionKernel &kernel : kernels)
    if (kernel.code->name == name)
      return &kernel;
  return nullptr;
}

/// The trees that compiled code wants, in its order. They are those that the
/// kernel was made for, even if others have taken their names since.
static std::vector<runtime::TreePtr> findTrees(const KernelCode &code,
                                               ArrayRef<std::string> names) {
  std::vector<runtime::TreePtr> trees;
  for (const std::string &name : names)
    trees.push_back(*llvm::find_if(
        code.trees, [&](const auto &tree) { return tree->name() == name; }));
  return trees;
}

static std::vector<runtime::LoopLevel>
getLoopLevels(const Compiler::Function &function) {
  std::vector<runtime::LoopLevel> levels;
  for (size_t i = 0; i + 1 < function.loopLevels.size(); i += 2)
    levels.push_back({function.loopLevels[i], function.loopLevels[i + 1]});
  return levels;
}

void Session::printStages(KernelCode &code, CompileRequest::Goal goal,
                          bool forward) {
  bool isAdjoint = goal != CompileRequest::Goal::Primal;
  for (const std::string &stage : printedStages) {
    if ((isAdjoint || forward) && stage == "tai")
      continue;
    // The primal is compiled without differentiation.
    if (!isAdjoint && !forward && stage == "autodiff")
      continue;
    if (!code.options.device && Compiler::isDeviceStage(stage))
      continue;
    Failure failure;
    std::optional<std::string> text = compiler->print(
        {*code.module, code.name, goal, forward}, stage, code.options, failure);
    std::lock_guard<std::mutex> lock(mutex);
    llvm::errs() << "// -----// " << stage << " of "
                 << (forward ? "the tangent of " : "")
                 << (isAdjoint ? "the adjoint of " : "") << code.name
                 << " //----- //\n"
                 << (text ? *text : failure.text) << "\n";
  }
}

static StringRef getGoalName(CompileRequest::Goal goal) {
  switch (goal) {
  case CompileRequest::Goal::Primal:
    return "primal";
  case CompileRequest::Goal::Adjoint:
  case CompileRequest::Goal::StoredAdjoint:
    return "adjoint";
  case CompileRequest::Goal::TakingAdjoint:
  case CompileRequest::Goal::StoredTakingAdjoint:
    return "taking";
  }
  llvm_unreachable("unknown goal");
}

void Session::printProfile(StringRef name, CompileRequest::Goal goal,
                           const Compiler::Function &function) {
  std::lock_guard<std::mutex> lock(mutex);
  llvm::errs() << llvm::formatv("{0,-32} {1,-8} {2,-5}", name,
                                getGoalName(goal),
                                function.fromCache ? "hit" : "miss");
  for (unsigned i = 0; i < kNumPhases; ++i)
    llvm::errs() << llvm::formatv(" {0} {1,7:F2} ms",
                                  stringifyPhase(static_cast<Phase>(i)),
                                  function.times[i] * 1e3);
  llvm::errs() << "\n";
}

template <typename Result>
std::optional<Result>
Session::runAside(KernelCode &code,
                  std::function<std::optional<Result>(Failure &)> step,
                  Failure &failure) {
  if (runtime::safepoint::isWorker())
    return step(failure);
  struct State {
    std::optional<Result> result;
    Failure failure;
  };
  auto state = std::make_shared<State>();
  bool ended = background.runAside(
      [state, step = std::move(step), kept = code.shared_from_this()] {
        state->result = step(state->failure);
      });
  if (!ended) {
    failure =
        Failure::get(FailureKind::Runtime, "interrupted while '" + code.name +
                                               "' was being compiled");
    return std::nullopt;
  }
  if (!state->result)
    failure = std::move(state->failure);
  return std::move(state->result);
}

/// Where the caller was interrupted, nobody else hears of the function.
std::optional<Compiler::Function>
Session::keepFunction(KernelCode &code,
                      std::optional<Compiler::Function> function) {
  std::lock_guard<std::mutex> lock(mutex);
  if (function)
    code.functions.push_back(*function);
  return function;
}

std::optional<Compiler::Function> Session::compileAs(KernelCode &code,
                                                     CompileRequest::Goal goal,
                                                     Failure &failure,
                                                     bool forward) {
  if (!printedStages.empty())
    printStages(code, goal, forward);
  auto function = runAside<Compiler::Function>(
      code,
      [this, &code, goal, forward](Failure &failure) {
        return keepFunction(
            code, compiler->compile({*code.module, code.name, goal, forward},
                                    code.options, failure));
      },
      failure);
  if (!function)
    return std::nullopt;
  if (printsProfile)
    printProfile(code.name, goal, *function);
  if (!forward)
    count(*function, goal != CompileRequest::Goal::Primal);
  return function;
}

void Session::count(const Compiler::Function &function, bool isAdjoint) {
  SkipCounters &counters = rt->skipCounters();
  counters.add(function.skipped);
  if (function.address)
    counters.add(isAdjoint ? SkipCount::AdjointsCompiled
                           : SkipCount::KernelsCompiled);
}

/// True if the kernel may store elements that it reads, or elements of which
/// only its code knows which they are: then the adjoint must always take,
/// whatever the launches before it have done.
static bool alwaysTakes(const std::vector<runtime::Access> &summary) {
  using Kind = runtime::AccessKind;
  auto areApart = [](const runtime::Access &a, const runtime::Access &b) {
    return a.fixed && b.fixed && a.fixed->dimension == b.fixed->dimension &&
           a.fixed->terms == b.fixed->terms &&
           a.fixed->constant != b.fixed->constant;
  };
  for (const runtime::Access &store : summary) {
    if (store.kind != Kind::Write || !store.field->adjoint())
      continue;
    if (!store.boxes)
      return true;
    for (const runtime::Access &read : summary)
      if (read.kind == Kind::Read && store.field == read.field &&
          !areApart(store, read))
        return true;
  }
  return false;
}

/// Most launches store what no other one stores.
static CompileRequest::Goal getPlannedGoal(const KernelCode &code) {
  return CompileRequest::getAdjointGoal(code.planTakes, /*stored=*/true);
}

LogicalResult Session::prepareAdjoint(KernelCode &code, Failure &failure,
                                      bool claims) {
  if (code.prepared)
    return success();
  CompileRequest::Goal goal = getPlannedGoal(code);
  code.prepared = runAside<Compiler::Prepared>(
      code,
      [this, &code, goal, claims](Failure &failure) {
        return compiler->prepare({*code.module, code.name, goal}, code.options,
                                 failure, claims);
      },
      failure);
  if (!code.prepared)
    return mlir::failure();
  code.needs = code.prepared->needs;
  return success();
}

std::optional<Compiler::Function> Session::compileAdjoint(KernelCode &code,
                                                          Failure &failure) {
  CompileRequest::Goal goal = getPlannedGoal(code);
  // Shared, since the next step may outlive this function.
  auto prepared = std::make_shared<std::optional<Compiler::Prepared>>();
  {
    // Who plans the tape waits for this step, but not for the next.
    std::lock_guard<std::mutex> lock(code.prepareMutex);
    if (failed(prepareAdjoint(code, failure, /*claims=*/true)))
      return std::nullopt;
    *prepared = std::move(code.prepared);
    code.prepared.reset();
  }
  if (!printedStages.empty())
    printStages(code, goal);
  auto function = runAside<Compiler::Function>(
      code,
      [this, &code, goal, prepared](Failure &failure) {
        return keepFunction(code,
                            compiler->finish(std::move(**prepared),
                                             {*code.module, code.name, goal},
                                             code.options, failure));
      },
      failure);
  if (!function)
    return std::nullopt;
  if (printsProfile)
    printProfile(code.name, goal, *function);
  count(*function, /*isAdjoint=*/true);
  return function;
}

/// Decides, once, which form of the adjoint a tape launches for all we know.
static void choosePlannedForm(KernelCode &code, runtime::Kernel &kernel) {
  std::lock_guard<std::mutex> lock(code.prepareMutex);
  if (code.needs || code.ahead)
    return;
  // One that came with the kernel is what it is.
  auto op = code.module->lookupSymbol<KernelOp>(code.name);
  code.planTakes = !op.getAdjoint() && alwaysTakes(kernel.summary());
}

runtime::Status Session::compilePrimal(KernelCode &code,
                                       runtime::Kernel &runtimeKernel,
                                       TaiKernelFn &function) {
  // A launch under a tape: the adjoint will be wanted soon, and has its own
  // core while this one goes on with the forward pass.
  choosePlannedForm(code, runtimeKernel);
  if (rt->recordingTape() && !code.ahead && carriesGradients(runtimeKernel))
    code.ahead = background.start([this, &code] {
      code.aheadResult = compileAdjoint(code, code.aheadFailure);
    });
  Failure failure;
  auto compiled = compileAs(code, CompileRequest::Goal::Primal, failure);
  if (!compiled)
    return keepFailure(std::move(failure));
  runtimeKernel.setTrees(findTrees(code, compiled->trees));
  runtimeKernel.setLoopLevels(getLoopLevels(*compiled));
  runtimeKernel.setDeviceImage(compiled->image);
  function = reinterpret_cast<TaiKernelFn>(compiled->address);
  return runtime::Status::success();
}

/// A kernel that is launched with the arguments of the one it was made from.
static runtime::KernelInfo getHelperInfo(KernelCode &code,
                                         const Compiler::Function &compiled,
                                         CompileRequest::Goal goal,
                                         bool forward, StringRef suffix) {
  runtime::KernelInfo info;
  info.name = code.name + suffix.str();
  info.place = code.place;
  info.argSlots = code.argSlots;
  info.trees = findTrees(code, compiled.trees);
  info.loopLevels = getLoopLevels(compiled);
  info.image = compiled.image;
  info.explainRefusal = explainRefusal(code, goal, forward);
  info.function = reinterpret_cast<TaiKernelFn>(compiled.address);
  return info;
}

/// Whether the form of the adjoint that loads what the kernel has stored reads
/// no more than a tape was told, if it is there at all.
bool Session::canReadStored(KernelCode &code, CompileRequest::Goal goal,
                            const AdjointNeeds &told) {
  Failure failure;
  auto prepared =
      compiler->prepare({*code.module, code.name, goal}, code.options, failure);
  auto needs = prepared ? AdjointNeeds::deserialize(prepared->needs)
                        : std::optional<AdjointNeeds>();
  return told.loadsStored && needs && needs->loadsStored &&
         llvm::all_of(needs->stored, [&](const NamedAccess &access) {
           return llvm::is_contained(told.stored, access) ||
                  llvm::is_contained(told.reads, access);
         });
}

runtime::Status Session::compileAdjoint(KernelCode &code,
                                        runtime::Kernel &runtimeKernel,
                                        bool takes, bool stored,
                                        runtime::KernelPtr &adjoint) {
  Failure failure;
  std::optional<Compiler::Function> compiled;
  choosePlannedForm(code, runtimeKernel);
  if (code.ahead && !background.finish(*code.ahead))
    return keepFailure(Failure::get(FailureKind::Runtime,
                                    "interrupted while the gradient of '" +
                                        code.name + "' was being compiled"));
  std::optional<AdjointNeeds> needs;
  {
    std::lock_guard<std::mutex> lock(code.prepareMutex);
    if (code.needs)
      needs = AdjointNeeds::deserialize(*code.needs);
  }
  // What was begun before anybody asked loads what is stored, if it can. That a
  // gradient is launched by hand is seen too late for that.
  bool isPlanned =
      takes == code.planTakes &&
      (needs ? stored == needs->loadsStored : code.ahead != nullptr);
  auto goal = CompileRequest::getAdjointGoal(takes, stored);
  if (!isPlanned) {
    if (stored && !(needs && canReadStored(code, goal, *needs)))
      return runtime::Status::success();
    compiled = compileAs(code, goal, failure);
  } else if (code.ahead) {
    compiled = std::move(code.aheadResult);
    failure = std::move(code.aheadFailure);
    code.ahead.reset();
  } else {
    compiled = compileAdjoint(code, failure);
  }
  if (!compiled)
    return keepFailure(std::move(failure));
  if (!compiled->address)
    return runtime::Status::success();
  runtime::KernelInfo info = getHelperInfo(code, *compiled, goal,
                                           /*forward=*/false, "_grad");
  // What is stored need not have a dual: tangents come from what it was
  // computed from.
  auto plain = CompileRequest::getAdjointGoal(takes, /*stored=*/false);
  info.makeTangent = [this, &code, plain](runtime::KernelPtr &tangent) {
    return compileTangent(code, plain, tangent);
  };
  adjoint = rt->createKernel(std::move(info));
  return runtime::Status::success();
}

runtime::Status Session::compileTangent(KernelCode &code,
                                        CompileRequest::Goal goal,
                                        runtime::KernelPtr &tangent) {
  auto fields = code.module->getOps<FieldOp>();
  if (llvm::none_of(fields, [](FieldOp field) { return field.getDual(); }))
    return runtime::Status::success();
  Failure failure;
  auto compiled = compileAs(code, goal, failure, /*forward=*/true);
  if (!compiled)
    return keepFailure(std::move(failure));
  if (!compiled->address)
    return runtime::Status::success();
  runtime::KernelInfo info = getHelperInfo(
      code, *compiled, goal, /*forward=*/true,
      goal == CompileRequest::Goal::Primal ? "_fwd" : "_grad_fwd");
  if (goal == CompileRequest::Goal::Primal)
    info.resultSlots = code.resultSlots;
  tangent = rt->createKernel(std::move(info));
  return runtime::Status::success();
}

runtime::Status Session::planAdjoint(KernelCode &code,
                                     runtime::Kernel &runtimeKernel,
                                     runtime::AdjointPlan &plan) {
  // Most kernels need no look at their adjoints. Arrays and results are among
  // what a gradient may come from.
  bool reads = !runtimeKernel.arrays().empty();
  bool changes = runtimeKernel.callerAdjoints().hasSources();
  for (const runtime::Access &access : runtimeKernel.summary()) {
    if (access.kind == runtime::AccessKind::Read)
      reads = true;
    else if (access.field->adjoint())
      changes = true;
  }
  if (!reads || !changes) {
    plan.provisional = !changes;
    return runtime::Status::success();
  }
  choosePlannedForm(code, runtimeKernel);
  plan.takes = code.planTakes;
  std::optional<AdjointNeeds> needs;
  {
    std::lock_guard<std::mutex> lock(code.prepareMutex);
    Failure failure;
    // It may take long until the code itself is asked for.
    if (!code.needs && failed(prepareAdjoint(code, failure, /*claims=*/false)))
      return keepFailure(std::move(failure));
    needs = AdjointNeeds::deserialize(*code.needs);
  }
  // The fields that the kernel was made for, even if others have their names
  // by now.
  auto findField = [&](const std::string &name) {
    for (const runtime::Access &access : runtimeKernel.summary())
      if (access.field->name() == name)
        return access.field;
    return code.fields.lookup(name);
  };
  for (const NamedAccess &access : needs->reads)
    if (runtime::FieldPtr field = findField(access.field))
      plan.reads.push_back({field, access.kind, access.fixed});
  plan.loadsStored = needs->loadsStored;
  for (const NamedAccess &access : needs->stored) {
    runtime::FieldPtr field = findField(access.field);
    // No tape watches what is written to gradients.
    if (field && !field->isAdjoint())
      plan.stored.push_back({field, access.kind, access.fixed});
    else
      plan.loadsStored = false;
  }
  for (const std::string &name : needs->before)
    if (runtime::FieldPtr field = findField(name))
      plan.before.push_back(field);
  for (const std::string &name : needs->activity)
    if (runtime::FieldPtr field = findField(name))
      plan.activity.push_back(field);
  for (const LoopFlags &loop : needs->flags) {
    runtime::AdjointFlags flags{findField(loop.field), {}, loop.sumsUp};
    for (const std::string &name : loop.sources)
      flags.sources.push_back(findField(name));
    if (flags.loop)
      plan.flags.push_back(std::move(flags));
  }
  plan.arrays = needs->arrays;
  plan.reruns = needs->reruns;
  if (needs->parts.empty())
    return runtime::Status::success();
  ParserConfig config(context.get());
  OwningOpRef<ModuleOp> parts = readModule(needs->parts, config, code.name);
  if (!parts)
    return runtime::Status::failure(runtime::StatusCode::Internal,
                                    "the parts of '" + code.name +
                                        "' do not parse");
  for (auto &[name, module] : splitParts(*parts)) {
    auto made = makeKernel(std::move(module), name);
    if (failed(made))
      return keepFailure(getFailure());
    plan.parts.push_back(std::move(made->second));
  }
  return runtime::Status::success();
}

//===----------------------------------------------------------------------===//
// Running
//===----------------------------------------------------------------------===//

LogicalResult Session::launchAdjoint(SessionKernel &kernel,
                                     const uint64_t *args, int64_t slots) {
  return check(rt->launchAdjoint(*kernel.kernel, args, slots));
}

LogicalResult Session::compile(ArrayRef<SessionKernel *> kernels,
                               bool adjoints) {
  // All primals first: the adjoint of a kernel waits for its primal.
  size_t count = kernels.size() * (adjoints ? 2 : 1);
  std::vector<runtime::Status> statuses(count);
  runInParallel(count, [&](size_t i) -> const runtime::Status & {
    runtime::Kernel &kernel = *kernels[i % kernels.size()]->kernel;
    runtime::Kernel *adjoint = nullptr;
    return statuses[i] = i < kernels.size() ? kernel.resolve()
                                            : kernel.resolveAdjoint(adjoint);
  });
  for (const runtime::Status &status : statuses)
    if (!status.ok())
      return fail(status);
  return success();
}

LogicalResult Session::prepareReverse(runtime::Tape &tape, bool cleared) {
  std::vector<runtime::Tape::Pending> needed = tape.pendingAdjoints(cleared);
  if (needed.size() < 2)
    return success();
  std::vector<runtime::Status> statuses(needed.size());
  runInParallel(needed.size(), [&](size_t i) -> const runtime::Status & {
    return statuses[i] = needed[i].resolve();
  });
  for (const runtime::Status &status : statuses)
    if (!status.ok())
      return fail(status);
  return success();
}

/// Leaves nothing of the kernels but their signatures: the host reaches them
/// through the runtime.
static void stubKernels(ModuleOp module) {
  for (KernelOp kernel : module.getOps<KernelOp>()) {
    kernel.removeAdjointAttr();
    Block &block = kernel.getBody().front();
    block.dropAllReferences();
    block.getOperations().clear();
    OpBuilder builder = OpBuilder::atBlockEnd(&block);
    SmallVector<Value> zeros;
    for (Type type : kernel.getResultTypes())
      zeros.push_back(arith::ConstantOp::create(
          builder, kernel.getLoc(),
          cast<TypedAttr>(builder.getZeroAttr(type))));
    ReturnOp::create(builder, kernel.getLoc(), zeros);
  }
}

/// Drops what has nothing to do with tai or with the program `entry`.
static void keepReachable(ModuleOp module, StringRef entry) {
  llvm::SetVector<Operation *> needed = collectOwn(module, entry);
  for (size_t i = 0; i < needed.size(); ++i)
    needed[i]->walk([&](Operation *op) {
      op->getAttrDictionary().walk([&](SymbolRefAttr symbol) {
        if (Operation *named = module.lookupSymbol(symbol.getRootReference()))
          needed.insert(named);
      });
    });
  for (Operation &op : llvm::make_early_inc_range(*module.getBody()))
    if (!needed.contains(&op))
      op.erase();
}

/// Whether a host function names a field other than for a launch or a tape.
static bool usesFields(ModuleOp module) {
  SymbolTable symbols(module);
  bool found = false;
  for (func::FuncOp function : module.getOps<func::FuncOp>())
    function.walk([&](Operation *op) {
      if (isa<LaunchOp, TapeOp, CheckGradientOp>(op))
        return;
      op->getAttrDictionary().walk([&](SymbolRefAttr name) {
        found |= isa_and_nonnull<FieldOp, TreeOp>(
            symbols.lookup(name.getRootReference()));
      });
    });
  return found;
}

LogicalResult Session::runHost(ModuleOp module, StringRef name) {
  OwningOpRef<ModuleOp> host = module.clone();
  keepReachable(*host, name);
  stubKernels(*host);
  Failure failure;
  // The program itself runs on the CPU wherever its kernels do.
  CompileOptions hostOptions = options;
  hostOptions.device = std::nullopt;
  hostOptions.deviceTarget.clear();
  auto compiled = compiler->compile({*host, name, CompileRequest::Goal::Primal},
                                    hostOptions, failure);
  if (!compiled)
    return fail(std::move(failure));
  if (printsProfile)
    printProfile(name, CompileRequest::Goal::Primal, *compiled);
  runtime::HostModule hostModule;
  hostModule.usesTrees = usesFields(module);
  hostModule.findKernel = [this](std::string_view kernelName) {
    SessionKernel *kernel = findKernel(kernelName);
    return kernel ? kernel->kernel.get() : nullptr;
  };
  std::vector<runtime::TreePtr> trees;
  for (const std::string &tree : compiled->trees)
    trees.push_back(rt->findTree(tree));
  LogicalResult result =
      check(rt->runHost(reinterpret_cast<TaiKernelFn>(compiled->address), trees,
                        hostModule, nullptr, nullptr));
  compiler->unload(*compiled);
  return result;
}

FailureOr<std::string> Session::getIR(SessionKernel &kernel, StringRef stage) {
  if (stage == "explain")
    return explain(kernel);
  Failure failure;
  bool forward = stage.consume_front("tangent.");
  CompileRequest::Goal goal = stage.consume_front("adjoint.")
                                  ? CompileRequest::Goal::Adjoint
                                  : CompileRequest::Goal::Primal;
  std::optional<std::string> text =
      compiler->print({*kernel.code->module, kernel.code->name, goal, forward},
                      stage, kernel.code->options, failure);
  if (!text)
    return fail(std::move(failure));
  return *text;
}
