//===- Sequence.h - Work for a device, in order -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROGRAMS_SEQUENCE_H
#define TAI_RUNTIME_PROGRAMS_SEQUENCE_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Programs/ProgramSchedule.h"
#include <algorithm>
#include <cstring>
#include <functional>
#include <memory>
#include <unordered_map>

namespace mlir::tai::runtime::programs {

struct Function : DeviceFunction {
  DeviceFunction *function = nullptr;
  std::string name;
  /// The LLVM bitcode of the module, shared by its functions: programs that use
  /// the bitcode can outlive the module.
  std::shared_ptr<const std::string> bitcode;
  /// DeviceImage::key of the module.
  std::string imageKey;
  /// The accesses of the function, prepared for queries; null if they are not
  /// known.
  std::shared_ptr<const Footprint> footprint;
  /// The accesses of the function's iterations; null if the function cannot run
  /// in tiles.
  std::shared_ptr<const FunctionAccesses> accesses;
};

struct Module : DeviceModule {
  ~Module() override {
    if (whenGone)
      whenGone(*this);
  }
  bool has(const DeviceFunction *function) const {
    return std::any_of(
        functions.begin(), functions.end(),
        [&](const auto &known) { return known.get() == function; });
  }
  /// Tells the owner of deferred work, which may refer to the functions.
  std::function<void(Module &)> whenGone;
  std::unique_ptr<DeviceModule> module;
  std::shared_ptr<const std::string> bitcode;
  std::string key;
  std::vector<std::unique_ptr<Function>> functions;
  std::unordered_map<std::string, std::shared_ptr<const Footprint>> footprints;
  std::unordered_map<std::string, std::shared_ptr<const FunctionAccesses>>
      tileable;
};

struct Step {
  enum class Kind : uint32_t {
    Launch,
    Fill,
    Copy,
    FillRows,
    CopyRows,
    SwapRows
  };
  Kind kind;
  /// The number of parameter slots; a launch also has a function and a shape.
  unsigned numSlots = 0;
  Function *function = nullptr;
  LaunchShape shape;
  /// The position of the step's parameter slots in the sequence. Launch: the
  /// parameters. Fill: address, pattern, its size, count. Copy: destination,
  /// source, bytes. Rows: address, step, rowBytes, rows; other address and
  /// step, or pattern and its size; outerStep, outer.
  size_t firstSlot = 0;
  /// The hash of all steps of the sequence before this step.
  uint64_t hashBefore = 0;

  bool isFill() const { return kind == Kind::Fill || kind == Kind::FillRows; }
};

/// A sequence of steps.
struct Sequence {
  std::vector<Step> steps;
  std::vector<uint64_t> slots;
  /// A hash of the steps without their parameter slots.
  uint64_t hash = 14695981039346656037ull;

  bool empty() const { return steps.empty(); }
  void addLaunch(Function &function, const LaunchShape &shape,
                 const uint64_t *values, int count) {
    Step step{Step::Kind::Launch, static_cast<unsigned>(count), &function,
              shape, slots.size()};
    slots.insert(slots.end(), values, values + count);
    add(step);
  }
  /// Adds a fill. Merges adjacent consecutive fills into one step, such as
  /// fills of fields that share cells; drops fills whose bytes are filled again
  /// immediately.
  void addFill(const DeviceRows &rows, const void *pattern, int patternBytes);
  DeviceFill fillOf(const Step &step) const;
  void addCopy(DevicePtr to, DevicePtr from, int64_t bytes) {
    addWork(Step::Kind::Copy, {to, from, static_cast<uint64_t>(bytes)});
  }

  void addRows(Step::Kind kind, const DeviceRows &rows, uint64_t other,
               int64_t step) {
    addWork(kind,
            {rows.address, static_cast<uint64_t>(rows.step),
             static_cast<uint64_t>(rows.rowBytes),
             static_cast<uint64_t>(rows.rows), other,
             static_cast<uint64_t>(step), static_cast<uint64_t>(rows.outerStep),
             static_cast<uint64_t>(rows.outer)});
  }

  /// Appends all steps of another sequence.
  void append(const Sequence &other);
  bool hasStructureOf(const Sequence &other) const;
  /// Queues all steps.
  Status run(Device &device) const;
  /// Queues a step.
  Status run(Device &device, const Step &step) const;
  StepMemory memoryOf(const Step &step) const;
  /// The maximum number of threads that a step of the sequence uses.
  unsigned width() const;
  /// The number of launches at the start of the sequence, before the first step
  /// of another kind.
  size_t countFirstLaunches() const;
  /// The launched functions, in order of first use.
  std::vector<const Function *> listParts() const;
  /// True if all launched functions can be parts of programs.
  bool areAllPartsKnown() const;
  /// True if the sequence launches functions of the module.
  bool uses(const Module &module) const;

private:
  DeviceRows rowsOf(const Step &step) const;
  void append(const DeviceFill &fill);
  void add(const Step &step) {
    steps.push_back(step);
    steps.back().hashBefore = hash;
    auto mix = [&](uint64_t value) {
      hash = (hash ^ value) * 1099511628211ull;
    };
    mix(static_cast<uint64_t>(step.kind));
    mix(reinterpret_cast<uintptr_t>(step.function));
    mix(uint64_t(step.shape.blocks) << 32 | step.shape.threads);
  }
  void addWork(Step::Kind kind, std::initializer_list<uint64_t> values) {
    Step step{kind, static_cast<unsigned>(values.size()), nullptr,
              LaunchShape(), slots.size()};
    slots.insert(slots.end(), values.begin(), values.end());
    add(step);
  }
};

} // namespace mlir::tai::runtime::programs

#endif // TAI_RUNTIME_PROGRAMS_SEQUENCE_H
