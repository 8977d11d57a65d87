//===- Runtime.cpp - Trees, fields and launches ---------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Storage and the path of a launch. The launch is the part of which a small
// simulation makes hundreds of thousands: no lock, no allocation, no look-up.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Runtime.h"
#include "../Mirror/Mirror.h"
#include "../Storage/Scalars.h"
#include "Launch.h"
#include "TangentFlows.h"
#include "WorkerPool.h"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <sys/mman.h>
#include <unistd.h>

using namespace mlir::tai::runtime;

/// What the machine, or the control group of this process, has.
static int64_t availableMemory() {
  int64_t limit = static_cast<int64_t>(sysconf(_SC_PHYS_PAGES)) *
                  static_cast<int64_t>(sysconf(_SC_PAGESIZE));
  if (FILE *file = std::fopen("/sys/fs/cgroup/memory.max", "re")) {
    long long bytes = 0;
    if (std::fscanf(file, "%lld", &bytes) == 1 && bytes > 0)
      limit = std::min<int64_t>(limit, bytes);
    std::fclose(file);
  }
  return limit;
}

static int threadsFor(int wanted) {
  return wanted > 0 ? std::min(wanted, 1024) : availableThreads();
}

Runtime::Runtime(Options options)
    : opts(options), numThreads(threadsFor(options.threads)),
      limit(options.memoryLimit > 0 ? options.memoryLimit : availableMemory()),
      forkGuard(new ForkGuard) {
  hot.seed = opts.seed;
  updateLaunchState();
}

Runtime::~Runtime() {
  if (!forkGuard->sameProcess())
    (void)pool.release(); // in a forked child: its threads are not here
  pool.reset();
  for (auto &entry : trees)
    freeTree(*entry.second);
}

void Runtime::setMemoryLimit(int64_t bytes) {
  limit = bytes > 0 ? bytes : availableMemory();
}

//===----------------------------------------------------------------------===//
// Trees
//===----------------------------------------------------------------------===//

/// Trees of sparse levels may reserve this much; the system gives out less
/// than 47 bits of addresses.
static constexpr int64_t largestReservation = int64_t(1) << 45;

Status Runtime::addTree(std::string name, int64_t bytes, TreePtr &tree,
                        std::vector<SparseInfo> sparse) {
  if (trees.count(name))
    return Status::failure(StatusCode::Usage,
                           "a tree '" + name + "' exists already");
  if (bytes < 0)
    return Status::failure(StatusCode::Usage,
                           "tree '" + name + "' has a negative size");
  if (!sparse.empty() && device) {
    Status status = SparseMirror::check(*device, name, bytes, sparse);
    if (!status)
      return status;
  }
  if (!sparse.empty() && bytes > largestReservation)
    return Status::failure(StatusCode::Memory,
                           "tree '" + name + "' spans " + formatBytes(bytes) +
                               " with all cells active, and " +
                               formatBytes(largestReservation) +
                               " is the most that can be addressed");
  // What a sparse tree needs is known when cells become active.
  int64_t needed = sparse.empty() ? bytes : 0;
  if (needed > limit - reserved)
    return Status::failure(
        StatusCode::Memory,
        "out of memory: tree '" + name + "' needs " + formatBytes(bytes) +
            ", " + formatBytes(reserved) + " of " + formatBytes(limit) +
            " are taken by " + std::to_string(trees.size()) + " other trees");
  size_t page = static_cast<size_t>(sysconf(_SC_PAGESIZE));
  // Trees start at different offsets in their pages: loops over several arrays
  // that share the low bits of their addresses stall on false dependences.
  // The address of the tree stands in front of its base.
  size_t stagger = 64 + (treesMade % 8) * 320;
  size_t mapped = (static_cast<size_t>(bytes) + stagger + page) / page * page;
  void *memory = mmap(nullptr, mapped, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED)
    return Status::failure(StatusCode::Memory,
                           "out of memory: the system refuses " +
                               formatBytes(bytes) + " for tree '" + name +
                               "' (" + formatBytes(reserved) +
                               " are taken by other trees)");
  if (sparse.empty() && bytes >= (int64_t(8) << 20))
    (void)madvise(memory, mapped, MADV_HUGEPAGE);
  if (sparse.empty() && !skips(Skip::LazyMemory))
    commitPages(static_cast<char *>(memory), static_cast<int64_t>(mapped));
  ++treesMade;
  tree = std::make_shared<Tree>();
  tree->treeName = name;
  tree->address = static_cast<char *>(memory) + stagger;
  tree->size = bytes;
  tree->memory = std::shared_ptr<void>(
      memory, [mapped](void *start) { munmap(start, mapped); });
  tree->charged = needed;
  tree->allActiveBytes = &sparseBytes;
  reinterpret_cast<Tree **>(tree->address)[-1] = tree.get();
  for (SparseInfo &info : sparse) {
    SparseNode *parent =
        info.parent < 0 ? nullptr : tree->nodes[info.parent].get();
    tree->nodes.push_back(
        std::make_unique<SparseNode>(*tree, std::move(info), parent));
  }
  if (device) {
    tree->mirrored = std::make_shared<Mirror>(device, *tree);
    for (const std::unique_ptr<SparseNode> &node : tree->nodes)
      node->onDevice = tree->mirrored->sparse();
  }
  reserved += needed;
  trees.emplace(std::move(name), tree);
  return Status::success();
}

