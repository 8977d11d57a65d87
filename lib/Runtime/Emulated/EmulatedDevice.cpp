//===- EmulatedDevice.cpp - Device code on the CPU ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Runs the device functions of kernels where there is no GPU, for tests. The
// device's memory is separate from the host's, so that missing copies are
// detected, and holds garbage until it is written. Blocks run one after another
// in an order that changes from launch to launch. A block has one thread, for
// which barriers and shuffles are trivial, unless TAI_EMULATED_THREADS requests
// more (see EmulatedThreads.h); blocks of programs always have one thread.
//
//===----------------------------------------------------------------------===//

#include "EmulatedThreads.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Text/Format.h"
#include "tai/Runtime/Threads/Section.h"
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <map>
#include <mutex>
#include <numeric>
#include <set>
#include <sys/mman.h>
#include <unistd.h>
#include <utility>

using namespace mlir::tai::runtime;

namespace {
struct Place {
  int32_t block = 0;
  int32_t blocks = 1;
};
} // namespace

static thread_local Place place;

extern "C" int32_t tai_emu_block_id(void) { return place.block; }
extern "C" int32_t tai_emu_grid_dim(void) { return place.blocks; }

static thread_local struct {
  Place before;
  uint64_t number, next, step;
} group = {};

extern "C" int32_t tai_emu_begin_group(void) {
  // A group has a power of two of threads, so an odd step visits each thread
  // once.
  constexpr int32_t threads = 4;
  group.before = place;
  group.next = group.number++;
  group.step = 1 + group.number / threads % 2 * 2;
  place.blocks = threads;
  return threads;
}
extern "C" void tai_emu_next_in_group(void) {
  place.block = static_cast<int32_t>(group.next % uint64_t(place.blocks));
  group.next += group.step;
}
extern "C" void tai_emu_end_group(void) { place = group.before; }

/// The word that has told the kernel of this thread to stop, or null.
static thread_local uint32_t *stoppedAt = nullptr;

extern "C" void tai_emu_look(uint32_t *stop) {
  static thread_local safepoint::Watch watch;
  if (stoppedAt || watch.look())
    return;
  stoppedAt = stop;
  *stop = safepoint::threadNumber();
}

namespace {
using ThreadFunction = void (*)(const uint64_t *slots);

struct EmulatedFunction : DeviceFunction {
  ThreadFunction run = nullptr;
  /// The most threads that a block of the function can have; 1 for a program of
  /// several kernels, which the emulated device runs with one thread.
  unsigned mostThreads = 1;
};

/// An event of the emulated device is a time: work has ended when the call that
/// queues it returns.
struct EmulatedEvent : DeviceEvent {
  std::chrono::steady_clock::time_point time;
};

struct EmulatedModule : DeviceModule {
  std::shared_ptr<void> library;
  std::map<std::string, EmulatedFunction> functions;
};

class EmulatedDevice final : public Device {
public:
  explicit EmulatedDevice(ObjectLinker linker) : linker(std::move(linker)) {}
  ~EmulatedDevice() override {
    for (const auto &[memory, bytes] : allocations)
      munmap(reinterpret_cast<void *>(memory), mappedBytes(bytes));
  }

  DeviceKind kind() const override { return DeviceKind::Emulated; }
  std::string name() const override { return "emulated"; }
  DeviceLimits limits() const override {
    DeviceLimits limits;
    limits.multiprocessors = 4;
    limits.memoryBytes = memoryBytes;
    // The size of the pieces in which reserved memory is committed: small, so
    // that a test can reach the memory limit.
    limits.reservedPieceBytes = 64 << 10;
    return limits;
  }
  std::string target() const override { return "cpu"; }

