//===- EmulatedThreads.cpp - Blocks of several threads on the CPU ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "EmulatedThreads.h"
#include "tai/ABI/DeviceAbi.h"
#include <algorithm>
#include <csetjmp>
#include <cstdlib>
#include <sys/mman.h>
#include <ucontext.h>
#include <utility>
#include <vector>

using namespace mlir::tai::runtime;

unsigned mlir::tai::runtime::emulatedThreads() {
  const char *given = std::getenv("TAI_EMULATED_THREADS");
  long number = given ? std::strtol(given, nullptr, 10) : 1;
  if (number <= 1)
    return 1;
  // The number of threads is rounded up to whole warps, which ordered additions
  // need.
  auto threads = static_cast<unsigned>(std::min(number, 1024l));
  return (threads + kEmulatedWarp - 1) / kEmulatedWarp * kEmulatedWarp;
}

namespace {
enum class State { Ready, AtWarpBarrier, AtBlockBarrier, Ended };

struct Thread {
  State state = State::Ready;
  /// The values that this emulated thread passed in the last two exchanges,
  /// which other threads of the warp read. A slot is free again after the next
  /// exchange.
  uint64_t published[2] = {};
  unsigned exchanges = 0;
};

/// A stack on which a thread of one block runs, and then threads of later
/// blocks. After the first entry, the fiber is left and entered by jumps, which
/// make no system calls.
class Fiber {
public:
  Fiber() = default;
  Fiber(const Fiber &) = delete;
  Fiber &operator=(const Fiber &) = delete;
  ~Fiber() {
    if (memory != MAP_FAILED)
      munmap(memory, bytes);
  }
  bool reserve() {
    if (memory == MAP_FAILED)
      memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                    MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    return memory != MAP_FAILED;
  }
  /// Resumes the fiber where it was suspended, until it suspends itself again.
  void enter(std::jmp_buf &from, void (*start)());
  void leave(std::jmp_buf &to) {
    if (_setjmp(place) == 0)
      _longjmp(to, 1);
  }
  /// Notes that the thread on this fiber will never end, so that the next entry
  /// starts anew.
  void abandon() { isStarted = false; }

private:
  static constexpr size_t bytes = size_t(1) << 20;
  void *memory = MAP_FAILED;
  bool isStarted = false;
  std::jmp_buf place;
};

class Block {
public:
  Block(unsigned threads, const std::function<void()> &body)
      : body(body), threads(threads) {}

  bool run(uint64_t order);
  /// Suspends the running thread at a barrier, in state `barrier`, until the
  /// scheduler resumes it.
  void meet(State barrier);
  unsigned size() const { return static_cast<unsigned>(threads.size()); }
  uint64_t exchange(uint64_t value, uint32_t from);
  uint32_t match(uint64_t value);

  unsigned running = 0;

private:
  static void start();
  unsigned publish(uint64_t value);
  unsigned firstOfWarp() const {
    return running / kEmulatedWarp * kEmulatedWarp;
  }
  bool releaseWarps();
  bool releaseBlock();

  const std::function<void()> &body;
  std::vector<Thread> threads;
  std::jmp_buf scheduler;
};
} // namespace

static thread_local Block *current = nullptr;

/// The fibers of finished blocks, which the next block reuses.
static thread_local std::vector<std::unique_ptr<Fiber>> fibers;

void Fiber::enter(std::jmp_buf &from, void (*start)()) {
  if (_setjmp(from) != 0)
    return;
  if (isStarted)
    _longjmp(place, 1);
  isStarted = true;
  ucontext_t context;
  getcontext(&context);
  context.uc_stack.ss_sp = memory;
  context.uc_stack.ss_size = bytes;
  context.uc_link = nullptr;
  makecontext(&context, start, 0);
  setcontext(&context);
}

void Block::meet(State barrier) {
  threads[running].state = barrier;
  fibers[running]->leave(scheduler);
}

/// The start of a fiber: runs a thread of the current block, and then threads
/// of later blocks.
void Block::start() {
  for (;;) {
    current->body();
    current->meet(State::Ended);
  }
}

