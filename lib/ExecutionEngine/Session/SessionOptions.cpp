//===- SessionOptions.cpp - Options of a session --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Dispatches each option of Options.def to a member of the compile options, to
// the runtime, or to a method in this file.
//
//===----------------------------------------------------------------------===//

#include "OptionKinds.h"
#include "mlir/Pass/PassManager.h"
#include "tai/ExecutionEngine/Compile/EmulatedCode.h"
#include "tai/ExecutionEngine/Session/Session.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "tai/Transforms/Passes.h"

#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/Process.h"
#include <dlfcn.h>

using namespace mlir;
using namespace mlir::tai;

void Session::useCache(StringRef folder) {
  keepChoices({});
  if (folder.empty()) {
    cache.reset();
    compiler->setCache({});
    return;
  }
  cache = std::make_shared<runtime::CacheStore>(folder.str());
  if (!cache->usable())
    return compiler->setCache({});
  auto store = cache;
  compiler->setCache(
      {[store](StringRef key) { return store->get(std::string_view(key)); },
       [store](StringRef key, StringRef bytes) {
         store->put(std::string_view(key), std::string_view(bytes));
       },
       [store](StringRef key, const std::function<bool()> &goesOn) {
         constexpr double mostSeconds = 60;
         return store->claim(std::string_view(key), mostSeconds, goesOn);
       }});
  keepChoices({[store](const std::string &key) { return store->get(key); },
               [this, store](std::string key, std::string bytes) {
                 background.doLater(
                     [store, key = std::move(key), bytes = std::move(bytes)] {
                       store->put(key, bytes);
                     });
               }});
}

void Session::keepChoices(runtime::KeptChoices kept) {
  keptChoices = std::move(kept);
  rt->launcher().onDevice().keepBlockSizes(keptChoices);
  if (runtime::DeviceQueue *queue = rt->devices().queue())
    queue->keepChoices(keptChoices);
}

/// True if programs are compiled in the background: on a GPU, where the driver
/// takes seconds to assemble a program. For tests and measurements,
/// TAI_BACKGROUND_PROGRAMS=1 or 0 decides for every device.
static bool compilesProgramsInBackground(runtime::DeviceKind kind) {
  const char *given = std::getenv("TAI_BACKGROUND_PROGRAMS");
  if (given && *given)
    return *given != '0';
  return kind == runtime::DeviceKind::Cuda;
}

namespace {
/// The compilation of a device program on a background thread of the session.
class BackgroundProgram final : public runtime::ProgramJob {
public:
  /// State shared with the background thread, which may outlive the sequence
  /// that the program is for.
  struct State {
    std::atomic<bool> isDone{false}, isAbandoned{false};
    runtime::DeviceImage image;
    runtime::Status status;
  };
  explicit BackgroundProgram(std::shared_ptr<State> state)
      : state(std::move(state)) {}
  ~BackgroundProgram() override { state->isAbandoned = true; }
  bool isDone() const override { return state->isDone; }
  runtime::Status take(runtime::DeviceImage &image) override {
    image = std::move(state->image);
    return std::move(state->status);
  }

private:
  std::shared_ptr<State> state;
};
} // namespace

std::unique_ptr<runtime::ProgramJob>
Session::startProgram(runtime::ProgramPlan plan) {
  auto state = std::make_shared<BackgroundProgram::State>();
  background.start(
      [this, state, plan = std::move(plan), options = compileOptions] {
        if (state->isAbandoned)
          return;
        Failure problem;
        if (auto made = compiler->makeProgram(plan, options, problem))
          state->image = std::move(*made);
        else
          state->status = runtime::Status::failure(runtime::StatusCode::Compile,
                                                   problem.message);
        state->isDone = true;
      });
  return std::make_unique<BackgroundProgram>(std::move(state));
}

static std::string listOptions() {
  std::string names;
#define TAI_OPTION(name, kind, initial, expects, about, to)                    \
  names += names.empty() ? name : ", " name;
#include "tai/Support/Options.def"
  return names;
}

LogicalResult Session::setOption(StringRef name, StringRef value) {
  auto badValue = [&](StringRef expected) {
    return fail(FailureKind::Usage, "option '" + name + "' expects " +
                                        expected + ", but got '" + value + "'");
  };
// A macro for each kind of target that the last column of Options.def names.
#define TAI_SET_Codegen(member)                                                \
  (compileOptions.codegen.member = *parsed, success())
#define TAI_SET_Compile(member) (compileOptions.member = *parsed, success())
#define TAI_SET_Runtime(method) (rt->method(*parsed), success())
#define TAI_SET_Session(method) method(*parsed)
#define TAI_OPTION(spelling, kind, initial, expects, about, to)                \
  if (name == spelling) {                                                      \
    auto parsed = options::kind::parse(value);                                 \
    return parsed ? TAI_SET_##to : badValue(expects);                          \
  }
#include "tai/Support/Options.def"
  return fail(FailureKind::Usage, "unknown option '" + name +
                                      "'; the options are " + listOptions());
}

