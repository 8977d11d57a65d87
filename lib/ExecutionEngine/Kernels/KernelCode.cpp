//===- KernelCode.cpp - The compiler side of a kernel ---------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/ExecutionEngine/Kernels/KernelCode.h"
#include "tai/Analysis/ToBeRecorded.h"
#include "tai/ExecutionEngine/Kernels/Summaries.h"
#include "tai/ExecutionEngine/Modules/ModuleFile.h"
#include "tai/Runtime/Host/Recorder.h"
#include "tai/Runtime/Threads/Safepoint.h"

using namespace mlir;
using namespace mlir::tai;
using Goal = CompileRequest::Goal;

KernelCode::KernelCode(const KernelServices &services, Source source)
    : services(services), source(std::move(source)) {
  services.names.add(getName());
}

KernelCode::~KernelCode() {
  if (ahead)
    services.background.cancel(*ahead);
  for (const Compiler::Function &function : functions)
    services.compiler.unload(function);
  services.names.drop(getName());
}

KernelOp KernelCode::getKernel() const {
  return getModule().lookupSymbol<KernelOp>(source.name);
}

CompileRequest KernelCode::getRequest(Goal goal, bool forward) const {
  return {getModule(), source.name, goal, forward};
}

bool mlir::tai::carriesGradients(const runtime::Kernel &kernel) {
  bool reads = kernel.callerAdjoints().hasTargets;
  bool changes = kernel.callerAdjoints().hasSources();
  for (const runtime::Access &access : kernel.summary())
    if (access.field->adjoint())
      (access.kind == runtime::AccessKind::Read ? reads : changes) = true;
  return reads && changes;
}

/// The trees that compiled code uses, in its order: the trees that existed when
/// the kernel was created, even if other trees have taken their names since.
std::vector<runtime::TreePtr>
KernelCode::findTrees(ArrayRef<std::string> names) const {
  std::vector<runtime::TreePtr> trees;
  for (const std::string &name : names)
    trees.push_back(*llvm::find_if(
        source.trees, [&](const auto &tree) { return tree->name() == name; }));
  return trees;
}

static std::vector<runtime::LoopLevel>
getLoopLevels(const Compiler::Function &function) {
  std::vector<runtime::LoopLevel> levels;
  for (size_t i = 0; i + 1 < function.loopLevels.size(); i += 2)
    levels.push_back({function.loopLevels[i], function.loopLevels[i + 1]});
  return levels;
}

template <typename Result>
std::optional<Result>
KernelCode::runAside(std::function<std::optional<Result>(Failure &)> step,
                     Failure &failure) {
  if (runtime::safepoint::isWorker())
    return step(failure);
  struct State {
    std::optional<Result> result;
    Failure failure;
  };
  auto state = std::make_shared<State>();
  bool ended = services.background.runAside(
      [state, step = std::move(step), kept = shared_from_this()] {
        state->result = step(state->failure);
      });
  if (!ended) {
    failure =
        Failure::get(FailureKind::Runtime, "interrupted while '" + getName() +
                                               "' was being compiled");
    return std::nullopt;
  }
  if (!state->result)
    failure = std::move(state->failure);
  return std::move(state->result);
}

/// Keeps a compiled function alive with the kernel, even if the caller was
/// interrupted and does not get it.
std::optional<Compiler::Function>
KernelCode::keepFunction(std::optional<Compiler::Function> function) {
  std::lock_guard<std::mutex> lock(functionsMutex);
  if (function)
    functions.push_back(*function);
  return function;
}

std::optional<Compiler::Function>
KernelCode::compileAs(Goal goal, Failure &failure, bool forward) {
  services.reports.printStages(services.compiler, getRequest(goal, forward),
                               getOptions());
  auto function = runAside<Compiler::Function>(
      [this, goal, forward](Failure &failure) {
        return keepFunction(services.compiler.compile(getRequest(goal, forward),
                                                      getOptions(), failure));
      },
      failure);
  if (!function)
    return std::nullopt;
  services.reports.printProfile(getName(), goal, *function);
  services.warnings.tell(function->warnings, forward || goal != Goal::Primal);
  if (!forward)
    count(*function, goal != Goal::Primal);
  return function;
}

