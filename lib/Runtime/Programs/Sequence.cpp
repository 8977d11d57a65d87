//===- Sequence.cpp - Work for a device, in order -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Programs/Sequence.h"
#include "StepRunner.h"
#include <unordered_set>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

void Sequence::append(const Sequence &other) {
  for (const Step &step : other.steps) {
    Step added = step;
    added.firstSlot = slots.size();
    auto first = other.slots.begin() + static_cast<ptrdiff_t>(step.firstSlot);
    slots.insert(slots.end(), first,
                 first + static_cast<ptrdiff_t>(step.numSlots));
    add(added);
  }
}

bool Sequence::hasStructureOf(const Sequence &other) const {
  return hash == other.hash && steps.size() == other.steps.size() &&
         std::equal(steps.begin(), steps.end(), other.steps.begin(),
                    [](const Step &a, const Step &b) {
                      return a.kind == b.kind && a.function == b.function &&
                             a.numSlots == b.numSlots &&
                             a.shape.blocks == b.shape.blocks &&
                             a.shape.threads == b.shape.threads;
                    });
}

DeviceRows Sequence::rowsOf(const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  auto number = [&](int at) { return static_cast<int64_t>(values[at]); };
  if (step.kind == Step::Kind::Fill)
    return {values[0], 0, number(2) * number(3), 1};
  return {values[0], number(1), number(2), number(3), number(6), number(7)};
}

Status Sequence::run(Device &device) const {
  StepRunner runner(device);
  try {
    Status status = runner.runAll(*this);
    return status ? runner.finish() : std::move(status);
  } catch (const std::bad_alloc &) {
    (void)runner.finish();
    throw;
  }
}

Status Sequence::run(Device &device, const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  auto number = [&](int at) { return static_cast<int64_t>(values[at]); };
  switch (step.kind) {
  case Step::Kind::Launch:
    return device.launch(*step.function->function, step.shape, values,
                         static_cast<int>(step.numSlots));
  case Step::Kind::Fill:
    return device.fill(values[0], values + 1, static_cast<int>(values[2]),
                       static_cast<int64_t>(values[3]));
  case Step::Kind::Copy:
    return device.copy(values[0], values[1], static_cast<int64_t>(values[2]));
  case Step::Kind::FillRows:
    return device.fillRows(rowsOf(step), values + 4,
                           static_cast<int>(values[5]));
  case Step::Kind::CopyRows:
    return device.copyRows(rowsOf(step), values[4], number(5));
  case Step::Kind::SwapRows:
    return device.swapRows(rowsOf(step), values[4], number(5));
  }
  return Status::success();
}

StepMemory Sequence::memoryOf(const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  StepMemory memory;
  auto addRows = [&](DeviceAccess::Kind kind, uint64_t address,
                     uint64_t pitch) {
    memory.addRows(kind, address, pitch, values[2], values[3]);
  };
  switch (step.kind) {
  case Step::Kind::Launch:
    return StepMemory::ofLaunch(step.function->footprint.get(), values,
                                step.numSlots);
  case Step::Kind::Fill:
    // A fill with a pattern of one byte stores eight bytes at a time, so the
    // thread that stores an element is not known.
    if (values[2] > 1)
      memory.addNumbers(DeviceAccess::Write, values[0],
                        static_cast<int64_t>(values[2]),
                        static_cast<int64_t>(values[3]));
    else
      memory.add(DeviceAccess::Write, values[0], values[3]);
    break;
  case Step::Kind::Copy:
    memory.add(DeviceAccess::Write, values[0], values[2]);
    memory.add(DeviceAccess::Read, values[1], values[2]);
    break;
  case Step::Kind::FillRows:
    for (uint64_t group = 0; group < values[7]; ++group)
      addRows(DeviceAccess::Write, values[0] + group * values[6], values[1]);
    break;
  case Step::Kind::CopyRows:
    addRows(DeviceAccess::Write, values[0], values[1]);
    addRows(DeviceAccess::Read, values[4], values[5]);
    break;
  case Step::Kind::SwapRows:
    addRows(DeviceAccess::Write, values[0], values[1]);
    addRows(DeviceAccess::Write, values[4], values[5]);
    break;
  }
  return memory;
}

unsigned Sequence::width() const {
  uint64_t width = 1;
  for (const Step &step : steps)
    width = std::max(width, uint64_t(step.shape.blocks) * step.shape.threads);
  return static_cast<unsigned>(std::min<uint64_t>(width, 1u << 30));
}

size_t Sequence::countFirstLaunches() const {
  auto isOther = [](const Step &step) { return !step.function; };
  return static_cast<size_t>(std::find_if(steps.begin(), steps.end(), isOther) -
                             steps.begin());
}

std::vector<const Function *> Sequence::listParts() const {
  std::vector<const Function *> parts;
  std::unordered_set<const Function *> seen;
  for (const Step &step : steps)
    if (step.function && seen.insert(step.function).second)
      parts.push_back(step.function);
  return parts;
}