void Runtime::freeTree(Tree &tree) {
  for (const std::unique_ptr<SparseNode> &node : tree.nodes)
    node->onDevice = nullptr;
  tree.mirrored.reset();
  tree.memory.reset();
  reserved -= tree.charged;
  sparseBytes -= tree.activeCellBytes();
  tree.address = nullptr;
}

Status Runtime::checkUnused(const Tree &tree) {
  Status status;
  runningLaunches.visit([&](const Launch &launch, const Kernel &kernel) {
    if (!kernel.uses(tree))
      return;
    auto field = std::find_if(
        fieldList.begin(), fieldList.end(),
        [&](const FieldPtr &other) { return &other->tree() == &tree; });
    std::string what = field == fieldList.end()
                           ? "tree '" + tree.name() + "'"
                           : "the tree of field '" + (*field)->name() + "'";
    std::string who =
        launch.isOfThisThread() ? "this thread" : "another thread";
    status = Status::failure(
        StatusCode::Usage,
        what + " cannot be destroyed while " + who + " runs kernel '" +
            kernel.name() +
            "', which uses it: wait until the kernel has returned");
  });
  return status;
}

Status Runtime::destroyTree(const std::string &name) {
  auto found = trees.find(name);
  if (found == trees.end())
    return Status::failure(StatusCode::Usage,
                           "there is no tree '" + name + "'");
  Tree *tree = found->second.get();
  // From here on no launch begins to use it.
  tree->isClosing.store(true, std::memory_order_release);
  storageChanged();
  runningLaunches.letLaunchesSee();
  if (Status status = checkUnused(*tree); !status) {
    tree->isClosing.store(false, std::memory_order_release);
    return status;
  }
  std::unique_lock<std::mutex> changing(fieldsMutex);
  for (size_t i = 0; i < fieldList.size();) {
    if (&fieldList[i]->tree() == tree) {
      // Adjoints elsewhere no longer have a primal that can reach them.
      if (fieldList[i]->adjointField)
        fieldList[i]->adjointField->ofPrimal = false;
      fieldsByName.erase(fieldList[i]->name());
      fieldList.erase(fieldList.begin() + static_cast<ptrdiff_t>(i));
    } else {
      ++i;
    }
  }
  changing.unlock();
  for (const FieldPtr &field : fieldList) {
    // What takes their names is another field.
    if (field->adjointField && &field->adjointField->tree() == tree) {
      field->adjointField.reset();
      field->adjointName.clear();
    }
    if (field->dualField && &field->dualField->tree() == tree) {
      field->dualField.reset();
      field->dualName.clear();
    }
  }
  {
    std::lock_guard<std::mutex> lock(launchMutex);
    owing.erase(std::remove_if(owing.begin(), owing.end(),
                               [tree](const FieldPtr &field) {
                                 return &field->tree() == tree;
                               }),
                owing.end());
    owesAny.store(!owing.empty(), std::memory_order_release);
  }
  freeTree(*tree);
  trees.erase(found);
  storageChanged();
  return Status::success();
}

TreePtr Runtime::findTree(const std::string &name) const {
  auto found = trees.find(name);
  return found == trees.end() ? nullptr : found->second;
}

//===----------------------------------------------------------------------===//
// Fields
//===----------------------------------------------------------------------===//

