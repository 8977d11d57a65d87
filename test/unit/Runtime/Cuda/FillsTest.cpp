//===- FillsTest.cpp - Fills that follow one another ----------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Tests the table of fills, whose code is the GPU's, and how the queue handles
// fills in sequences, with a CUDA driver that needs no GPU. Memory must be the
// same as if each operation had run alone.
//
//===----------------------------------------------------------------------===//

#include "../../../../lib/Runtime/Cuda/FillTable.h"
#include "../../Utils/FakeCudaTest.h"
#include "../../Utils/RuntimeTestUtils.h"
#include "tai/ABI/DeviceAccesses.h"
#include "tai/Runtime/Device/FillRun.h"
#include <cstring>
#include <random>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
constexpr uint64_t pattern = 0x8877665544332211;

/// Fills rows of memory byte by byte.
void fillBytes(char *memory, const DeviceFill &fill) {
  const DeviceRows &rows = fill.rows;
  for (int64_t group = 0; group < rows.outer; ++group)
    for (int64_t row = 0; row < rows.rows; ++row)
      for (int64_t at = 0; at < rows.rowBytes; ++at)
        memory[static_cast<int64_t>(rows.address) + group * rows.outerStep +
               row * rows.step + at] =
            static_cast<char>(fill.pattern >> at % 8 * 8);
}

void add(TaiFillTable &table, const DeviceRows &rows, uint64_t bits) {
  auto number = [](int64_t value) { return static_cast<uint64_t>(value); };
  taiFillAdd(&table, rows.address, number(rows.step), number(rows.rowBytes),
             number(rows.rows), number(rows.outerStep), number(rows.outer),
             bits);
}

void run(const TaiFillTable &table, unsigned blocks) {
  for (unsigned block = 0; block < blocks && table.count > 0; ++block)
    for (unsigned thread = 0; thread < taiFillThreads; ++thread)
      taiFillAll(&table, block, blocks, thread);
}

/// Checks fills whose addresses are offsets into a block of memory.
void expectRight(const std::vector<DeviceFill> &fills, unsigned blocks) {
  constexpr size_t bytes = 1 << 16;
  alignas(16) static char found[bytes];
  static char expected[bytes];
  std::memset(found, 0x5a, bytes);
  std::memset(expected, 0x5a, bytes);
  TaiFillTable table = {};
  for (const DeviceFill &fill : fills) {
    DeviceRows rows = fill.rows;
    rows.address += reinterpret_cast<uintptr_t>(found);
    add(table, rows, fill.pattern);
    fillBytes(expected, fill);
  }
  run(table, blocks);
  ASSERT_EQ(std::memcmp(found, expected, bytes), 0)
      << "at " << fills.front().rows.address << ", "
      << fills.front().rows.rowBytes << " bytes, " << fills.front().rows.rows
      << " rows";
}
} // namespace

TEST(FillTable, BeginsAndEndsAtAnyByte) {
  for (uint64_t begin = 0; begin < 20; ++begin)
    for (int64_t bytes = 0; bytes < 70; ++bytes)
      expectRight({{{begin, 0, bytes, 1}, pattern, 8}}, 2);
}

TEST(FillTable, SpreadsLargeFillsOverBlocks) {
  // A tile has 16 KiB.
  for (int64_t bytes : {16383, 16384, 16385, 40000, 65000})
    for (unsigned blocks : {1, 2, 3, 7})
      expectRight({{{7, 0, bytes, 1}, pattern, 8}}, blocks);
}

TEST(FillTable, FillsRowsOfAllUnits) {
  for (int64_t unit : {1, 2, 4, 8, 16, 3, 12, 24})
    for (int64_t gap : {1, 3})
      for (int64_t rows : {1, 2, 300}) {
        int64_t step = unit * (1 + gap);
        expectRight({{{uint64_t(unit), step, unit, rows}, pattern, 8}}, 3);
        expectRight({{{uint64_t(unit), step, unit, 5, step * 6, rows / 10 + 1},
                      pattern,
                      8}},
                    3);
        expectRight({{{uint64_t(unit), 2 * step, step, rows}, pattern, 8}}, 3);
      }
}

TEST(FillTable, HoldsSeveral) {
  std::vector<DeviceFill> fills;
  for (uint64_t i = 0; i < taiFillEntries; ++i)
    fills.push_back({{i * 4000 + i, 0, static_cast<int64_t>(i * i * 13), 1},
                     pattern * (2 * i + 1),
                     8});
  fills[3].rows = {3 * 4000, 16, 8, 100};
  fills[9].rows = {9 * 4000 + 4, 12, 4, 17, 500, 3};
  for (unsigned blocks : {1, 2, 5, 40})
    expectRight(fills, blocks);
}