  Status allocate(int64_t bytes, DevicePtr &memory) override {
    std::lock_guard<std::mutex> lock(mutex);
    memory = 0;
    void *mapped =
        bytes > memoryBytes - allocated
            ? MAP_FAILED
            : mmap(nullptr, mappedBytes(bytes), PROT_READ | PROT_WRITE,
                   MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (mapped == MAP_FAILED)
      return Status::failure(StatusCode::Memory, "the device has no " +
                                                     formatBytes(bytes) +
                                                     " left");
    memory = reinterpret_cast<DevicePtr>(mapped);
    // New memory is filled with garbage, since no code may rely on zeros; in a
    // large allocation, only the start is filled.
    std::memset(mapped, 0xa5,
                static_cast<size_t>(std::min<int64_t>(bytes, 16 << 20)));
    allocations.emplace(memory, bytes);
    allocated += bytes;
    return Status::success();
  }

  Status reserve(int64_t bytes, DevicePtr &memory) override {
    std::lock_guard<std::mutex> lock(mutex);
    memory = 0;
    void *mapped = mmap(nullptr, mappedBytes(bytes), PROT_READ | PROT_WRITE,
                        MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (mapped == MAP_FAILED)
      return Status::failure(StatusCode::Memory, "the device has no " +
                                                     formatBytes(bytes) +
                                                     " of addresses left");
    memory = reinterpret_cast<DevicePtr>(mapped);
    allocations.emplace(memory, bytes);
    reserved.insert(memory);
    return Status::success();
  }

  void free(DevicePtr memory) override {
    std::lock_guard<std::mutex> lock(mutex);
    auto found = allocations.find(memory);
    if (found == allocations.end())
      return;
    munmap(reinterpret_cast<void *>(memory), mappedBytes(found->second));
    if (reserved.erase(memory) == 0)
      allocated -= found->second;
    allocations.erase(found);
  }

  int64_t allocatedBytes() const override {
    std::lock_guard<std::mutex> lock(mutex);
    return allocated;
  }
  int64_t freeBytes() const override { return memoryBytes - allocatedBytes(); }

  Status copyIn(DevicePtr to, const void *from, int64_t bytes) override {
    Status status = check(to, bytes);
    if (status && bytes > 0)
      std::memcpy(reinterpret_cast<void *>(to), from,
                  static_cast<size_t>(bytes));
    return status;
  }
  Status copyOut(void *to, DevicePtr from, int64_t bytes) override {
    Status status = check(from, bytes);
    if (status && bytes > 0)
      std::memcpy(to, reinterpret_cast<const void *>(from),
                  static_cast<size_t>(bytes));
    return status;
  }
  Status copy(DevicePtr to, DevicePtr from, int64_t bytes) override {
    Status status = check(to, bytes);
    if (status)
      status = check(from, bytes);
    // Ranges that overlap are moved by one memmove, without safepoints.
    bool isApart = to + static_cast<DevicePtr>(bytes) <= from ||
                   from + static_cast<DevicePtr>(bytes) <= to;
    if (!status)
      return status;
    return safepoint::runInPieces(
        bytes, isApart ? bytesPerSafepoint : std::max<int64_t>(bytes, 1),
        /*canStop=*/true, [&](int64_t at, int64_t count) {
          std::memmove(
              reinterpret_cast<void *>(to + static_cast<DevicePtr>(at)),
              reinterpret_cast<const void *>(from + static_cast<DevicePtr>(at)),
              static_cast<size_t>(count));
          return Status::success();
        });
  }

  Status fill(DevicePtr to, const void *pattern, int patternBytes,
              int64_t count) override {
    Status status = check(to, patternBytes * count);
    if (status && to % static_cast<unsigned>(patternBytes) != 0)
      status = Status::failure(StatusCode::Internal,
                               "a fill of device memory is not aligned");
    if (!status)
      return status;
    auto *at = reinterpret_cast<char *>(to);
    const auto *bytes = static_cast<const char *>(pattern);
    if (std::all_of(bytes, bytes + patternBytes, [](char b) { return !b; })) {
      zero(at, patternBytes * count);
      return status;
    }
    return safepoint::runInPieces(
        count, bytesPerSafepoint / patternBytes, /*canStop=*/true,
        [&](int64_t, int64_t some) {
          for (int64_t i = 0; i < some; ++i, at += patternBytes)
            std::memcpy(at, pattern, static_cast<size_t>(patternBytes));
          return Status::success();
        });
  }

  Status copyRows(const DeviceRows &to, DevicePtr from,
                  int64_t fromStep) override {
    Status status = checkRows(to);
    if (status)
      status = checkRows({from, fromStep, to.rowBytes, to.rows});
    if (!status)
      return status;
    return forEachPiece(
        to, /*canStop=*/true, [&](int64_t row, int64_t at, int64_t bytes) {
          auto *source = reinterpret_cast<const char *>(from) + row * fromStep;
          std::memmove(reinterpret_cast<char *>(rowOf(to, row)) + at,
                       source + at, static_cast<size_t>(bytes));
        });
  }
  Status swapRows(const DeviceRows &one, DevicePtr other,
                  int64_t otherStep) override {
    Status status = checkRows(one);
    if (status)
      status = checkRows({other, otherStep, one.rowBytes, one.rows});
    if (!status)
      return status;
    // A swap of two ranges is not stopped halfway, which would leave both sides
    // useless.
    return forEachPiece(
        one, /*canStop=*/false, [&](int64_t row, int64_t at, int64_t bytes) {
          char *mine = reinterpret_cast<char *>(rowOf(one, row)) + at;
          std::swap_ranges(mine, mine + bytes,
                           reinterpret_cast<char *>(other) + row * otherStep +
                               at);
        });
  }
  Status fillRows(const DeviceRows &to, const void *pattern,
                  int patternBytes) override {
    Status status;
    int64_t piece = std::max<int64_t>(
        bytesPerSafepoint / std::max<int64_t>(to.rowBytes, 1), 1);
    for (int64_t group = 0; group < to.outer && status; ++group)
      status = safepoint::runInPieces(
          to.rows, piece, /*canStop=*/true, [&](int64_t first, int64_t count) {
            Status filled;
            for (int64_t row = first; row < first + count && filled; ++row)
              filled = fill(rowOf(to, row) +
                                static_cast<DevicePtr>(group * to.outerStep),
                            pattern, patternBytes, to.rowBytes / patternBytes);
            return filled;
          });
    return status;
  }

  bool isDeviceMemory(const void *address) const override {
    return contains(reinterpret_cast<DevicePtr>(address), 1);
  }

  Status load(const DeviceImage &image,
              std::unique_ptr<DeviceModule> &module) override {
    auto loaded = std::make_unique<EmulatedModule>();
    std::vector<std::string> names;
    names.reserve(image.functions.size());
    for (const std::string &function : image.functions)
      names.push_back(function + ".slots");
    if (!linker || image.kind != DeviceKind::Emulated)
      return Status::failure(StatusCode::Internal,
                             "the emulated device cannot load this code");
    std::vector<void *> addresses;
    Status status = linker(image.bytes, names, addresses, loaded->library);
    if (!status)
      return status;
    for (size_t i = 0; i < names.size(); ++i)
      if (addresses[i]) {
        EmulatedFunction &function = loaded->functions[image.functions[i]];
        function.run = reinterpret_cast<ThreadFunction>(addresses[i]);
        if (image.functions[i] != TAI_PROGRAM_FUNCTION)
          function.mostThreads = emulatedThreads();
      }
    module = std::move(loaded);
    return status;
  }

  Status find(DeviceModule &module, const std::string &name,
              DeviceFunction *&function) override {
    auto &functions = static_cast<EmulatedModule &>(module).functions;
    auto found = functions.find(name);
    if (found == functions.end())
      return Status::failure(StatusCode::Internal,
                             "device code holds no function '" + name + "'");
    function = &found->second;
    return Status::success();
  }

  unsigned mostThreads(const DeviceFunction &function) const override {
    return static_cast<const EmulatedFunction &>(function).mostThreads;
  }
  unsigned residentBlocks(const DeviceFunction &, unsigned) const override {
    return limits().multiprocessors;
  }

  Status launch(DeviceFunction &function, const LaunchShape &shape,
                const uint64_t *slots, int) override {
    // A cooperative launch runs as one block, so that barriers of the grid are
    // barriers of this block.
    unsigned blocks = shape.cooperative ? 1 : shape.blocks;
    ThreadFunction run = static_cast<EmulatedFunction &>(function).run;
    uint64_t order = launches.fetch_add(1, std::memory_order_relaxed);
    // A step that has no divisor in common with the number of blocks reaches
    // each block once.
    uint64_t step = 1 + order % blocks;
    while (std::gcd(step, uint64_t(blocks)) != 1)
      ++step;
    Place before = place;
    place.blocks = static_cast<int32_t>(blocks);
    for (unsigned i = 0; i < blocks; ++i) {
      place.block = static_cast<int32_t>((order + i * step) % blocks);
      if (!runEmulatedBlock(shape.threads, order + i, [&] { run(slots); })) {
        place = before;
        return Status::failure(StatusCode::Internal,
                               "threads of a block wait for others that do not "
                               "come to the same barrier");
      }
    }
    place = before;
    if (__builtin_expect(stoppedAt != nullptr, false)) {
      *std::exchange(stoppedAt, nullptr) = 0;
      return failAsInterrupted();
    }
    return Status::success();
  }

  Status record(std::unique_ptr<DeviceEvent> &event) override {
    if (!event)
      event = std::make_unique<EmulatedEvent>();
    static_cast<EmulatedEvent &>(*event).time =
        std::chrono::steady_clock::now();
    return Status::success();
  }
  Status wait(DeviceEvent &) override { return Status::success(); }
  Status elapsed(const DeviceEvent &from, const DeviceEvent &to,
                 int64_t &ns) override {
    ns = std::chrono::duration_cast<std::chrono::nanoseconds>(
             static_cast<const EmulatedEvent &>(to).time -
             static_cast<const EmulatedEvent &>(from).time)
             .count();
    return Status::success();
  }

  Status waitForStream(uint64_t stream) override { return tell(stream, 0); }
  Status letStreamWait(uint64_t stream) override { return tell(stream, 1); }

  Status synchronize() override { return Status::success(); }

private:
  static Status tell(uint64_t stream, int32_t what) {
    constexpr uint64_t lastDefault = 2;
    if (stream > lastDefault)
      reinterpret_cast<void (*)(int32_t)>(stream)(what);
    return Status::success();
  }

  static size_t mappedBytes(int64_t bytes) {
    auto page = static_cast<int64_t>(sysconf(_SC_PAGESIZE));
    return static_cast<size_t>((bytes / page + 1) * page);
  }

  static DevicePtr rowOf(const DeviceRows &rows, int64_t row) {
    return rows.address + static_cast<DevicePtr>(row * rows.step);
  }

  /// Zeroes memory. In a large range, such as the memory of a sparse tree,
  /// whole pages are given back to the system, and read as zeros afterwards.
  static void zero(char *at, int64_t bytes) {
    constexpr int64_t large = 1 << 20;
    const int64_t page = sysconf(_SC_PAGESIZE);
    auto address = reinterpret_cast<intptr_t>(at);
    intptr_t first = (address + page - 1) / page * page;
    intptr_t last = (address + bytes) / page * page;
    if (bytes < large ||
        madvise(reinterpret_cast<void *>(first),
                static_cast<size_t>(last - first), MADV_DONTNEED) != 0) {
      std::memset(at, 0, static_cast<size_t>(bytes));
      return;
    }
    std::memset(at, 0, static_cast<size_t>(first - address));
    std::memset(reinterpret_cast<void *>(last), 0,
                static_cast<size_t>(address + bytes - last));
  }

  bool contains(DevicePtr memory, int64_t bytes) const {
    std::lock_guard<std::mutex> lock(mutex);
    auto after = allocations.upper_bound(memory);
    if (after == allocations.begin())
      return false;
    auto found = std::prev(after);
    return memory - found->first + static_cast<uint64_t>(bytes) <=
           static_cast<uint64_t>(found->second);
  }

  /// Checks that the range lies in an allocation of the device, outside of
  /// which a GPU would fault.
  Status check(DevicePtr memory, int64_t bytes) const {
    if (contains(memory, bytes))
      return Status::success();
    return Status::failure(StatusCode::Internal,
                           "a copy of " + formatBytes(bytes) +
                               " leaves the memory of the device");
  }

  Status checkRows(const DeviceRows &rows) const {
    return rows.rows == 0 ? Status::success()
                          : check(rows.address,
                                  (rows.rows - 1) * rows.step + rows.rowBytes);
  }

  /// Calls move(row, first byte, bytes) for pieces of device memory rows, with
  /// safepoints in between.
  template <typename Move>
  static Status forEachPiece(const DeviceRows &rows, bool canStop,
                             const Move &move) {
    if (rows.rowBytes <= 0)
      return Status::success();
    Status status;
    if (rows.rowBytes >= bytesPerSafepoint) {
      for (int64_t row = 0; row < rows.rows && status; ++row)
        status =
            safepoint::runInPieces(rows.rowBytes, bytesPerSafepoint, canStop,
                                   [&](int64_t at, int64_t count) {
                                     move(row, at, count);
                                     return Status::success();
                                   });
      return status;
    }
    return safepoint::runInPieces(rows.rows, bytesPerSafepoint / rows.rowBytes,
                                  canStop, [&](int64_t first, int64_t count) {
                                    for (int64_t row = first;
                                         row < first + count; ++row)
                                      move(row, 0, rows.rowBytes);
                                    return Status::success();
                                  });
  }

  static constexpr int64_t memoryBytes = int64_t(1) << 40;
  /// The bytes that a fill or copy moves between two safepoints. A GPU would
  /// move them while the host waits.
  static constexpr int64_t bytesPerSafepoint = 16 << 20;
  ObjectLinker linker;
  mutable std::mutex mutex;
  std::map<DevicePtr, int64_t> allocations;
  std::set<DevicePtr> reserved;
  int64_t allocated = 0;
  std::atomic<uint64_t> launches{0};
};
} // namespace

std::unique_ptr<Device>
mlir::tai::runtime::openEmulatedDevice(ObjectLinker linker) {
  return std::make_unique<EmulatedDevice>(std::move(linker));
}