static Status badField(const std::string &name, const std::string &why) {
  return Status::failure(StatusCode::Usage, "field '" + name + "' " + why);
}

Status Runtime::addField(FieldInfo info, FieldPtr &result) {
  if (fieldsByName.count(info.name))
    return badField(info.name, "exists already");
  if (!info.tree || !info.tree->base())
    return badField(info.name, "has no tree");
  auto field = std::make_shared<Field>();
  FieldLayout &layout = field->fieldLayout;
  layout = std::move(info.layout);
  int64_t scalar = byteSize(layout.scalar);
  if (layout.componentStride == 0)
    layout.componentStride = scalar;
  for (int64_t extent : layout.elementShape) {
    if (extent < 1)
      return badField(info.name, "has elements without components");
    field->components *= extent;
  }
  // The compiler's word is checked here once, so that host access cannot leave
  // the tree.
  int64_t last = layout.placeOffset;
  bool inside = layout.placeOffset >= 0 && layout.componentStride >= scalar;
  for (const std::vector<LayoutLevel> &levels : layout.indices) {
    int64_t extent = 1;
    for (const LayoutLevel &level : levels) {
      if (level.extent < 1 || level.divisor < 1 || level.stride < 0)
        return badField(info.name, "has a level without extent");
      if (__builtin_mul_overflow(extent, level.extent, &extent))
        return badField(info.name, "has more elements than can be counted");
      int64_t span;
      inside &=
          !__builtin_mul_overflow(level.extent - 1, level.stride, &span) &&
          !__builtin_add_overflow(last, span, &last);
    }
    field->shapeOf.push_back(extent);
    if (__builtin_mul_overflow(field->elements, extent, &field->elements))
      return badField(info.name, "has more elements than can be counted");
  }
  if (!layout.offset.empty() && layout.offset.size() != layout.indices.size())
    return badField(info.name, "has offsets for another number of indices");
  int64_t elementBytes =
      (field->components - 1) * layout.componentStride + scalar;
  if (!inside || last + elementBytes > info.tree->bytes())
    return badField(info.name,
                    "does not fit into tree '" + info.tree->name() + "' of " +
                        std::to_string(info.tree->bytes()) + " bytes");
  if (layout.componentStride == scalar)
    field->elementStep =
        findEvenStep(layout, field->shapeOf, field->components * scalar);
  field->isContiguous = field->elementStep == field->components * scalar;
  field->fieldName = info.name;
  field->owner = std::move(info.tree);
  field->adjointName = std::move(info.adjoint);
  field->dualName = std::move(info.dual);
  Status status = checkPartners(*field);
  if (!status)
    return status;
  fieldsByName.emplace(info.name, field);
  {
    std::lock_guard<std::mutex> lock(fieldsMutex);
    fieldList.push_back(field);
  }
  linkPartners(field);
  result = field;
  return Status::success();
}

static bool sameElements(const Field &a, const Field &b) {
  return a.elementShape() == b.elementShape() && a.shape() == b.shape() &&
         isFloat(a.scalar()) == isFloat(b.scalar());
}

/// Adjoints and tangents never make cells active: where they lie below a sparse
/// level, their primals do that for them.
static bool sharesActivity(const Field &primal, const Field &partner) {
  return !partner.sparseNode() ||
         (partner.sparseNode() == primal.sparseNode() &&
          primal.layout().offset == partner.layout().offset);
}

Status Runtime::checkPartners(const Field &added) const {
  auto check = [&](const Field &primal, const Field &partner) {
    if (!sharesActivity(primal, partner))
      return badField(primal.name(),
                      "and its adjoint or tangent '" + partner.name() +
                          "' must lie below the same sparse level, with the "
                          "same offsets: they share what is active; place both "
                          "there");
    if (sameElements(primal, partner))
      return Status::success();
    return badField(primal.name(), "and its adjoint or tangent '" +
                                       partner.name() +
                                       "' differ in shape or element type");
  };
  for (const FieldPtr &other : fieldList) {
    Status status;
    if (other->name() == added.adjointName || other->name() == added.dualName)
      status = check(added, *other);
    else if (other->adjointName == added.name() ||
             other->dualName == added.name())
      status = check(*other, added);
    if (!status)
      return status;
  }
  return Status::success();
}