bool Sequence::areAllPartsKnown() const {
  return std::all_of(steps.begin(), steps.end(), [](const Step &step) {
    return step.kind != Step::Kind::Launch ||
           (step.function->bitcode && !step.function->bitcode->empty());
  });
}

bool Sequence::uses(const Module &module) const {
  return std::any_of(steps.begin(), steps.end(), [&](const Step &step) {
    return step.function && module.has(step.function);
  });
}

//===----------------------------------------------------------------------===//
// Fills
//===----------------------------------------------------------------------===//

/// True if each row of the strided memory `second` starts where a row of
/// `first` ends.
static bool isBeside(const DeviceRows &first, const DeviceRows &second) {
  if (second.address != first.address + static_cast<uint64_t>(first.rowBytes) ||
      first.rows != second.rows || first.outer != second.outer)
    return false;
  int64_t bytes = first.rowBytes + second.rowBytes;
  return (first.rows == 1 ||
          (first.step == second.step && bytes <= first.step)) &&
         (first.outer == 1 || (first.outerStep == second.outerStep &&
                               (first.rows > 1 || bytes <= first.outerStep)));
}

/// Simplifies strided rows: merges contiguous rows into one row, and turns
/// groups of one row into rows.
static void closeUp(DeviceRows &rows) {
  if (rows.rows > 1 && rows.rowBytes == rows.step) {
    rows.rowBytes *= rows.rows;
    rows.rows = 1;
  }
  if (rows.rows == 1 && rows.outer > 1 && rows.rowBytes == rows.outerStep) {
    rows.rowBytes *= rows.outer;
    rows.outer = 1;
  }
  if (rows.rows == 1) {
    rows.rows = rows.outer;
    rows.step = rows.rows > 1 ? rows.outerStep : 0;
    rows.outer = 1;
  }
  if (rows.outer == 1)
    rows.outerStep = 0;
}

DeviceFill Sequence::fillOf(const Step &step) const {
  const uint64_t *values = slots.data() + step.firstSlot;
  // `held` points to the pattern of the fill, followed by its size.
  const uint64_t *held = values + (step.kind == Step::Kind::Fill ? 1 : 4);
  auto size = static_cast<int>(held[1]);
  DeviceRows rows = rowsOf(step);
  bool isJoined = step.kind == Step::Kind::FillRows && isDense(rows);
  return {rows, repeatPattern(held, size), size, isJoined};
}

void Sequence::append(const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  auto size = static_cast<uint64_t>(fill.patternBytes);
  if (isDense(rows) && !fill.isJoined)
    return addWork(Step::Kind::Fill,
                   {rows.address, fill.pattern, size,
                    static_cast<uint64_t>(rows.rowBytes) / size});
  uint64_t bits = 0;
  std::memcpy(&bits, &fill.pattern, size);
  addRows(Step::Kind::FillRows, rows, bits, fill.patternBytes);
}

void Sequence::addFill(const DeviceRows &rows, const void *pattern,
                       int patternBytes) {
  DeviceFill fill{rows, repeatPattern(pattern, patternBytes), patternBytes};
  closeUp(fill.rows);
  // The new fill is compared with the last fills of the sequence. stays:
  // whether each of them stays, the last fill first. place: the position of the
  // new fill.
  constexpr size_t most = 16;
  bool stays[most];
  size_t first = steps.size(), place = steps.size();
  for (size_t at = steps.size();
       at > 0 && steps.size() - at < most && steps[at - 1].isFill(); --at) {
    DeviceFill before = fillOf(steps[at - 1]);
    if (first == steps.size() && isFilledAgain(fill, before) &&
        isUniform(fill.pattern) && before.pattern == fill.pattern)
      return;
    bool isBefore = false, isBehind = false;
    if (before.pattern == fill.pattern &&
        before.patternBytes == fill.patternBytes) {
      isBefore = isBeside(before.rows, fill.rows);
      isBehind = isBeside(fill.rows, before.rows);
    }
    bool isPart = isBefore || isBehind;
    if (isPart) {
      int64_t bytes = before.rows.rowBytes + fill.rows.rowBytes;
      if (isBefore)
        fill.rows = before.rows;
      fill.rows.rowBytes = bytes;
      fill.isJoined = true;
      closeUp(fill.rows);
      place = at - 1;
    }
    stays[steps.size() - at] = !isPart && !isFilledAgain(before, fill);
    if (!stays[steps.size() - at])
      first = at - 1;
    else if (!canChangePlaces(before, fill))
      break;
  }
  // The fills behind the first removed fill are appended anew.
  std::vector<DeviceFill> again;
  for (size_t at = first; at < steps.size(); ++at) {
    if (at == place)
      again.push_back(fill);
    if (stays[steps.size() - 1 - at])
      again.push_back(fillOf(steps[at]));
  }
  if (place == steps.size())
    again.push_back(fill);
  if (first < steps.size()) {
    hash = steps[first].hashBefore;
    slots.resize(steps[first].firstSlot);
    steps.resize(first);
  }
  for (const DeviceFill &each : again)
    append(each);
}
