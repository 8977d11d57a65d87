//===- KernelWay.cpp - Sequences as one kernel ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "KernelWay.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

KernelWay::~KernelWay() {
  if (table)
    device.free(table);
  if (clocks)
    device.free(clocks);
}

static int scopeOf(ProgramMode mode, DeviceKind kind) {
  // On the emulated device, a barrier of a block is a barrier of all threads,
  // because the program runs as one block.
  if (mode == ProgramMode::Block || kind == DeviceKind::Emulated)
    return TAI_SCOPE_BLOCK;
  return mode == ProgramMode::Cluster ? TAI_SCOPE_CLUSTER : TAI_SCOPE_GRID;
}

/// True if the steps of programs are timed, for tape.explain(). Reading the
/// clock costs some nanoseconds a step, so timing must be asked for.
static bool areStepsTimed() {
  const char *given = std::getenv("TAI_PROGRAM_CLOCKS");
  return given && *given && *given != '0';
}

Status KernelWay::plan(ProgramPlan &plan) {
  plan = ProgramPlan();
  std::vector<LoopStep> steps = schedules.listSteps(usesTiles);
  planned = ProgramLoops(steps, usesLoops);
  if (!planned.isComplete())
    return Status::failure(StatusCode::Internal, "there are too many chains");
  plan.segments = planned.allSegments();
  plan.words = planned.numWords();
  plan.scope = scopeOf(mode, device.kind());
  plan.threads = shape.threads;
  plan.isTimed = areStepsTimed();
  for (const Function *part : sequence.listParts())
    plan.parts.push_back({part->bitcode, part->name, /*isInTable=*/false});
  if (usesTiles)
    schedules.addTiles(plan);
  for (const ProgramSegment &segment : plan.segments)
    for (size_t i = 0; !segment.isLoop() && i < segment.count; ++i) {
      uint64_t part = steps[segment.first + i].part;
      if (part >= TAI_FIRST_PART)
        plan.parts[part - TAI_FIRST_PART].isInTable = true;
    }
  return Status::success();
}

/// Loads the newly compiled code of a program. If loading fails, the present
/// code stays in use.
Status KernelWay::adopt(const DeviceImage &image) {
  std::unique_ptr<DeviceModule> loaded;
  DeviceFunction *found = nullptr;
  Status status = device.load(image, loaded);
  if (status)
    status = device.find(*loaded, image.functions.front(), found);
  // Queued work may still run the former module, so the host waits for it.
  if (status && module)
    status = device.synchronize();
  if (!status)
    return status;
  module = std::move(loaded);
  function = found;
  loops = std::move(planned);
  isOutdated = false;
  unsigned most = device.mostThreads(*function);
  if (usesTiles && shape.threads > most)
    return Status::failure(StatusCode::Internal,
                           "there is no room for a thread for each cell");
  if (shape.threads > most)
    shape.threads = std::max(most / 32 * 32, 1u);
  if (shape.cooperative) {
    unsigned resident = device.residentBlocks(*function, shape.threads);
    if (usesTiles && resident < shape.blocks)
      return Status::failure(StatusCode::Internal,
                             "there is no room for all tiles at a time");
    shape.blocks = std::min(shape.blocks, resident);
  }
  return status;
}

/// The size in bytes of the header in front of a program's step table.
static constexpr int64_t headerBytes = TAI_PROGRAM_HEADER;

/// Updates the program's step table, and its code if necessary, to the current
/// parameter slots.
Status KernelWay::update() {
  schedules.update();
  std::vector<LoopStep> steps;
  if (!usesTiles || schedules.hasTiles())
    steps = schedules.listSteps(usesTiles);
  std::vector<uint64_t> rows;
  if (steps.empty() || !loops.pack(steps, words, rows)) {
    // The parameters vary from step to step differently than before, so the
    // code is made without loops, and fits any parameters.
    if (usesTiles)
      schedules.dropTiles();
    usesTiles = usesLoops = false;
    isOutdated = true;
    if (!maker)
      return Status::failure(StatusCode::Internal,
                             "its parameters vary in a new way");
    ProgramPlan again;
    DeviceImage image;
    Status made = plan(again);
    if (made)
      made = maker(again, image);
    if (made)
      made = adopt(image);
    if (!made)
      return made;
    loops.pack(schedules.listSteps(usesTiles), words, rows);
  }
  return updateTable(rows);
}