void KernelCode::count(const Compiler::Function &function, bool isAdjoint) {
  SkipCounters &counters = services.rt.skipCounters();
  counters.add(function.skipped);
  if (function.address)
    counters.add(isAdjoint ? SkipCount::AdjointsCompiled
                           : SkipCount::KernelsCompiled);
}

/// True if the kernel may store to elements that it reads, or to elements that
/// only its code determines. The adjoint must then always set the adjoints of
/// stored elements to zero, whichever launches came before.
static bool alwaysZeroes(const std::vector<runtime::Access> &summary) {
  using Kind = runtime::AccessKind;
  auto areApart = [](const runtime::Access &a, const runtime::Access &b) {
    return llvm::any_of(a.fixed, [&](const runtime::FixedIndex &index) {
      return llvm::any_of(b.fixed, [&](const runtime::FixedIndex &other) {
        return index.isApart(other);
      });
    });
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

Goal KernelCode::getTapeGoal(const runtime::Kernel &kernel) const {
  bool zeroes = !getKernel().getAdjoint() && alwaysZeroes(kernel.summary());
  return CompileRequest::getAdjointGoal(zeroes, /*stored=*/true);
}

LogicalResult KernelCode::prepareAdjoint(Failure &failure, bool claims) {
  if (prepared)
    return success();
  Goal goal = getPlannedGoal();
  prepared = runAside<Compiler::Prepared>(
      [this, goal, claims](Failure &failure) {
        return services.compiler.prepare(getRequest(goal), getOptions(),
                                         failure, claims);
      },
      failure);
  if (!prepared)
    return mlir::failure();
  toBeRecorded = prepared->toBeRecorded;
  return success();
}

std::optional<Compiler::Function>
KernelCode::compilePlannedAdjoint(Failure &failure) {
  Goal goal = getPlannedGoal();
  // The prepared adjoint is shared with the task, which may outlive this
  // function.
  auto first = std::make_shared<std::optional<Compiler::Prepared>>();
  {
    // A thread that plans the tape waits for this preparation, but not for the
    // code.
    PrepareLock lock(prepareMutex);
    if (failed(prepareAdjoint(failure, /*claims=*/true)))
      return std::nullopt;
    *first = std::move(prepared);
    prepared.reset();
  }
  services.reports.printStages(services.compiler, getRequest(goal),
                               getOptions());
  auto function = runAside<Compiler::Function>(
      [this, goal, first](Failure &failure) {
        return keepFunction(services.compiler.finish(
            std::move(**first), getRequest(goal), getOptions(), failure));
      },
      failure);
  if (!function)
    return std::nullopt;
  services.reports.printProfile(getName(), goal, *function);
  services.warnings.tell(function->warnings, /*isOfGradient=*/true);
  count(*function, /*isAdjoint=*/true);
  return function;
}

/// True if the kernel stores to a field that has an adjoint.
static bool overwritesGradients(const std::vector<runtime::Access> &summary) {
  return llvm::any_of(summary, [](const runtime::Access &access) {
    return access.kind == runtime::AccessKind::Write && access.field->adjoint();
  });
}

/// Decides, once, which form of the adjoint a tape will probably launch.
void KernelCode::choosePlannedForm(const runtime::Kernel &kernel) {
  PrepareLock lock(prepareMutex);
  if (toBeRecorded || ahead)
    return;
  // A launch while the tape is suspended belongs to a custom gradient, which
  // launches the adjoint by hand: in the form that sets adjoints to zero and
  // does not load stored values (see Launcher::launchAdjoint).
  const runtime::Recorder *tape = services.rt.recordings().current();
  bool isByHand = tape && tape->isSuspended();
  planLoadsStored = !isByHand;
  // The adjoint that a user has written has no form that sets more adjoints to
  // zero.
  planZeroes = !getKernel().getAdjoint() &&
               (alwaysZeroes(kernel.summary()) ||
                (isByHand && overwritesGradients(kernel.summary())));
}

runtime::Status KernelCode::compile(runtime::Kernel &kernel,
                                    TaiKernelFn &function) {
  // Under a tape, the adjoint will soon be needed, so it is compiled on another
  // core, while this thread goes on with the forward pass.
  choosePlannedForm(kernel);
  if (services.rt.recordings().current() && !ahead && carriesGradients(kernel))
    ahead = services.background.start(
        [this] { aheadResult = compilePlannedAdjoint(aheadFailure); });
  Failure failure;
  auto compiled = compileAs(Goal::Primal, failure);
  if (!compiled)
    return services.failures.keep(std::move(failure));
  kernel.setTrees(findTrees(compiled->trees));
  kernel.setLoopLevels(getLoopLevels(*compiled));
  kernel.setDeviceImage(compiled->image);
  function = reinterpret_cast<TaiKernelFn>(compiled->address);
  return runtime::Status::success();
}

//===----------------------------------------------------------------------===//
// Forms of the kernel
//===----------------------------------------------------------------------===//

namespace {
/// Provides the code of variants of a kernel (its adjoints and tangents), which
/// are launched with the arguments of their primal. The primal usually outlives
/// them.
class FormProvider final : public runtime::KernelProvider {
public:
  FormProvider(std::weak_ptr<KernelCode> code, Goal goal, bool forward)
      : code(std::move(code)), goal(goal), forward(forward) {}

  runtime::Status makeTangent(runtime::KernelPtr &tangent) override {
    std::shared_ptr<KernelCode> primal = code.lock();
    if (!primal || forward)
      return runtime::Status::success();
    // A stored value may have no dual, so tangents are computed from the
    // operands of the store's value.
    return primal->makeTangentOf(
        CompileRequest::getAdjointGoal(CompileRequest::zeroes(goal),
                                       /*stored=*/false),
        tangent);
  }
  std::string explainRefusal(const std::string &reason) override {
    std::shared_ptr<KernelCode> primal = code.lock();
    return primal ? primal->explainRefusalOf(goal, forward, reason) : reason;
  }

private:
  std::weak_ptr<KernelCode> code;
  Goal goal;
  bool forward;
};
} // namespace

runtime::KernelInfo KernelCode::getFormInfo(const Compiler::Function &compiled,
                                            Goal goal, bool forward,
                                            StringRef suffix) {
  runtime::KernelInfo info;
  info.name = getName() + suffix.str();
  info.place = source.place;
  info.argSlots = source.argSlots;
  info.trees = findTrees(compiled.trees);
  info.loopLevels = getLoopLevels(compiled);
  info.storesFirst = compiled.storesFirst;
  info.image = compiled.image;
  info.provider =
      std::make_shared<FormProvider>(weak_from_this(), goal, forward);
  info.function = reinterpret_cast<TaiKernelFn>(compiled.address);
  return info;
}

std::string KernelCode::explainRefusal(const std::string &reason) {
  return explainRefusalOf(Goal::Primal, /*forward=*/false, reason);
}

std::string KernelCode::explainRefusalOf(Goal goal, bool forward,
                                         const std::string &reason) {
  Failure failure = Failure::get(FailureKind::Internal, reason);
  services.compiler.addReproducer(getRequest(goal, forward), getOptions(),
                                  failure);
  return failure.message;
}

/// True if the variant of the adjoint that loads stored values exists, and
/// makes no reads that the tape was not told about.
bool KernelCode::canReadStored(Goal goal, const ToBeRecorded &told) {
  Failure failure;
  auto first =
      services.compiler.prepare(getRequest(goal), getOptions(), failure);
  auto here = first ? ToBeRecorded::deserialize(first->toBeRecorded)
                    : std::optional<ToBeRecorded>();
  return told.loadsStored && here && here->loadsStored &&
         llvm::all_of(here->stored, [&](const NamedAccess &access) {
           return llvm::is_contained(told.stored, access) ||
                  llvm::is_contained(told.reads, access);
         });
}

runtime::Status KernelCode::makeAdjoint(runtime::Kernel &kernel,
                                        runtime::AdjointVariant variant,
                                        runtime::KernelPtr &adjoint) {
  Failure failure;
  std::optional<Compiler::Function> compiled;
  choosePlannedForm(kernel);
  if (ahead && !services.background.finish(*ahead))
    return services.failures.keep(Failure::get(
        FailureKind::Runtime, "interrupted while the gradient of '" +
                                  getName() + "' was being compiled"));
  std::optional<ToBeRecorded> told;
  {
    PrepareLock lock(prepareMutex);
    if (toBeRecorded)
      told = ToBeRecorded::deserialize(*toBeRecorded);
  }
  // A compilation that was started ahead loads stored values if possible,
  // unless the gradient is expected to be launched by hand.
  bool isPlanned =
      variant.zeroes == planZeroes &&
      (told ? variant.readsStored == (planLoadsStored && told->loadsStored)
            : ahead != nullptr);
  Goal goal =
      CompileRequest::getAdjointGoal(variant.zeroes, variant.readsStored);
  if (!isPlanned) {
    if (variant.readsStored && !(told && canReadStored(goal, *told)))
      return runtime::Status::success();
    compiled = compileAs(goal, failure);
  } else if (ahead) {
    compiled = std::move(aheadResult);
    failure = std::move(aheadFailure);
    ahead.reset();
  } else {
    compiled = compilePlannedAdjoint(failure);
  }
  if (!compiled)
    return services.failures.keep(std::move(failure));
  if (!compiled->address)
    return runtime::Status::success();
  adjoint = services.rt.launcher().kernels().create(
      getFormInfo(*compiled, goal, /*forward=*/false, "_grad"));
  return runtime::Status::success();
}

runtime::Status KernelCode::makeTangent(runtime::KernelPtr &tangent) {
  return makeTangentOf(Goal::Primal, tangent);
}

runtime::Status KernelCode::makeTangentOf(Goal goal,
                                          runtime::KernelPtr &tangent) {
  auto fields = source.module->getOps<FieldOp>();
  if (llvm::none_of(fields, [](FieldOp field) { return field.getDual(); }))
    return runtime::Status::success();
  Failure failure;
  auto compiled = compileAs(goal, failure, /*forward=*/true);
  if (!compiled)
    return services.failures.keep(std::move(failure));
  if (!compiled->address)
    return runtime::Status::success();
  bool isPrimal = goal == Goal::Primal;
  runtime::KernelInfo info = getFormInfo(*compiled, goal, /*forward=*/true,
                                         isPrimal ? "_fwd" : "_grad_fwd");
  if (isPrimal)
    info.resultSlots = source.resultSlots;
  tangent = services.rt.launcher().kernels().create(std::move(info));
  return runtime::Status::success();
}

runtime::KernelFlows KernelCode::findFlows(const runtime::Kernel &kernel) {
  return tai::findFlows(getKernel(), kernel.summary());
}

/// Splits a module of kernels that are parts of one kernel (`part_of`) into one
/// module for each part, in the order in which the parts run.
static SmallVector<std::pair<std::string, OwningOpRef<ModuleOp>>>
splitParts(ModuleOp parts) {
  SmallVector<std::pair<std::string, OwningOpRef<ModuleOp>>> result;
  for (KernelOp part : parts.getOps<KernelOp>()) {
    if (!part.getPartOf())
      continue;
    OwningOpRef<ModuleOp> module = parts.clone();
    for (KernelOp other :
         llvm::make_early_inc_range(module->getOps<KernelOp>()))
      if (other.getSymName() != part.getSymName())
        other.erase();
    // The name of the part's adjoint is dropped, since the form of the adjoint
    // is chosen later.
    auto copy = module->lookupSymbol<KernelOp>(part.getSymName());
    copy.removeAdjointAttr();
    copy.removePartOfAttr();
    result.emplace_back(part.getSymName().str(), std::move(module));
  }
  // "k.10" comes after "k.9".
  auto numberOf = [](StringRef name) {
    unsigned number = 0;
    (void)name.rsplit('.').second.getAsInteger(10, number);
    return number;
  };
  llvm::sort(result, [&](const auto &a, const auto &b) {
    return numberOf(a.first) < numberOf(b.first);
  });
  return result;
}

runtime::Status KernelCode::planAdjoint(runtime::Kernel &kernel,
                                        runtime::AdjointAccesses &plan) {
  // Most kernels cannot carry a gradient, which decides without their adjoints.
  // Arrays and results are possible sources of a gradient.
  bool reads = !kernel.arrays().empty();
  bool changes = kernel.callerAdjoints().hasSources();
  for (const runtime::Access &access : kernel.summary()) {
    if (access.kind == runtime::AccessKind::Read)
      reads = true;
    else if (access.field->adjoint())
      changes = true;
  }
  if (!reads || !changes) {
    plan.provisional = !changes;
    return runtime::Status::success();
  }
  choosePlannedForm(kernel);
  plan.zeroes = planZeroes;
  std::optional<ToBeRecorded> told;
  {
    PrepareLock lock(prepareMutex);
    Failure failure;
    // The adjoint is prepared without generating code: recording a launch needs
    // the plan, and only the reverse sweep needs the code.
    if (!toBeRecorded && failed(prepareAdjoint(failure, /*claims=*/false))) {
      // After an interruption the plan is provisional, and is made again at the
      // next request.
      plan.provisional = failure.kind == FailureKind::Runtime;
      return services.failures.keep(std::move(failure));
    }
    told = ToBeRecorded::deserialize(*toBeRecorded);
  }
  // Finds the fields that existed when the kernel was created, even if other
  // fields have taken their names since.
  auto findField = [&](const std::string &name) {
    for (const runtime::Access &access : kernel.summary())
      if (access.field->name() == name)
        return access.field;
    return source.fields.lookup(name);
  };
  for (const NamedAccess &access : told->reads)
    if (runtime::FieldPtr field = findField(access.field))
      plan.reads.push_back({field, access.kind, access.fixed});
  // A field is watched if it is not a gradient, since a tape does not track
  // writes to gradients.
  auto isWatched = [&](const NamedAccess &access) {
    runtime::FieldPtr field = findField(access.field);
    return field && !field->isAdjoint();
  };
  if (told->loadsStored && llvm::all_of(told->stored, isWatched)) {
    plan.stored.emplace();
    for (const NamedAccess &access : told->stored)
      plan.stored->push_back(
          {findField(access.field), access.kind, access.fixed});
  }
  for (const std::string &name : told->before)
    if (runtime::FieldPtr field = findField(name))
      plan.before.push_back(field);
  for (const std::string &name : told->activity)
    if (runtime::FieldPtr field = findField(name))
      plan.activity.push_back(field);
  for (const LoopFlags &loop : told->flags) {
    runtime::SkippableLoop flags{findField(loop.field), {}};
    for (const std::string &name : loop.sources)
      flags.sources.push_back(findField(name));
    if (flags.loop)
      plan.flags.push_back(std::move(flags));
  }
  plan.arrays = told->arrays;
  plan.reexecutes = told->reexecutes;
  if (told->parts.empty())
    return runtime::Status::success();
  ParserConfig config(source.module->getContext());
  OwningOpRef<ModuleOp> parts = readModule(told->parts, config, getName());
  if (!parts)
    return runtime::Status::failure(runtime::StatusCode::Internal,
                                    "the parts of '" + getName() +
                                        "' do not parse");
  for (auto &[name, module] : splitParts(*parts)) {
    auto made = makeKernel(services, std::move(module), name, getOptions());
    if (failed(made))
      return services.failures.keep(services.failures.getLast());
    plan.parts.push_back(std::move(made->kernel));
  }
  return runtime::Status::success();
}