void Runtime::linkPartners(const FieldPtr &added) {
  bool linked = false;
  auto link = [&](Field &primal, const FieldPtr &partner) {
    if (primal.adjointName == partner->name()) {
      primal.adjointField = partner;
      partner->ofPrimal = true;
      linked = true;
    }
    if (primal.dualName == partner->name())
      primal.dualField = partner;
  };
  for (const FieldPtr &other : fieldList) {
    link(*added, other);
    link(*other, added);
  }
  if (linked)
    storageChanged();
}

Status Runtime::setAdjoint(Field &field, const FieldPtr &adjoint) {
  if (!sameElements(field, *adjoint) || !sharesActivity(field, *adjoint))
    return badField(field.name(),
                    "and its adjoint '" + adjoint->name() +
                        "' differ in shape, element type or sparse levels");
  if (field.adjointField)
    field.adjointField->ofPrimal = false;
  field.adjointName = adjoint->name();
  field.adjointField = adjoint;
  adjoint->ofPrimal = true;
  storageChanged();
  return Status::success();
}

FieldPtr Runtime::findField(const std::string &name) const {
  auto found = fieldsByName.find(name);
  return found == fieldsByName.end() ? nullptr : found->second;
}

std::vector<FieldPtr> Runtime::fields() const { return fieldList; }

//===----------------------------------------------------------------------===//
// Launches
//===----------------------------------------------------------------------===//

KernelPtr Runtime::createKernel(KernelInfo info) {
  auto kernel = std::make_shared<Kernel>(std::move(info));
  std::lock_guard<std::mutex> lock(launchMutex);
  if (kernelList.size() >= kernelsToKeep) {
    auto gone = [](const auto &entry) { return entry.expired(); };
    kernelList.erase(std::remove_if(kernelList.begin(), kernelList.end(), gone),
                     kernelList.end());
    kernelsToKeep = std::max<size_t>(64, 2 * kernelList.size());
  }
  kernelList.push_back(kernel);
  return kernel;
}

int64_t Runtime::numKernels() {
  std::lock_guard<std::mutex> lock(launchMutex);
  return std::count_if(kernelList.begin(), kernelList.end(),
                       [](const auto &entry) { return !entry.expired(); });
}

void Runtime::setSeed(uint64_t seed) {
  opts.seed = hot.seed = seed;
  hot.launches.store(0, std::memory_order_relaxed);
  std::lock_guard<std::mutex> lock(launchMutex);
  for (const std::weak_ptr<Kernel> &entry : kernelList)
    if (KernelPtr kernel = entry.lock())
      kernel->prepared.lastLaunch.store(0, std::memory_order_relaxed);
}

inline bool Runtime::isReady(const Kernel &kernel) const {
  return kernel.boundEpoch.load(std::memory_order_acquire) ==
             storageEpoch.load(std::memory_order_relaxed) &&
         kernel.resolved();
}

Status Runtime::ready(Kernel &kernel) {
  Status status = kernel.resolve();
  if (status)
    status = kernel.bind(storageEpoch.load(std::memory_order_relaxed));
  return status;
}

Status Runtime::failureOf(Launch &launch, const Kernel &kernel) {
  if (launch.hasFailed())
    return launch.takeFailure();
  return Status::failure(StatusCode::Internal,
                         "kernel '" + kernel.name() + "' failed");
}

Status Runtime::runCode(Launch &launch, Kernel &kernel, const uint64_t *args,
                        uint64_t *results, uint64_t number) {
  while (true) {
    if (__builtin_expect(!isReady(kernel), false)) {
      Status status = ready(kernel);
      if (!status)
        return status;
    }
    if (!launch.passSafepoint())
      return launch.takeFailure();
    launch.begin(kernel);
    if (__builtin_expect(isReady(kernel), true))
      break;
    launch.end();
  }
  Status status;
  // A tape of another thread may have begun while this kernel was compiled.
  if (__builtin_expect(numHolding.load(std::memory_order_relaxed) != 0,
                       false) &&
      launch.isPlain.load(std::memory_order_relaxed)) {
    std::atomic_thread_fence(std::memory_order_seq_cst);
    status = checkHolds(kernel);
  }
  if (status)
    status = runBegun(launch, kernel, args, results, number);
  launch.end();
  return status;
}

