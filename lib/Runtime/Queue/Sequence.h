//===- Sequence.h - Work for a device, in order -----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_QUEUE_SEQUENCE_H
#define TAI_LIB_RUNTIME_QUEUE_SEQUENCE_H

#include "ProgramSchedule.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include <algorithm>
#include <cstring>

namespace mlir::tai::runtime {

struct DeviceQueue::Function : DeviceFunction {
  DeviceFunction *function = nullptr;
  std::string name;
  /// Shared by all functions of a module, which may go before its programs.
  std::shared_ptr<const std::string> bitcode;
  /// Null where it is not known what it touches.
  std::shared_ptr<const Footprint> footprint;
  /// Null where it cannot run in tiles.
  std::shared_ptr<const FunctionAccesses> accesses;
};

struct DeviceQueue::Module : DeviceModule {
  /// What has been kept may launch its functions.
  ~Module() override {
    if (queue)
      queue->forget(*this);
  }
  bool has(const DeviceFunction *function) const {
    return std::any_of(
        functions.begin(), functions.end(),
        [&](const auto &known) { return known.get() == function; });
  }
  DeviceQueue *queue = nullptr;
  std::unique_ptr<DeviceModule> module;
  std::shared_ptr<const std::string> bitcode;
  std::vector<std::unique_ptr<Function>> functions;
  std::unordered_map<std::string, std::shared_ptr<const Footprint>> footprints;
  std::unordered_map<std::string, std::shared_ptr<const FunctionAccesses>>
      tileable;
};

struct DeviceQueue::Step {
  enum class Kind : uint32_t {
    Launch,
    Fill,
    Copy,
    FillRows,
    CopyRows,
    SwapRows
  };
  Kind kind;
  /// Of launches.
  unsigned numSlots = 0;
  Function *function = nullptr;
  LaunchShape shape;
  /// In the slots of the sequence: the parameters; of a fill the address, the
  /// pattern, its size and the count; of a copy both addresses and the size. Of
  /// rows these four numbers, and the other address and step, or the pattern
  /// and its size.
  size_t firstSlot = 0;
  /// Of the sequence in front of it.
  uint64_t hashBefore = 0;

  bool isFill() const { return kind == Kind::Fill || kind == Kind::FillRows; }
};

/// Work, in order.
struct DeviceQueue::Sequence {
  std::vector<Step> steps;
  std::vector<uint64_t> slots;
  /// Of what the steps are, without the slots.
  uint64_t hash = 14695981039346656037ull;

  bool empty() const { return steps.empty(); }
  void addLaunch(Function &function, const LaunchShape &shape,
                 const uint64_t *values, int count) {
    Step step{Step::Kind::Launch, static_cast<unsigned>(count), &function,
              shape, slots.size()};
    slots.insert(slots.end(), values, values + count);
    add(step);
  }
  /// Fills with nothing but fills between them that lie side by side are one
  /// step: those of fields that share their cells, say. What is filled again
  /// before anything else happens is left out.
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

  /// Adds all of the other one.
  void append(const Sequence &other);
  bool hasStructureOf(const Sequence &other) const;
  /// Queues a step.
  Status run(Device &device, const Step &step) const;
  StepMemory memoryOf(const Step &step) const;
  /// The most threads that a step has work for.
  unsigned getWidth() const;
  /// So many launches come before anything else.
  size_t countFirstLaunches() const;
  /// The functions of its launches, in the order in which they come first.
  std::vector<const Function *> listParts() const;
  /// Whether programs can be made of them.
  bool areAllPartsKnown() const;
  /// Whether it launches functions of the module.
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

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_QUEUE_SEQUENCE_H
