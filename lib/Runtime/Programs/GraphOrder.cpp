//===- GraphOrder.cpp - The order of a graph's steps ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "GraphOrder.h"
#include "tai/Runtime/Device/FillRun.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::programs;

GraphOrder::GraphOrder(const Sequence &sequence) : sequence(sequence) {
  // The number of comparisons of steps that may still be made.
  size_t left = 4096;
  order.reserve(sequence.steps.size());
  for (uint32_t i = 0; i < sequence.steps.size(); ++i) {
    const Step &step = sequence.steps[i];
    size_t place = order.size();
    if (step.isFill() && place > 0 && left > 0) {
      StepMemory memory = sequence.memoryOf(step);
      for (; place > 0 && left > 0; --place, --left) {
        const Step &before = (*this)[place - 1];
        if (before.isFill())
          break;
        if (getRelation(sequence.memoryOf(before), memory) !=
            StepRelation::None) {
          place = order.size();
          break;
        }
      }
      if (left == 0)
        place = order.size();
    }
    order.insert(order.begin() + static_cast<ptrdiff_t>(place), i);
  }
}

static int64_t bytesOf(const DeviceRows &rows) {
  return rows.rowBytes * rows.rows * rows.outer;
}

static StepMemory memoryOf(const DeviceRows &rows) {
  StepMemory memory;
  auto number = [](int64_t value) { return static_cast<uint64_t>(value); };
  for (int64_t group = 0; group < rows.outer; ++group)
    memory.addRows(DeviceAccess::Write,
                   rows.address + number(group * rows.outerStep),
                   number(rows.step), number(rows.rowBytes), number(rows.rows));
  return memory;
}

std::optional<GraphOrder::FrontFills> GraphOrder::splitFront() const {
  // Below these limits, a parallel branch of fills does not pay: the step that
  // waits for it breaks the chain of overlapping launches, which costs as much
  // as some microseconds of filling. Large fills use all memory bandwidth,
  // wherever they run.
  constexpr int64_t fewestBytes = 4 << 20;
  constexpr size_t fewestLaunches = 16, mostSteps = 4096;
  constexpr int64_t mostGroups = 64;
  FillRun run;
  size_t count = 0;
  for (; count < size() && (*this)[count].isFill(); ++count)
    if (!run.add(sequence.fillOf((*this)[count])))
      return std::nullopt;
  // A fill among the steps, its memory, and the first later step that accesses
  // this memory.
  struct Fill {
    const DeviceFill *fill;
    StepMemory memory;
    size_t touched;
  };
  std::vector<Fill> fills;
  FrontFills front;
  for (const DeviceFill &fill : run.get())
    if (bytesOf(fill.rows) < largeFillBytes() && fill.rows.outer <= mostGroups)
      fills.push_back({&fill, memoryOf(fill.rows), size()});
    else
      front.first.push_back(fill);
  size_t left = fills.size();
  for (size_t at = count; at < size() && left > 0; ++at) {
    bool isFar = at - count >= mostSteps;
    StepMemory memory = isFar ? StepMemory() : sequence.memoryOf((*this)[at]);
    for (Fill &fill : fills)
      if (fill.touched == size() &&
          getRelation(memory, fill.memory) != StepRelation::None) {
        fill.touched = at;
        --left;
      }
  }
  int64_t bytes = 0;
  front.count = count;
  front.join = size();
  for (const Fill &fill : fills)
    if (fill.touched - count < fewestLaunches) {
      front.first.push_back(*fill.fill);
    } else {
      front.aside.push_back(*fill.fill);
      front.join = std::min(front.join, fill.touched);
      bytes += bytesOf(fill.fill->rows);
    }
  if (bytes < fewestBytes)
    return std::nullopt;
  return front;
}