Status Runtime::runBegun(Launch &launch, Kernel &kernel, const uint64_t *args,
                         uint64_t *results, uint64_t number) {
  if (__builtin_expect(!results && kernel.resultSlots() > 0, false)) {
    launch.unwanted.resize(static_cast<size_t>(kernel.resultSlots()));
    results = launch.unwanted.data();
  }
  if (owesZeros())
    settleZeros(kernel, args);
  launch.trees = kernel.bases.data();
  launch.loopTimes = &kernel.loopTimes;
  if (__builtin_expect(device != nullptr, false)) {
    Status status = enterDevice(launch, kernel);
    if (!status)
      return status;
  }
  launch.args = args;
  launch.results = results;
  launch.seed = opts.seed;
  launch.launch = number;
  if (__builtin_expect(!launch.loops.empty(), false))
    launch.loops.clear();
  if (__builtin_expect(!kernel.sparseNodes.empty() && !launch.given, false))
    kernel.noteBegin();
  int32_t code;
  TaiKernelFn function = kernel.function.load(std::memory_order_relaxed);
  if (!kernel.loopLevels.empty() && skips(Skip::EmptyLists) &&
      kernel.hasNoActiveCells() &&
      !(launch.given && launch.given->hasCells())) {
    skipCounts.add(SkipCount::EmptyLaunches);
    // Its adjoint may not be so simple.
    static const ActiveListPtr none = std::make_shared<const ActiveList>();
    if (!launch.given)
      for (const SparseNode *level : kernel.loopLevels)
        launch.loops.add(*level, none);
    code = 0;
  } else if (__builtin_expect(opts.profiler, false))
    code = runTimed(launch, kernel, function);
  else
    code = function(&launch);
  if (__builtin_expect(device != nullptr, false))
    leaveDevice(launch);
  for (Field *field : kernel.changedAdjoints)
    field->markDirty();
  if (launch.arena.used())
    launch.arena.reset();
  if (__builtin_expect(!launch.loops.empty(), false))
    kernel.noteLoops(launch.loops);
  if (__builtin_expect(code != 0 || launch.hasFailed(), false)) {
    launch.freeSinks();
    return failureOf(launch, kernel);
  }
  return Status::success();
}

static Status wrongSlots(const Kernel &kernel, int64_t wanted, int64_t slots) {
  std::string message = "kernel '" + kernel.name() + "' takes " +
                        std::to_string(wanted) + " argument slots, but got " +
                        std::to_string(slots);
  if (wanted != kernel.argSlots())
    message += "; the last " + std::to_string(wanted - kernel.argSlots()) +
               " are for the adjoints of its arguments and results";
  return Status::failure(StatusCode::Usage, std::move(message));
}

Status Runtime::launch(Kernel &kernel, const uint64_t *args, int64_t slots,
                       uint64_t *results) {
  if (__builtin_expect(Loan::areAny(), false) && !kernel.arrays().empty())
    if (Status status = checkLentFields(kernel, args); !status)
      return status;
  const PreparedLaunch &prepared = kernel.prepared;
  if (__builtin_expect(prepared.state.load(std::memory_order_acquire) ==
                               hot.state.load(std::memory_order_relaxed) &&
                           slots == prepared.slots &&
                           (results || !prepared.hasResults) &&
                           !interruptRequested(),
                       true))
    return launchPrepared(kernel, args, results);
  // Only what is recorded needs to say where adjoints are.
  if (__builtin_expect(slots != kernel.tapeSlots(), false)) {
    Tape *tape = recordingTape();
    bool recorded = tape && !tape->suspended;
    if (recorded || slots != kernel.argSlots())
      return wrongSlots(
          kernel, recorded ? kernel.tapeSlots() : kernel.argSlots(), slots);
  }
  Tape *tape = recordingTape();
  if (__builtin_expect(!tape && numHolding.load(std::memory_order_relaxed) != 0,
                       false))
    if (Status status = checkHolds(kernel); !status)
      return status;
  Launch *launch = acquireLaunch(/*isPlain=*/!tape);
  uint64_t number = hot.launches.fetch_add(1, std::memory_order_relaxed);
  kernel.prepared.lastLaunch.store(number, std::memory_order_relaxed);
  Status status = __builtin_expect(tape != nullptr, false)
                      ? tape->launch(*launch, kernel, args, results, number)
                      : run(*launch, kernel, args, results, number);
  releaseLaunch(launch);
  if (status)
    prepare(kernel);
  return status;
}