LogicalResult Session::setModes(const ContextModes &wanted) {
  if (std::string problem = wanted.findContradiction(); !problem.empty())
    return fail(FailureKind::Usage, problem);
  modes = wanted;
  compileOptions.codegen.fastMath = modes.isFast();
  compileOptions.shadow = modes.shadow;
  bool isDeterministic = modes.isDeterministic();
  if (isDeterministic != compileOptions.deterministic) {
    compileOptions.deterministic = isDeterministic;
    rt->setTriesBlocks(!isDeterministic);
  }
  // In these modes products and sums are not fused: another number of threads
  // divides loops differently, and whether an addition is fused may depend on
  // the end of a vectorised loop. Shadow values are computed separately for
  // each operation.
  compileOptions.codegen.contract =
      !isDeterministic && !modes.isStrict() && !modes.shadow;
  return success();
}

static ContextModes with(ContextModes modes, ContextModes::Shorthand option,
                         bool on) {
  modes.shorthands.set(static_cast<unsigned>(option), on);
  return modes;
}

LogicalResult Session::setThreads(int threads) {
  rt->setThreads(threads);
  compileOptions.oneThread = rt->threads() == 1;
  return success();
}

LogicalResult Session::setDeterministic(bool on) {
  return setModes(with(modes, ContextModes::Shorthand::Deterministic, on));
}

LogicalResult Session::setStrict(bool on) {
  return setModes(with(modes, ContextModes::Shorthand::Strict, on));
}

LogicalResult Session::setWord(StringRef name, StringRef word) {
  ContextModes wanted = modes;
  if (std::string expected = wanted.setWord(name, word); !expected.empty())
    return fail(FailureKind::Usage, "option '" + name + "' expects " +
                                        expected + ", but got '" + word + "'");
  return setModes(wanted);
}

LogicalResult Session::setPrecision(StringRef word) {
  return setWord("precision", word);
}

LogicalResult Session::setSums(StringRef word) { return setWord("sums", word); }

LogicalResult Session::setMath(StringRef word) { return setWord("math", word); }

LogicalResult Session::setAdjoints(StringRef word) {
  return setWord("adjoints", word);
}

LogicalResult Session::setFtz(bool on) {
  ContextModes wanted = modes;
  wanted.ftz = on;
  return setModes(wanted);
}

LogicalResult Session::setDebug(bool on) {
  compileOptions.debug = on;
  rt->setDebug(on);
  return success();
}

LogicalResult Session::setFastMath(bool on) {
  return setModes(with(modes, ContextModes::Shorthand::FastMath, on));
}

LogicalResult Session::setShadow(bool on) {
  ContextModes wanted = modes;
  wanted.shadow = on;
  if (std::string problem = wanted.findContradiction(); !problem.empty())
    return fail(FailureKind::Usage, problem);
  if (on && (rt->devices().device() || compileOptions.interpret))
    return fail(FailureKind::Usage,
                "option 'shadow' is for compiled kernels on the CPU, and this "
                "context runs them elsewhere; choose arch cpu");
  if (failed(check(rt->setShadow(on))))
    return failure();
  return setModes(wanted);
}

LogicalResult Session::setSanitize(bool address) {
  if (address && !dlsym(RTLD_DEFAULT, "__asan_init"))
    return fail(FailureKind::Usage,
                "option 'sanitize': the process has no run time of "
                "AddressSanitizer; start it with LD_PRELOAD=$(clang-22 "
                "-print-file-name=libclang_rt.asan-x86_64.so) "
                "ASAN_OPTIONS=detect_leaks=0");
  compileOptions.codegen.sanitizeAddress = address;
  return success();
}

LogicalResult Session::setTargetCpu(StringRef name) {
  StringRef cpu = name == "native" ? "" : name;
  if (auto found = TargetCpu::find(cpu); !found)
    return fail(FailureKind::Usage,
                "option 'target_cpu' expects native, or the name that LLVM has "
                "for a processor, but got '" +
                    name.str() + "': " + llvm::toString(found.takeError()));
  compileOptions.codegen.targetCpu = cpu.str();
  return success();
}

LogicalResult Session::setCacheDir(StringRef folder) {
  useCache(folder);
  return success();
}

