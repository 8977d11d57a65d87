//===- Launch.cpp - The state of one launch -------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Scratch memory and failures of a launch.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Storage/Halos.h"
#include "tai/Runtime/Threads/Section.h"
#include <algorithm>
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
  block = {static_cast<char *>(memory), bytes, 0, 0, 0, 0};
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
    blocks.reserve(blocks.size() + 1);
    if (!map(size, block))
      return nullptr;
    blocks.push_back(block);
  }
  Block &block = blocks.back();
  char *address = block.address + block.used;
  dirtyBytes = std::clamp<int64_t>(block.touched - block.used, 0, bytes);
  int64_t begin = block.used, end = begin + bytes;
  if (block.zeroBegin <= begin && block.zeroEnd >= std::min(end, block.touched))
    dirtyBytes = 0;
  // From now on, only the free part of the block after this allocation is known
  // to be zero.
  block.zeroBegin = std::max(block.zeroBegin, end);
  block.used = end;
  block.touched = std::max(block.touched, block.used);
  anyUsed = true;
  return address;
}

void Arena::markZero(const char *address, int64_t bytes) {
  std::lock_guard<std::mutex> lock(mutex);
  for (Block &block : blocks) {
    int64_t begin = address - block.address, end = begin + bytes;
    if (begin < 0 || end > block.used)
      continue;
    bool touches = block.zeroBegin <= end && block.zeroEnd >= begin;
    block.zeroBegin = touches ? std::min(block.zeroBegin, begin) : begin;
    block.zeroEnd = touches ? std::max(block.zeroEnd, end) : end;
    return;
  }
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
  // Only the thread that launched polls for signals; worker threads stop once
  // the launch has failed.
  if (safepoint::isWorker())
    return !hasFailed();
  __atomic_store_n(&tick, safepoint::now(), __ATOMIC_RELAXED);
  if (!hasFailed() && !owner().launcher().interruptRequested() &&
      safepoint::look())
    return true;
  fail(failAsInterrupted());
  // The tick in the frame is cleared, so that worker threads call look() at
  // their next safepoint, not only after the next tick.
  __atomic_store_n(&tick, 0, __ATOMIC_RELAXED);
  return false;
}

void Launch::fail(Status status) {
  std::lock_guard<std::mutex> lock(failureMutex);
  if (failed.load(std::memory_order_relaxed))
    return;
  failure = std::move(status);
  // Loops may have ended in the middle.
  owner().halos().removeAll();
  failed.store(true, std::memory_order_release);
}

void Launch::failWithoutMemory() noexcept {
  std::lock_guard<std::mutex> lock(failureMutex);
  failed.store(true, std::memory_order_release);
}

Status Launch::takeFailure() {
  std::lock_guard<std::mutex> lock(failureMutex);
  failed.store(false, std::memory_order_relaxed);
  if (failure.ok())
    return Status::failure(StatusCode::Memory, "out of memory");
  return std::move(failure);
}

void Launch::recover() noexcept {
  failed.store(false, std::memory_order_relaxed);
  failure = Status();
  freeSinks();
  arena.reset();
  loops.clear();
  filtered.clear();
  fetched.clear();
  given = nullptr;
  primalName = nullptr;
  flags = nullptr;
  host = nullptr;
  measured = nullptr;
  end();
}

/// A failed launch may run to its end, and then needs memory to write to
/// although there is none: one piece of a file is mapped to all addresses of
/// the sink.
void *Launch::sink(int64_t bytes) {
  constexpr size_t pieceSize = size_t(64) << 20, most = size_t(1) << 38;
  std::lock_guard<std::mutex> lock(failureMutex);
  size_t size = static_cast<size_t>(std::max<int64_t>(bytes, 1));
  size = std::min((size + pieceSize - 1) / pieceSize * pieceSize, most);
  void *memory = mmap(nullptr, size, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (memory == MAP_FAILED) {
    // If the system refuses even the address space, one page that may be
    // written is better than null.
    size = static_cast<size_t>(sysconf(_SC_PAGESIZE));
    memory = mmap(nullptr, size, PROT_READ | PROT_WRITE,
                  MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory == MAP_FAILED) {
      alignas(64) static thread_local char lastResort[4096];
      return lastResort;
    }
    noteSink(memory, size);
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
  noteSink(memory, size);
  return memory;
}

void Launch::noteSink(void *memory, size_t size) {
  try {
    sinks.emplace_back(memory, size);
  } catch (...) {
    // The list of sinks (memory for failed launches) cannot grow: `memory` is
    // leaked, but the launch can end.
  }
}

void Launch::freeSinks() {
  for (auto &[memory, size] : sinks)
    munmap(memory, size);
  sinks.clear();
}

int64_t Launch::partition(int64_t n, int64_t cost, bool reduces) {
  Workers &workers = owner().workers();
  measured = nullptr;
  // The compiler's estimate of the cost of an iteration is assumed to be wrong
  // by less than this factor.
  constexpr double factor = 16;
  double total = static_cast<double>(n) * static_cast<double>(cost);
  if (workers.threads() == 1 || !loopTimes ||
      total * factor < Workers::leastNs ||
      total > Workers::leastNs * factor * factor)
    return workers.partition(n, static_cast<double>(cost), reduces);
  LoopTimes::Entry *entry = loopTimes->find(cost);
  if (!entry)
    return workers.partition(n, static_cast<double>(cost), reduces);
  bool wantsRun = entry->wantsRun();
  entry->noteRun();
  if (!wantsRun)
    return workers.partition(n, entry->perIteration(), reduces);
  measured = entry;
  return 1;
}

//===----------------------------------------------------------------------===//
// Elements that launches touch
//===----------------------------------------------------------------------===//

bool mlir::tai::runtime::mayAlias(const OwedZeros &zeros, const Access &access,
                                  const uint64_t *args) {
  return std::all_of(
      access.fixed.begin(), access.fixed.end(), [&](const FixedIndex &index) {
        int64_t first = access.field->firstIndex(index.dimension);
        return zeros.contains(index.dimension, index.evaluate(args) - first);
      });
}

bool mlir::tai::runtime::findElements(const StoredBox &box, const Field &field,
                                      const uint64_t *args,
                                      OwedZeros::Box &elements) {
  for (const StoredBox::Range &loop : box.loops)
    if (loop.lower.evaluate(args) >= loop.upper.evaluate(args))
      return false;
  elements.lower.clear();
  elements.upper.clear();
  for (size_t d = 0; d < box.ranges.size(); ++d) {
    int64_t first = field.firstIndex(static_cast<int64_t>(d));
    int64_t lower = box.ranges[d].lower.evaluate(args) - first;
    int64_t upper = box.ranges[d].upper.evaluate(args) - first;
    lower = std::max<int64_t>(lower, 0);
    upper = std::min(upper, field.shape()[d]);
    if (lower >= upper)
      return false;
    elements.lower.push_back(lower);
    elements.upper.push_back(upper);
  }
  return true;
}