Status Runtime::launchAdjoint(Kernel &kernel, const uint64_t *args,
                              int64_t slots) {
  if (slots != kernel.tapeSlots())
    return wrongSlots(kernel, kernel.tapeSlots(), slots);
  Status status = kernel.bind(storageEpoch.load(std::memory_order_relaxed));
  if (!status)
    return status;
  if (__builtin_expect(numHolding.load(std::memory_order_relaxed) != 0, false))
    status = checkAdjointHolds(kernel);
  if (!status)
    return status;
  settleZeros();
  const AdjointPlan &plan = kernel.plan();
  if (!plan.before.empty() || !plan.parts.empty())
    return Status::failure(
        StatusCode::Usage,
        "the gradient of kernel '" + kernel.name() +
            "' needs values that the kernel itself overwrites, which only a "
            "tape keeps: launch it under a tape, or store the new values to "
            "other elements");
  Kernel *adjoint = nullptr;
  bool canTake = kernel.hasZeroingAdjoint();
  status = kernel.resolveAdjoint(
      adjoint, kernel.alwaysTakes || (canTake && !kernel.overwritten.empty()));
  if (!status)
    return status;
  LoopLists loops;
  bool wasLaunched = false;
  if (Tape *sweep = getSweeping())
    status = sweep->findLoops(kernel, loops, wasLaunched);
  else
    status = kernel.checkActivity(loops, wasLaunched);
  if (!status)
    return status;
  Launch *launch = acquireLaunch(/*isPlain=*/!getSweeping());
  uint64_t number = kernel.prepared.lastLaunch.load(std::memory_order_relaxed);
  if (adjoint)
    status = runAdjoint(*launch, kernel, *adjoint, args, number,
                        wasLaunched ? &loops : nullptr);
  releaseLaunch(launch);
  return status;
}

Status Runtime::runAdjoint(Launch &launch, Kernel &kernel, Kernel &adjoint,
                           const uint64_t *args, uint64_t number,
                           const LoopLists *given) {
  uint64_t epoch = storageEpoch.load(std::memory_order_relaxed);
  if (__builtin_expect(
          kernel.boundEpoch.load(std::memory_order_acquire) != epoch, false)) {
    Status status = kernel.bind(epoch);
    if (!status)
      return status;
  }
  // The adjoint's own summary need not be known.
  for (Field *field : kernel.adjointTargets)
    field->adjoint()->markDirty();
  launch.given = given;
  launch.primalName = &kernel.name();
  if (!kernel.sparseNodes.empty() && skips(Skip::AdjointFlags) && !isForward())
    launch.flags = &kernel.plan().flags;
  Status status = run(launch, adjoint, args, nullptr, number);
  launch.given = nullptr;
  launch.flags = nullptr;
  launch.filtered.clear();
  launch.fetched.clear();
  return status;
}

Status Runtime::runHost(TaiKernelFn function, const std::vector<TreePtr> &trees,
                        HostModule &module, const uint64_t *args,
                        uint64_t *results) {
  settleZeros();
  std::vector<void *> bases;
  for (const TreePtr &tree : trees) {
    if (!tree->base())
      return Status::failure(StatusCode::Usage, "the host program uses tree '" +
                                                    tree->name() +
                                                    "', which has been "
                                                    "destroyed");
    bases.push_back(module.usesTrees ? tree->writable() : tree->base());
  }
  HostState state;
  state.module = &module;
  state.trees = &trees;
  Launch *launch = acquireLaunch();
  launch->host = &state;
  launch->loopTimes = nullptr;
  launch->trees = bases.data();
  launch->args = args;
  launch->results = results;
  launch->seed = opts.seed;
  launch->launch = hot.launches.fetch_add(1, std::memory_order_relaxed);
  int32_t code = function(launch);
  state.tape.reset();
  launch->host = nullptr;
  if (launch->arena.used())
    launch->arena.reset();
  Status status;
  if (code != 0 || launch->hasFailed()) {
    launch->freeSinks();
    status = launch->hasFailed() ? launch->takeFailure()
                                 : Status::failure(StatusCode::Internal,
                                                   "the host program failed");
  }
  releaseLaunch(launch);
  return status ? synchronize() : std::move(status);
}

//===----------------------------------------------------------------------===//
// Workers
//===----------------------------------------------------------------------===//