LogicalResult Session::setPrintIR(StringRef names) {
  SmallVector<std::string> stages;
  SmallVector<StringRef> parts;
  names.split(parts, ',', -1, /*KeepEmpty=*/false);
  for (StringRef part : parts) {
    part = part.trim();
    if (part == "all") {
      for (StringRef stage : Compiler::getStages())
        stages.push_back(stage.str());
      continue;
    }
    if (!llvm::is_contained(Compiler::getStages(), part))
      return fail(FailureKind::Usage,
                  "option 'print_ir' expects \"all\" or some of " +
                      llvm::join(Compiler::getStages(), ", ") + ", but got '" +
                      names + "'");
    stages.push_back(part.str());
  }
  reports.setStages(std::move(stages));
  return success();
}

LogicalResult Session::setProfiler(bool on) {
  rt->setProfiler(on);
  compileOptions.places = rt->wantsPlaces();
  return success();
}

LogicalResult Session::setCompileProfile(bool on) {
  reports.setProfile(on);
  return success();
}

LogicalResult Session::setSkip(StringRef names) {
  SkipSet skips;
  std::string error;
  if (!SkipSet::parse(names, skips, error))
    return fail(FailureKind::Usage, "option 'skip': " + error);
  compileOptions.skips = skips & SkipSet::ofCompiler();
  rt->setSkips(skips);
  return success();
}

LogicalResult Session::setDeviceMemoryLimit(int64_t bytes) {
  deviceMemoryLimit = bytes;
  return success();
}

LogicalResult Session::setDeviceHeap(int64_t bytes) {
  runtime::setDeviceHeapBytes(bytes);
  return success();
}

LogicalResult Session::setArch(StringRef name) {
  std::unique_ptr<runtime::Device> device;
  if (name == "cuda") {
    std::optional<std::string> emulated =
        llvm::sys::Process::GetEnv("TAI_CUDA_EMULATION");
    if (emulated && *emulated == "1")
      device = runtime::openEmulatedDevice(makeObjectLinker());
    else if (failed(check(runtime::openCudaDevice(0, device))))
      return failure();
  } else if (name != "cpu" && name != "interpreter") {
    return fail(FailureKind::Usage, "there is no arch '" + name +
                                        "'; there are cpu, cuda and "
                                        "interpreter");
  }
  if (compileOptions.shadow && name != "cpu")
    return fail(FailureKind::Usage,
                "option 'shadow' is for compiled kernels on the CPU, not for "
                "arch '" +
                    name + "'; choose arch cpu");
  if (failed(check(rt->useDevice(std::move(device), deviceMemoryLimit))))
    return failure();
  compileOptions.interpret = name == "interpreter";
  compileOptions.device = std::nullopt;
  compileOptions.deviceTarget.clear();
  if (const runtime::Device *used = rt->devices().device()) {
    compileOptions.device = used->kind();
    compileOptions.deviceTarget = used->target();
    compileOptions.places = rt->wantsPlaces();
  }
  compiler->setAssembler(
      rt->devices().device() ? rt->devices().device()->assembler() : nullptr);
  if (runtime::DeviceQueue *queue = rt->devices().queue()) {
    queue->setProgramMaker(
        [this](const runtime::ProgramPlan &plan, runtime::DeviceImage &image) {
          Failure problem;
          auto made = compiler->makeProgram(plan, compileOptions, problem);
          if (!made)
            return keepFailure(std::move(problem));
          image = std::move(*made);
          return runtime::Status::success();
        });
    if (compilesProgramsInBackground(queue->kind()))
      queue->setProgramStarter([this](runtime::ProgramPlan plan) {
        return startProgram(std::move(plan));
      });
    queue->keepChoices(keptChoices);
  }
  return setFuseLaunches(fuseLaunches);
}

LogicalResult Session::setFuseLaunches(bool on) {
  fuseLaunches = on;
  rt->launcher().setFuse(on);
  if (runtime::DeviceQueue *queue = rt->devices().queue())
    queue->setMode(on ? runtime::ProgramMode::Automatic
                      : runtime::ProgramMode::Launches);
  return success();
}

LogicalResult Session::fuseLaunchesIn(ModuleOp file) {
  if (!fusesLaunches())
    return success();
  DiagnosticCollector collector(getContext());
  PassManager manager(getContext());
  if (compileOptions.deterministic)
    manager.addPass(createFixSumOrder());
  manager.addPass(createFuseLaunches());
  if (succeeded(manager.run(file)))
    return success();
  return fail(
      collector.take(FailureKind::Internal, "launches cannot be fused"));
}