TEST(FillTable, CountsMoreThanFourGigabytes) {
  TaiFillTable table = {};
  // 8 GiB and some bytes, from an odd address.
  add(table, {1001, 0, (int64_t(8) << 30) + 21, 1}, pattern);
  const TaiFillEntry &dense = table.entries[0];
  EXPECT_EQ(dense.head, 7);
  EXPECT_EQ(dense.tail, 14);
  EXPECT_EQ(dense.address, 1008u);
  EXPECT_EQ(dense.units, uint64_t(1) << 29);
  EXPECT_EQ(dense.end, uint64_t(1) << 19);
  TaiFillSize at = 0;
  EXPECT_EQ(taiFillPlace(&dense, dense.units - 1, &at), dense.units - 1);
  // Rows over 64 GiB.
  int64_t rows = int64_t(3) << 28;
  add(table, {4096, 64, 4, rows}, pattern);
  const TaiFillEntry &spread = table.entries[1];
  EXPECT_EQ(spread.units, static_cast<uint64_t>(rows));
  EXPECT_EQ(spread.end - dense.end, uint64_t(3) << 18);
  EXPECT_EQ(taiFillPlace(&spread, spread.units - 1, &at),
            static_cast<uint64_t>(rows - 1) * 16);
  EXPECT_EQ(at, 0u);
  // Groups of rows, with as many bytes as an entry can describe.
  add(table, {4096, 8, 3, 1000, 1 << 20, 1342177}, pattern);
  const TaiFillEntry &groups = table.entries[2];
  EXPECT_EQ(groups.units, uint64_t(1342177) * 3000);
  EXPECT_LT(groups.units, taiFillMostBytes);
  EXPECT_EQ(taiFillPlace(&groups, groups.units - 1, &at),
            (uint64_t(1342176) << 20) + 999 * 8 + 2);
  EXPECT_EQ(at, 2u);
}

namespace mlir::tai {
extern const unsigned char cudaRowKernels[], cudaOverlappedRowKernels[];
extern const unsigned long cudaRowKernelsSize, cudaOverlappedRowKernelsSize;
} // namespace mlir::tai

TEST(RowKernels, WaitByThemselvesWhereLaunchesOverlap) {
  auto count = [](const unsigned char *bytes, size_t size, const char *what) {
    std::string text(reinterpret_cast<const char *>(bytes), size);
    size_t found = 0;
    for (size_t at = text.find(what); at != std::string::npos;
         at = text.find(what, at + 1))
      ++found;
    return found;
  };
  using namespace mlir::tai;
  // Copies and swaps of four units, and fills.
  constexpr size_t kernels = 9;
  EXPECT_EQ(count(cudaRowKernels, cudaRowKernelsSize, ".visible .entry"),
            kernels);
  EXPECT_EQ(count(cudaRowKernels, cudaRowKernelsSize, "griddepcontrol"), 0u);
  for (const char *what : {".visible .entry", "griddepcontrol.wait;",
                           "griddepcontrol.launch_dependents;"})
    EXPECT_EQ(
        count(cudaOverlappedRowKernels, cudaOverlappedRowKernelsSize, what),
        kernels)
        << what;
}

TEST(FillRun, LaterOnesCount) {
  std::mt19937 random(11);
  auto below = [&](unsigned limit) { return random() % limit; };
  size_t refused = 0, kept = 0;
  for (int trial = 0; trial < 2000; ++trial) {
    constexpr size_t bytes = 256;
    char expected[bytes] = {}, found[bytes] = {};
    FillRun run;
    auto finish = [&] {
      // The fills of a run may be done in any order.
      for (size_t i = run.get().size(); i-- > 0;)
        fillBytes(found, run.get()[i]);
      kept += run.get().size();
      run.clear();
    };
    for (int i = 0; i < 6; ++i) {
      int size = 1 << below(4);
      DeviceFill fill{{below(8) * 8, 0, 8 + int64_t(below(8)) * 8, 1}, 0, size};
      if (below(3) == 0)
        fill.rows = {below(8) * 8, 16, 8, int64_t(1 + below(6))};
      if (below(8) == 0)
        fill.rows = {below(8) * 8, 16, 8, 2, 64, 2};
      if (size < 8 && fill.rows.rows == 1)
        fill.rows.address += below(8) / unsigned(size) * unsigned(size);
      uint64_t bits = below(2) ? 0 : pattern * (2 * below(3) + 1);
      fill.pattern = repeatPattern(&bits, size);
      fillBytes(expected, fill);
      if (!run.add(fill)) {
        ++refused;
        finish();
        ASSERT_TRUE(run.add(fill));
      }
    }
    finish();
    ASSERT_EQ(std::memcmp(found, expected, bytes), 0) << "trial " << trial;
  }
  // Both cases occur.
  EXPECT_GT(refused, 100u);
  EXPECT_GT(kept, 4000u);
}