void Runtime::setThreads(int threads) {
  opts.threads = threads;
  int wanted = threadsFor(threads);
  if (wanted == numThreads)
    return;
  std::lock_guard<std::mutex> lock(poolMutex);
  if (!forkGuard->sameProcess()) {
    (void)pool.release();
    forkGuard->rearm();
  }
  currentPool.store(nullptr, std::memory_order_release);
  pool.reset();
  numThreads = wanted;
}

WorkerPool &Runtime::workers() {
  WorkerPool *current = currentPool.load(std::memory_order_acquire);
  if (__builtin_expect(current && forkGuard->sameProcess(), true))
    return *current;
  std::lock_guard<std::mutex> lock(poolMutex);
  if (!forkGuard->sameProcess()) {
    // A forked child has none of the threads. The object of the parent is left
    // as it is: it may have been in the middle of a loop.
    (void)pool.release();
    forkGuard->rearm();
  }
  if (!pool)
    pool = std::make_unique<WorkerPool>(numThreads);
  currentPool.store(pool.get(), std::memory_order_release);
  return *pool;
}

void Runtime::parallel(int64_t parts, void (*task)(void *context, int64_t part),
                       void *context, void (*look)(void *context)) {
  if (parts > 1 && numThreads > 1) {
    if (workers().tryRun(task, context, parts, look)) {
      counts.forks.fetch_add(1, std::memory_order_relaxed);
      return;
    }
  }
  counts.inlineLoops.fetch_add(1, std::memory_order_relaxed);
  for (int64_t part = 0; part < parts; ++part)
    task(context, part);
}

/// Below this a fork does not pay even with workers that wait for it, and below
/// `wakeNs` not if they must be woken first. Loops in between, if there are
/// many, earn the waking.
static constexpr int64_t spinNs = 4000, wakeNs = 50000, wakeCredit = 100000;

int64_t Runtime::partition(Launch &launch, int64_t n, int64_t cost,
                           bool reduces) {
  launch.measured = nullptr;
  // The estimate is wrong by less than this.
  constexpr double factor = 16;
  double total = static_cast<double>(n) * static_cast<double>(cost);
  bool isFixed = reduces && opts.deterministic;
  if (isFixed || numThreads == 1 || !launch.loopTimes ||
      total * factor < spinNs || total > spinNs * factor * factor)
    return partition(n, static_cast<double>(cost), reduces);
  LoopTimes::Entry *entry = launch.loopTimes->find(cost);
  if (!entry)
    return partition(n, static_cast<double>(cost), reduces);
  bool wantsRun = entry->wantsRun();
  entry->noteRun();
  if (!wantsRun)
    return partition(n, entry->perIteration(), reduces);
  launch.measured = entry;
  return 1;
}

int64_t Runtime::partition(int64_t n, double cost, bool reduces) {
  if (n <= 1)
    return 1;
  double exact = static_cast<double>(n) * std::max(cost, 1e-3);
  int64_t total = exact < 9e18 ? static_cast<int64_t>(exact) : INT64_MAX;
  if (reduces && opts.deterministic) {
    // Depends on the loop alone. Every part costs a private copy of what is
    // reduced, so there are few.
    constexpr int64_t partNs = 16000, mostParts = 32;
    return std::min(n, std::clamp<int64_t>(total / partNs, 1, mostParts));
  }
  if (numThreads == 1)
    return 1;
  if (total < spinNs)
    return 1;
  if (total < wakeNs) {
    WorkerPool *current = currentPool.load(std::memory_order_acquire);
    if (!current || !current->awake()) {
      if (inlineCredit.fetch_add(total, std::memory_order_relaxed) < wakeCredit)
        return 1;
      inlineCredit.store(0, std::memory_order_relaxed);
    }
  }
  constexpr int64_t leastPartNs = 2000;
  int64_t parts = std::min<int64_t>(numThreads, total / leastPartNs);
  if (!reduces) {
    // Smaller parts even out what other processes take, and let a long loop be
    // interrupted.
    constexpr int64_t goodPartNs = 25000, longestPartNs = 10000000;
    parts =
        std::max({parts, std::min<int64_t>(4 * numThreads, total / goodPartNs),
                  std::min<int64_t>(total / longestPartNs, 1 << 16)});
  }
  return std::clamp<int64_t>(parts, 1, n);
}