/// Resumes the warps of an emulated block in which every thread has come to a
/// warp barrier or ended.
bool Block::releaseWarps() {
  bool any = false;
  for (unsigned first = 0; first < size(); first += kEmulatedWarp) {
    auto begin = threads.begin() + first;
    auto end = begin + std::min(kEmulatedWarp, size() - first);
    auto waits = [](const Thread &t) {
      return t.state == State::AtWarpBarrier;
    };
    if (std::none_of(begin, end, waits) ||
        !std::all_of(begin, end, [&](const Thread &thread) {
          return waits(thread) || thread.state == State::Ended;
        }))
      continue;
    for (auto thread = begin; thread != end; ++thread)
      if (waits(*thread))
        thread->state = State::Ready;
    any = true;
  }
  return any;
}

/// Resumes all threads of an emulated block if each thread has come to a block
/// barrier or ended.
bool Block::releaseBlock() {
  for (const Thread &thread : threads)
    if (thread.state != State::AtBlockBarrier && thread.state != State::Ended)
      return false;
  bool any = false;
  for (Thread &thread : threads)
    if (thread.state == State::AtBlockBarrier) {
      thread.state = State::Ready;
      any = true;
    }
  return any;
}

bool Block::run(uint64_t order) {
  while (fibers.size() < size())
    fibers.push_back(std::make_unique<Fiber>());
  for (unsigned i = 0; i < size(); ++i)
    if (!fibers[i]->reserve())
      return false;
  Block *outer = std::exchange(current, this);
  do {
    for (unsigned i = 0; i < size(); ++i) {
      unsigned place = static_cast<unsigned>((i + order) % size());
      running = order % 2 ? size() - 1 - place : place;
      if (threads[running].state == State::Ready)
        fibers[running]->enter(scheduler, start);
    }
    ++order;
  } while (releaseWarps() || releaseBlock());
  current = outer;
  bool allEnded = true;
  for (unsigned i = 0; i < size(); ++i)
    if (threads[i].state != State::Ended) {
      fibers[i]->abandon();
      allEnded = false;
    }
  return allEnded;
}

/// Passes a value to all threads of the warp. Returns the slot of `published`
/// in which the threads have their values.
unsigned Block::publish(uint64_t value) {
  Thread &self = threads[running];
  unsigned slot = self.exchanges++ % 2;
  self.published[slot] = value;
  meet(State::AtWarpBarrier);
  return slot;
}

uint32_t Block::match(uint64_t value) {
  unsigned slot = publish(value), first = firstOfWarp();
  uint32_t same = 0;
  for (unsigned lane = 0; lane < kEmulatedWarp && first + lane < size(); ++lane)
    same |= uint32_t(threads[first + lane].published[slot] == value) << lane;
  return same;
}

uint64_t Block::exchange(uint64_t value, uint32_t from) {
  unsigned slot = publish(value), source = firstOfWarp() + from;
  return from < kEmulatedWarp && source < size()
             ? threads[source].published[slot]
             : value;
}

bool mlir::tai::runtime::runEmulatedBlock(unsigned threads, uint64_t order,
                                          const std::function<void()> &body) {
  if (threads <= 1) {
    Block *outer = std::exchange(current, nullptr);
    body();
    current = outer;
    return true;
  }
  return Block(threads, body).run(order);
}

//===----------------------------------------------------------------------===//
// Functions for device code
//===----------------------------------------------------------------------===//

extern "C" int32_t tai_emu_thread_id(void) {
  return current ? static_cast<int32_t>(current->running) : 0;
}
extern "C" int32_t tai_emu_block_dim(void) {
  return current ? static_cast<int32_t>(current->size()) : 1;
}
extern "C" void tai_emu_block_barrier(void) {
  if (current)
    current->meet(State::AtBlockBarrier);
}
extern "C" void tai_emu_warp_barrier(void) {
  if (current)
    current->meet(State::AtWarpBarrier);
}
extern "C" uint32_t tai_emu_match(uint64_t value) {
  return current ? current->match(value) : 1;
}
extern "C" uint64_t tai_emu_exchange(uint64_t value, uint32_t from) {
  return current ? current->exchange(value, from) : value;
}