#ifdef TAI_FAKE_CUDA_LIBRARY
namespace {
class QueuedFills : public FakeCudaTest {
protected:
  void open(ProgramMode mode, const char *words = "overlaps") {
    ASSERT_NO_FATAL_FAILURE(openQueue(words));
    queue->setMode(mode);
    queue->setProgramMaker([](const ProgramPlan &plan, DeviceImage &image) {
      image = DeviceImage{DeviceKind::Cuda, "//", {}, {}, nullptr};
      for (const ProgramPart &part : plan.parts)
        image.functions.push_back(part.function);
      return Status::success();
    });
    // Each launch changes n numbers, and accesses no other memory.
    FunctionAccesses accesses;
    accesses.isGridStride = true;
    accesses.extents = {n};
    DeviceAccess access;
    access.window = access.step = access.size = 8;
    access.strides = {8};
    accesses.accesses = {access};
    DeviceImage image{DeviceKind::Cuda,
                      "//",
                      {"scale", "add"},
                      {},
                      std::make_shared<std::string>("bitcode")};
    image.accesses = {accesses.encode(), accesses.encode()};
    ASSERT_OK(queue->load(image, module));
    ASSERT_OK(queue->find(*module, "add", function));
    ASSERT_OK(queue->allocate(bytes, memory));
    expected.assign(bytes, '\x11');
    ASSERT_OK(queue->copyIn(memory, expected.data(), bytes));
  }

  void fill(const DeviceRows &rows, double value) {
    DeviceFill all{rows, 0, 8};
    std::memcpy(&all.pattern, &value, 8);
    fillBytes(expected.data(), all);
    all.rows.address += memory;
    EXPECT_OK(queue->fillRows(all.rows, &value, 8));
  }
  void fill(int64_t first, int64_t count, double value) {
    fill({static_cast<uint64_t>(first * 8), 0, count * 8, 1}, value);
  }
  /// Launches a kernel that adds one to n numbers from `first` on.
  void launch(int64_t first) {
    double one = 1;
    uint64_t slots[] = {memory + static_cast<uint64_t>(first * 8), n, 0};
    std::memcpy(&slots[2], &one, 8);
    LaunchShape shape;
    shape.threads = 32;
    EXPECT_OK(queue->launch(*function, shape, slots, 3));
    for (int64_t i = first; i < first + n; ++i) {
      double value;
      std::memcpy(&value, &expected[static_cast<size_t>(i * 8)], 8);
      value += 1;
      std::memcpy(&expected[static_cast<size_t>(i * 8)], &value, 8);
    }
  }
  void copy(int64_t to, int64_t from, int64_t count) {
    auto at = [&](int64_t number) { return memory + uint64_t(number * 8); };
    EXPECT_OK(queue->copy(at(to), at(from), count * 8));
    std::memcpy(&expected[size_t(to * 8)], &expected[size_t(from * 8)],
                size_t(count * 8));
  }
  /// Repeats the work until the queue has chosen the form in which it runs.
  template <typename Work> void replay(const Work &work, int times = 8) {
    for (int i = 0; i < times; ++i) {
      queue->beginCollecting();
      work();
      EXPECT_OK(queue->endCollecting());
    }
  }
  void check() {
    std::vector<char> found(bytes);
    ASSERT_OK(queue->copyOut(found.data(), memory, bytes));
    EXPECT_EQ(std::memcmp(found.data(), expected.data(), bytes), 0);
  }

  static constexpr int64_t bytes = 6 << 20;
  DeviceFunction *function = nullptr;
  DevicePtr memory = 0;
  std::vector<char> expected;
};
} // namespace

TEST_F(QueuedFills, InFrontOfASequenceAreOneKernel) {
  for (bool overlaps : {false, true}) {
    open(overlaps ? ProgramMode::Overlapped : ProgramMode::Graph);
    replay([&] {
      fill(0, 4, 0);
      fill(10, 40, 3.5);
      fill({64 * 8, 16, 8, 100}, 0);
      fill(5, 1, -1);
      launch(0);
      launch(8);
      launch(16);
      launch(64);
    });
    EXPECT_EQ(counter("nodes"), 5);
    // The first launch, too, is prepared while memory is filled.
    EXPECT_EQ(counter("overlapping"), overlaps ? 4 : 0);
    check();
  }
}