Status KernelWay::updateTable(const std::vector<uint64_t> &rows) {
  auto bytes = static_cast<int64_t>(rows.size() * sizeof(uint64_t));
  Status status;
  // The step table can grow, since code without loops has more rows in it.
  if (table && bytes > tableBytes) {
    device.free(table);
    table = 0;
  }
  if (!table) {
    // The loops of a program also read (prefetch) one row behind the last row
    // of a parameter list, so spare bytes follow the step table.
    constexpr int64_t spareBytes = 1024;
    status = device.allocate(headerBytes + bytes + spareBytes, table);
    tableBytes = bytes;
    uint64_t zero = 0;
    if (status)
      status = device.fill(table, &zero, 8, headerBytes / 8);
    if (status && areStepsTimed()) {
      auto count = static_cast<int64_t>(schedules.get(false).units.size() + 1);
      if (!clocks)
        status = device.allocate(count * 8, clocks);
      if (status)
        status = device.fill(clocks, &zero, 8, count);
      if (status)
        status = device.copyIn(table + TAI_PROGRAM_CLOCKS, &clocks, 8);
    }
  }
  if (status && bytes > 0)
    status = device.copyIn(table + headerBytes, rows.data(), bytes);
  return status;
}

Status KernelWay::launch() {
  Status status = makeCurrent();
  if (!status)
    return status;
  StepRunner runner(device);
  return runSteps(runner);
}

/// Runs the steps that are too large for the program's threads, and then the
/// program.
Status KernelWay::runSteps(StepRunner &runner) {
  Status status;
  for (size_t i = 0; status && i < schedules.countBefore(); ++i)
    status = runner.run(sequence, sequence.steps[i]);
  if (status)
    status = runner.finish();
  if (!status)
    return status;
  std::vector<uint64_t> slots = {table + headerBytes, loops.rowWords(), table};
  slots.insert(slots.end(), words.begin(), words.end());
  return device.launch(*function, shape, slots.data(),
                       static_cast<int>(slots.size()));
}

std::string KernelWay::describe() const {
  char line[256];
  std::snprintf(line, sizeof(line),
                " (%u x %u threads, %zu steps before it, %zu barriers, "
                "%zu steps in loops)",
                shape.blocks, shape.threads, schedules.countBefore(),
                schedules.get(usesTiles).order.numBarriers,
                loops.numLoopSteps());
  std::string text = line;
  if (usesTiles)
    text += schedules.describeChains();
  if (schedules.countUnknown() > 0)
    text += ", " + std::to_string(schedules.countUnknown()) +
            " steps of unknown memory";
  return text;
}

/// Describes the clock cycles of a program on one multiprocessor, summed by the
/// function of each step.
std::string KernelWay::explainClocks() const {
  if (!clocks)
    return "";
  const StepSchedules::Schedule &schedule = schedules.get(usesTiles);
  std::vector<uint64_t> read(schedule.units.size() + 1);
  if (!device.copyOut(read.data(), clocks,
                      static_cast<int64_t>(read.size() * 8)))
    return "";
  struct Total {
    uint64_t clocks = 0, steps = 0;
  };
  std::map<std::string, Total> totals;
  for (size_t i = 0; i < schedule.units.size(); ++i) {
    Total &total = totals[schedules.describe(schedule.unit(i))];
    total.clocks += read[i + 1] - read[i];
    ++total.steps;
  }
  uint64_t all = std::max<uint64_t>(read.back() - read.front(), 1);
  std::string text;
  for (const auto &[name, total] : totals) {
    char line[512];
    std::snprintf(line, sizeof(line),
                  "\n  %5.1f %% %7llu steps %9.0f clocks each: %s",
                  100.0 * double(total.clocks) / double(all),
                  static_cast<unsigned long long>(total.steps),
                  double(total.clocks) / double(total.steps), name.c_str());
    text += line;
  }
  return text;
}
