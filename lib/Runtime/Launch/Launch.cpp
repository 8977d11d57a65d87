//===- Launch.cpp - The state of one launch -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Scratch memory and failures of a launch, and the text of values.
//
//===----------------------------------------------------------------------===//

#include "Launch.h"
#include "tai/Runtime/Launch/Safepoint.h"
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <sys/mman.h>
#include <unistd.h>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Arena
//===----------------------------------------------------------------------===//

static constexpr int64_t smallestBlock = 256 << 10;

Arena::~Arena() {
  for (const Block &block : blocks)
    unmap(block);
}

bool Arena::map(int64_t bytes, Block &block) {
  void *memory =
      mmap(nullptr, static_cast<size_t>(bytes), PROT_READ | PROT_WRITE,
           MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED)
    return false;
  block = {static_cast<char *>(memory), bytes, 0, 0};
  return true;
}

void Arena::unmap(const Block &block) {
  munmap(block.address, static_cast<size_t>(block.size));
}

char *Arena::allocate(int64_t bytes, int64_t &dirtyBytes) {
  std::lock_guard<std::mutex> lock(mutex);
  if (blocks.empty() || blocks.back().size - blocks.back().used < bytes) {
    Block block;
    int64_t size = std::max({smallestBlock, bytes, wanted});
    if (!blocks.empty())
      size =
          std::max(size, std::min<int64_t>(2 * blocks.back().size, 64 << 20));
    if (!map(size, block))
      return nullptr;
    blocks.push_back(block);
  }
  Block &block = blocks.back();
  char *address = block.address + block.used;
  dirtyBytes = std::clamp<int64_t>(block.touched - block.used, 0, bytes);
  block.used += bytes;
  block.touched = std::max(block.touched, block.used);
  anyUsed = true;
  return address;
}

void Arena::reset() {
  if (blocks.size() > 1) {
    wanted = 0;
    for (const Block &block : blocks) {
      wanted += block.used;
      unmap(block);
    }
    blocks.clear();
  } else if (!blocks.empty()) {
    blocks.back().used = 0;
  }
  anyUsed = false;
}

//===----------------------------------------------------------------------===//
// Launch
//===----------------------------------------------------------------------===//

Launch::~Launch() { freeSinks(); }

bool Launch::look() {
  // What there is to ask, the thread that launched asks.
  if (safepoint::isWorker())
    return !hasFailed();
  __atomic_store_n(&tick, safepoint::now(), __ATOMIC_RELAXED);
  if (!hasFailed() && !owner().interruptRequested() && safepoint::look())
    return true;
  fail(Status::failure(StatusCode::Interrupted, "interrupted"));
  // Workers look at their next safepoint, not at the next tick.
  __atomic_store_n(&tick, 0, __ATOMIC_RELAXED);
  return false;
}

void Launch::fail(Status status) {
  std::lock_guard<std::mutex> lock(failureMutex);
  if (failed.load(std::memory_order_relaxed))
    return;
  failure = std::move(status);
  failed.store(true, std::memory_order_release);
}

Status Launch::takeFailure() {
  std::lock_guard<std::mutex> lock(failureMutex);
  failed.store(false, std::memory_order_relaxed);
  return std::move(failure);
}

/// A failed launch may go on to its end, so it needs memory to write to even
/// where there is none: a piece of a file mapped again and again.
void *Launch::sink(int64_t bytes) {
  constexpr size_t pieceSize = size_t(64) << 20, most = size_t(1) << 38;
  std::lock_guard<std::mutex> lock(failureMutex);
  size_t size = static_cast<size_t>(std::max<int64_t>(bytes, 1));
  size = std::min((size + pieceSize - 1) / pieceSize * pieceSize, most);
  void *memory = mmap(nullptr, size, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED) {
    // Not even addresses are left: one page, better than null.
    size = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    memory = mmap(nullptr, size, PROT_READ | PROT_WRITE,
                  MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory == MAP_FAILED) {
      alignas(64) static thread_local char lastResort[4096];
      return lastResort;
    }
    sinks.emplace_back(memory, size);
    return memory;
  }
  int file = memfd_create("tai-sink", MFD_CLOEXEC);
  if (file >= 0) {
    if (ftruncate(file, static_cast<off_t>(pieceSize)) == 0)
      for (size_t at = 0; at < size; at += pieceSize)
        if (mmap(static_cast<char *>(memory) + at, pieceSize,
                 PROT_READ | PROT_WRITE, MAP_SHARED | MAP_FIXED, file,
                 0) == MAP_FAILED)
          break;
    close(file);
  }
  sinks.emplace_back(memory, size);
  return memory;
}

void Launch::freeSinks() {
  for (auto &[memory, size] : sinks)
    munmap(memory, size);
  sinks.clear();
}

//===----------------------------------------------------------------------===//
// Text
//===----------------------------------------------------------------------===//

/// The shortest text that reads back as the same number; of numbers that came
/// from f32, the shortest that reads back as the same f32.
static void appendFloat(std::string &text, double value) {
  if (std::isnan(value)) {
    text += "nan";
    return;
  }
  if (std::isinf(value)) {
    text += value < 0 ? "-inf" : "inf";
    return;
  }
  char digits[64];
  float narrow = static_cast<float>(value);
  std::to_chars_result end =
      static_cast<double>(narrow) == value
          ? std::to_chars(digits, digits + sizeof(digits), narrow)
          : std::to_chars(digits, digits + sizeof(digits), value);
  size_t start = text.size();
  text.append(digits, end.ptr);
  if (text.find_first_of(".e", start) == std::string::npos)
    text += ".0";
}

static void appendValue(std::string &text, int32_t kind, uint64_t slot) {
  switch (kind) {
  case TAI_VALUE_I64:
    text += std::to_string(static_cast<int64_t>(slot));
    return;
  case TAI_VALUE_U64:
    text += std::to_string(slot);
    return;
  case TAI_VALUE_BOOL:
    text += (slot & 0xff) ? "true" : "false";
    return;
  case TAI_VALUE_F64: {
    double value;
    std::memcpy(&value, &slot, sizeof(value));
    appendFloat(text, value);
    return;
  }
  }
  text += "?";
}

std::string mlir::tai::runtime::formatValues(const char *format, int32_t count,
                                             const int32_t *kinds,
                                             const int32_t *shapes,
                                             const uint64_t *slots) {
  std::string text;
  int32_t next = 0;
  auto appendNext = [&] {
    int32_t components = shapes ? shapes[next] : 1;
    if (components != 1)
      text += '[';
    for (int32_t c = 0; c < components; ++c) {
      if (c)
        text += ", ";
      appendValue(text, kinds[next], *slots++);
    }
    if (components != 1)
      text += ']';
    ++next;
  };
  for (const char *at = format ? format : ""; *at; ++at) {
    if (at[0] == '{' && at[1] == '}' && next < count) {
      appendNext();
      ++at;
    } else {
      text += *at;
    }
  }
  // Values without a place of their own are not lost.
  while (next < count) {
    if (!text.empty())
      text += ' ';
    appendNext();
  }
  return text;
}

std::string mlir::tai::runtime::formatBytes(int64_t bytes) {
  const char *units[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
  double value = static_cast<double>(bytes);
  int unit = 0;
  for (; value >= 1024 && unit < 6; ++unit)
    value /= 1024;
  char text[32];
  std::snprintf(text, sizeof(text), unit ? "%.1f %s" : "%.0f %s", value,
                units[unit]);
  return text;
}