TEST_F(QueuedFills, BetweenLaunchesMoveToTheFront) {
  for (bool overlaps : {false, true}) {
    open(overlaps ? ProgramMode::Overlapped : ProgramMode::Graph);
    replay([&] {
      fill(0, 100, 0);
      launch(0);
      launch(8);
      // A fill of memory that no launch has touched since it was cleared.
      fill(20, 2, 1);
      launch(16);
      launch(24);
    });
    EXPECT_EQ(counter("nodes"), 5);
    EXPECT_EQ(counter("overlapping"), overlaps ? 4 : 0);
    check();
    // No fill precedes the first launches.
    replay([&] {
      launch(0);
      launch(8);
      fill(20, 2, 1);
      launch(16);
      launch(24);
      launch(0);
    });
    EXPECT_EQ(counter("nodes"), 6);
    check();
  }
}

TEST_F(QueuedFills, StayBehindWhatTouchesTheirMemory) {
  for (bool overlaps : {false, true}) {
    open(overlaps ? ProgramMode::Overlapped : ProgramMode::Graph);
    int64_t at = 9;
    auto work = [&] {
      fill(0, 100, 0);
      launch(0);
      launch(8);
      fill(at, 2, 1);
      launch(16);
      copy(200, 30, 4);
      fill(32, 2, 5);
      launch(8);
      // This fill cannot move before the copy, but joins the fill after the
      // copy.
      fill(202, 3, 7);
    };
    replay(work);
    EXPECT_EQ(counter("nodes"), 8);
    EXPECT_EQ(counter("overlapping"), overlaps ? 7 : 0);
    check();
    // Memory that can be filled earlier: the graph changes.
    at = 50;
    replay(work);
    EXPECT_EQ(counter("nodes"), 7);
    check();
    at = 7;
    replay(work);
    EXPECT_EQ(counter("nodes"), 8);
    check();
  }
}

TEST_F(QueuedFills, HaveOtherParametersInEachReplay) {
  open(ProgramMode::Overlapped);
  int64_t first = 0;
  double value = 0;
  auto work = [&] {
    fill(first, 3, value);
    fill(first + 40, 1, value);
    launch(first);
    launch(first);
    launch(first);
  };
  replay(work);
  for (int i = 0; i < 10; ++i) {
    first = i * 7;
    value = i / 4.0;
    replay(work, 1);
    EXPECT_EQ(counter("nodes"), 4);
    check();
  }
}

TEST_F(QueuedFills, ThatLieSideBySideAreOneWhateverComesBetween) {
  open(ProgramMode::Graph);
  replay([&] {
    // Fills both halves of cells, with other fills in between, in two orders.
    fill({0, 32, 16, 20}, 0);
    fill(300, 1, 1);
    fill({16, 32, 8, 20}, 0);
    fill(310, 1, 2);
    fill({24, 32, 8, 20}, 0);
    // Fills memory again that is filled already.
    fill(300, 1, 1);
    fill(303, 2, 0);
    launch(0);
    launch(8);
    launch(16);
  });
  auto *table =
      static_cast<TaiFillTable *>(dlsym(library, "tai_fake_cuda_fills"));
  ASSERT_EQ(table->count, 4u);
  EXPECT_EQ(table->entries[0].units * 16 + table->entries[0].head +
                table->entries[0].tail,
            640u);
  EXPECT_EQ(counter("nodes"), 4);
  check();
}

/// The fills may be of different allocations that are adjacent by chance, which
/// the driver does not fill at once.
TEST_F(QueuedFills, ThatWereJoinedAreNotLeftToTheDriver) {
  open(ProgramMode::Automatic);
  fill(0, 4, 0);
  EXPECT_OK(queue->synchronize());
  int alone = counter("memsets");
  EXPECT_GT(alone, 0);
  for (int64_t first : {20, 24})
    fill(first, 4, 0);
  EXPECT_OK(queue->synchronize());
  EXPECT_EQ(counter("memsets"), alone);
  check();
}

TEST_F(QueuedFills, OfMuchMemoryAreByThemselves) {
  setenv("TAI_FILLS_TOGETHER_BYTES", "128", 1);
  open(ProgramMode::Graph);
  auto work = [&] {
    fill(0, 15, 1);
    fill(20, 16, 0);
    fill(40, 2, 1);
    fill({400, 16, 8, 16}, 2);
    launch(0);
    launch(16);
  };
  replay(work);
  // One fill by the driver, one of rows, and one of the remaining fills.
  EXPECT_EQ(counter("nodes"), 5);
  check();
}

TEST_F(QueuedFills, WithoutASequenceAreOneSubmission) {
  open(ProgramMode::Automatic);
  int before = counter("submissions");
  fill(0, 4, 0);
  fill(10, 40, 3.5);
  fill({64 * 8, 16, 8, 100}, 0);
  fill(1, 1, -1);
  EXPECT_OK(queue->synchronize());
  EXPECT_EQ(counter("submissions") - before, 1);
  check();
}

TEST_F(QueuedFills, RunBesideLaunchesThatDoNotTouchTheirMemory) {
  constexpr int64_t large = 5 << 17;
  for (const char *words : {"overlaps", "overlaps side-first"}) {
    open(ProgramMode::Aside, words);
    int64_t touched = 1000;
    auto work = [&] {
      fill(0, 100, 1);
      fill(1000, large, 2.5);
      // Another value at the start of the memory that was just filled.
      fill(1004, 2, 3);
      for (int64_t i = 0; i < 40; ++i)
        launch(i == 30 ? touched : i % 10 * 8);
      fill(1000 + large - 1, 1, 7);
      launch(1000 + large - 8);
    };
    replay(work);
    // The fill in front, the fills beside the launches, and the launches. All
    // but the first node and the node that waits for both branches overlap.
    EXPECT_EQ(counter("nodes"), 43);
    EXPECT_EQ(counter("overlapping"), 40);
    std::string text = queue->explain();
    EXPECT_NE(text.find("fills beside them (42 nodes)"), std::string::npos)
        << text;
    check();
    // With 8, only the last launch accesses the memory that is filled
    // meanwhile.
    for (int64_t next : {int64_t(1001), int64_t(8)}) {
      touched = next;
      replay(work, 3);
      check();
    }
  }
}

TEST_F(QueuedFills, RunBesideWhatComesBehindAHead) {
  constexpr int64_t large = 5 << 17;
  setenv("TAI_KEEP_LAUNCHES_US", "1000000000", 1);
  for (const char *words : {"overlaps", "overlaps side-first"}) {
    open(ProgramMode::Aside, words);
    for (int i = 0; i < 12; ++i) {
      queue->beginCollecting(/*isReplay=*/true);
      fill(0, 100, i);
      fill(1000, large, 2.5);
      for (int64_t at = 0; at < 40; ++at)
        launch(at < 30 ? at % 10 * 8 : 1000 + at);
      EXPECT_OK(queue->endCollecting());
      // This launch reads the filled memory.
      launch(1000);
      launch(2000);
    }
    EXPECT_NE(queue->explain().find("as one graph"), std::string::npos)
        << queue->explain();
    check();
  }
  unsetenv("TAI_KEEP_LAUNCHES_US");
}

TEST_F(QueuedFills, MoreThanATableHolds) {
  open(ProgramMode::Overlapped);
  replay([&] {
    for (int i = 0; i < 2 * taiFillEntries + 3; ++i)
      fill(3 * i, 1, i);
    launch(0);
    launch(0);
    launch(16);
  });
  EXPECT_EQ(counter("nodes"), 6);
  // All nodes but the first overlap.
  EXPECT_EQ(counter("overlapping"), 5);
  check();
}

TEST_F(QueuedFills, OfRowsThatAreTooManyForOneEntry) {
  open(ProgramMode::Graph);
  std::unique_ptr<Device> device;
  ASSERT_OK(openCudaDevice(0, device));
  ASSERT_OK(device->beginCapture());
  // The fills are recorded, not run: such memory does not exist.
  int64_t rows = (int64_t(1) << 31) + 1;
  uint64_t zero = 0;
  ASSERT_OK(device->fillRows({4096, 16, 8, rows}, &zero, 8));
  std::unique_ptr<DeviceGraph> graph;
  ASSERT_OK(device->endCapture(graph));
  auto *table =
      static_cast<TaiFillTable *>(dlsym(library, "tai_fake_cuda_fills"));
  ASSERT_GT(table->count, 1u);
  uint64_t units = 0;
  for (uint64_t i = 0; i < table->count; ++i) {
    const TaiFillEntry &entry = table->entries[i];
    EXPECT_EQ(entry.address, 4096 + units * 16);
    EXPECT_LT(entry.units * entry.unitBytes, taiFillMostBytes);
    units += entry.units;
  }
  EXPECT_EQ(units, static_cast<uint64_t>(rows));
}
#endif // TAI_FAKE_CUDA_LIBRARY
