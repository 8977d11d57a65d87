//===- DeviceLibraryTest.cpp - The device library on the host -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Calls the library's build for the host, as the emulated device does, and
// reads its results.
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/Abi.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/ABI/DeviceSparse.h"
#include "tai/CodeGen/Device/DeviceCompiler.h"
#include "tai/CodeGen/Linker.h"
#include "tai/Runtime/Device/DeviceHeap.h"
#include "tai/Runtime/Device/DeviceReport.h"
#include "llvm/Bitcode/BitcodeReader.h"
#include "gtest/gtest.h"
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <thread>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

namespace {
// The block number of this thread on the emulated device.
thread_local int32_t blockId = 0;
int32_t gridDim = 1;
int32_t getZero() { return 0; }
int32_t getOne() { return 1; }
int32_t getBlock() { return blockId; }
int32_t getGrid() { return gridDim; }

/// Programs have dispatch functions of their own.
static void dispatch(uint64_t, const uint64_t *) {}

class DeviceLibrary : public testing::Test {
protected:
  static void SetUpTestSuite() {
    auto objects = ObjectCompiler::create(CodegenOptions());
    ASSERT_TRUE(static_cast<bool>(objects));
    llvm::ArrayRef<char> bytes = getDeviceLibrary(DeviceKind::Emulated);
    llvm::LLVMContext context;
    auto module = llvm::parseBitcodeFile(
        {llvm::StringRef(bytes.data(), bytes.size()), "library"}, context);
    ASSERT_TRUE(static_cast<bool>(module));
    ASSERT_FALSE((*objects)->optimize(**module));
    auto object = (*objects)->emitObject(**module);
    ASSERT_TRUE(static_cast<bool>(object));
    std::vector<RuntimeSymbol> symbols = {
        {"tai_emu_thread_id", reinterpret_cast<void *>(&getZero)},
        {"tai_emu_block_dim", reinterpret_cast<void *>(&getOne)},
        {"tai_emu_block_id", reinterpret_cast<void *>(&getBlock)},
        {"tai_emu_grid_dim", reinterpret_cast<void *>(&getGrid)},
        {"tai_emu_allocate", reinterpret_cast<void *>(&tai_emu_allocate)},
        {"tai_emu_free", reinterpret_cast<void *>(&tai_emu_free)},
        {"tai_program_dispatch", reinterpret_cast<void *>(&dispatch)}};
    auto made = Linker::create(symbols);
    ASSERT_TRUE(static_cast<bool>(made));
    linker = made->release();
    code = new llvm::SmallVector<char, 0>(std::move(*object));
  }
  static void TearDownTestSuite() {
    delete linker;
    delete code;
    linker = nullptr;
    code = nullptr;
  }

  /// The library's function `name`, with the type of its declaration.
  template <typename Fn> Fn *find(Fn &, const char *name) {
    auto linked = linker->link(*code, {std::string(name)});
    if (!linked) {
      ADD_FAILURE() << llvm::toString(linked.takeError());
      return nullptr;
    }
    return reinterpret_cast<Fn *>(linked->addresses.front());
  }
#define TAI_FIND(name) find(name, #name)

  /// A device state with space for `outputBytes` bytes of output.
  TaiFrame *makeState(uint64_t outputBytes, uint64_t stackLimit = 1 << 20) {
    memory.assign((sizeof(TaiDeviceState) + outputBytes) / 8, 0xabababababu);
    state = reinterpret_cast<TaiDeviceState *>(memory.data());
    *state = freshDeviceState(outputBytes, stackLimit);
    return reinterpret_cast<TaiFrame *>(state);
  }
  DeviceReport read() {
    DeviceReport report;
    Status status =
        readDeviceReport(*state, state + 1, deviceOutputBytes(*state), report);
    EXPECT_TRUE(status.ok()) << status.message();
    return report;
  }

  static Linker *linker;
  static llvm::SmallVector<char, 0> *code;
  std::vector<uint64_t> memory;
  TaiDeviceState *state = nullptr;
};

Linker *DeviceLibrary::linker = nullptr;
llvm::SmallVector<char, 0> *DeviceLibrary::code = nullptr;

uint64_t slotOf(double value) {
  uint64_t slot;
  std::memcpy(&slot, &value, sizeof(slot));
  return slot;
}

TEST_F(DeviceLibrary, RandomBitsAreThoseOfTheCpu) {
  auto *random = TAI_FIND(tai_rt_random_u32);
  for (uint32_t sequence = 0; sequence < 9; ++sequence)
    EXPECT_EQ(random(7, 8, uint64_t(9) << 33, 10, sequence),
              tai_rt_random_u32(7, 8, uint64_t(9) << 33, 10, sequence));
}

//===----------------------------------------------------------------------===//
// Failures and output
//===----------------------------------------------------------------------===//

TEST_F(DeviceLibrary, KeepsTheFirstFailure) {
  auto *fail = TAI_FIND(tai_rt_fail);
  auto *failed = TAI_FIND(tai_rt_failed);
  TaiFrame *frame = makeState(0);
  EXPECT_EQ(failed(frame), 0);
  EXPECT_FALSE(hasDeviceReport(*state));
  int32_t kinds[] = {TAI_VALUE_I64, TAI_VALUE_F64};
  int32_t shapes[] = {1, 2};
  uint64_t slots[] = {static_cast<uint64_t>(-3), slotOf(0.5), slotOf(2)};
  fail(frame, TAI_FAIL_INDEX, "index {} of {}", "a.py:3:5", 2, kinds, shapes,
       slots);
  fail(frame, TAI_FAIL_ASSERT, "later", "", 0, nullptr, nullptr, nullptr);
  EXPECT_NE(failed(frame), 0);
  EXPECT_TRUE(hasDeviceReport(*state));
  Status failure = read().failure;
  EXPECT_EQ(failure.code(), StatusCode::Index);
  EXPECT_EQ(failure.message(), "index -3 of [0.5, 2.0]");
  EXPECT_EQ(failure.where(), "a.py:3:5");
}

TEST_F(DeviceLibrary, OneOfManyThreadsFails) {
  auto *fail = TAI_FIND(tai_rt_fail);
  TaiFrame *frame = makeState(0);
  std::vector<std::thread> threads;
  for (uint64_t i = 0; i < 4; ++i)
    threads.emplace_back([&, i] {
      int32_t kind = TAI_VALUE_U64;
      uint64_t slots[] = {i, i, i};
      int32_t shape = 3;
      for (int repeat = 0; repeat < 100; ++repeat)
        fail(frame, TAI_FAIL_ASSERT, "{}", "", 1, &kind, &shape, slots);
    });
  for (std::thread &thread : threads)
    thread.join();
  std::string message = read().failure.message();
  std::vector<std::string> possible = {"[0, 0, 0]", "[1, 1, 1]", "[2, 2, 2]",
                                       "[3, 3, 3]"};
  EXPECT_TRUE(llvm::is_contained(possible, message)) << message;
}

TEST_F(DeviceLibrary, LinesComeInOrderUntilThereIsNoRoom) {
  auto *print = TAI_FIND(tai_rt_print);
  // A record of one value and a text of four bytes takes 56 bytes.
  TaiFrame *frame = makeState(3 * 56 + 16);
  int32_t kind = TAI_VALUE_I64;
  for (uint64_t i = 0; i < 10; ++i)
    print(frame, "a {}", 1, &kind, nullptr, &i);
  DeviceReport report = read();
  EXPECT_EQ(report.lines, (std::vector<std::string>{"a 0", "a 1", "a 2"}));
  EXPECT_EQ(report.lostLines, 7u);
  EXPECT_TRUE(report.failure.ok());
}

TEST_F(DeviceLibrary, RecordsAreWrittenToTheirEnds) {
  auto *print = TAI_FIND(tai_rt_print);
  for (size_t length = 0; length < 9; ++length) {
    TaiFrame *frame = makeState(128);
    auto *bytes = reinterpret_cast<unsigned char *>(state + 1);
    std::memset(bytes, 0xff, 128);
    print(frame, std::string(length, 'x').c_str(), 0, nullptr, nullptr,
          nullptr);
    uint32_t end = reinterpret_cast<TaiDeviceRecord *>(bytes)->bytes;
    ASSERT_EQ(end, (sizeof(TaiDeviceRecord) + length + 2 + 7) / 8 * 8);
    for (size_t i = sizeof(TaiDeviceRecord) + length; i < end; ++i)
      EXPECT_EQ(bytes[i], 0) << "byte " << i << " of " << end;
    EXPECT_EQ(bytes[end], 0xff);
  }
}

TEST_F(DeviceLibrary, LinesOfManyThreadsAreWhole) {
  auto *print = TAI_FIND(tai_rt_print);
  TaiFrame *frame = makeState(4000);
  std::vector<std::thread> threads;
  for (uint64_t i = 0; i < 4; ++i)
    threads.emplace_back([&, i] {
      int32_t kind = TAI_VALUE_U64;
      // Records of different sizes, so that the last ones leave a gap at the
      // end.
      std::string text(5 + 20 * i, 'x');
      for (int repeat = 0; repeat < 50; ++repeat)
        print(frame, text.c_str(), 1, &kind, nullptr, &i);
    });
  for (std::thread &thread : threads)
    thread.join();
  DeviceReport report = read();
  EXPECT_EQ(report.lines.size() + report.lostLines, 200u);
  EXPECT_GT(report.lostLines, 0u);
  EXPECT_GT(report.lines.size(), 10u);
  for (const std::string &line : report.lines) {
    size_t length = line.find(' ');
    ASSERT_NE(length, std::string::npos) << line;
    EXPECT_EQ(line.substr(length + 1), std::to_string((length - 5) / 20));
  }
}

TEST_F(DeviceLibrary, WhatFindsNoRoomIsCounted) {
  auto *print = TAI_FIND(tai_rt_print);
  TaiFrame *frame = makeState(1 << 14);
  std::string text(5000, 'y');
  print(frame, text.c_str(), 0, nullptr, nullptr, nullptr);
  // 1000 values of one component: the text "{}" and the values that fit are
  // kept.
  std::vector<int32_t> kinds(1000, TAI_VALUE_U64);
  std::vector<uint64_t> slots(1000, 1);
  print(frame, "{}", 1000, kinds.data(), nullptr, slots.data());
  DeviceReport report = read();
  ASSERT_EQ(report.lines.size(), 2u);
  EXPECT_EQ(report.lostLines, 0u);
  size_t kept = report.lines[0].find(' ');
  EXPECT_GT(kept, 1000u);
  EXPECT_EQ(report.lines[0].substr(kept),
            " ... (" + std::to_string(5000 - kept) + " more characters)");
  // Each value that was kept takes a digit and a space.
  size_t end = report.lines[1].find(" ...");
  EXPECT_EQ(report.lines[1].substr(end),
            " ... (" + std::to_string(1000 - (end + 1) / 2) + " more values)");
}

TEST_F(DeviceLibrary, DamageIsReported) {
  auto *print = TAI_FIND(tai_rt_print);
  TaiFrame *frame = makeState(1024);
  auto check = [&] {
    DeviceReport report;
    Status status =
        readDeviceReport(*state, state + 1, deviceOutputBytes(*state), report);
    EXPECT_EQ(status.code(), StatusCode::Index);
  };
  print(frame, "line", 0, nullptr, nullptr, nullptr);
  auto *record = reinterpret_cast<TaiDeviceRecord *>(state + 1);
  for (uint32_t wrong : {0u, 8u, 33u, 4096u}) {
    uint32_t right = record->bytes;
    record->bytes = wrong;
    check();
    record->bytes = right;
  }
  record->slots = 5;
  check();
  record->slots = -1;
  check();
  frame = makeState(0);
  state->failed = 1;
  state->failure[0] = 1;
  check();
  state->magic = 0;
  check();
}

//===----------------------------------------------------------------------===//
// Stacks
//===----------------------------------------------------------------------===//

TEST_F(DeviceLibrary, StacksGrowUpToTheLimit) {
  auto *grow = TAI_FIND(tai_rt_stack_grow);
  auto *release = TAI_FIND(tai_rt_stack_free);
  TaiFrame *frame = makeState(0, 1024);
  struct {
    TaiStack stack;
    uint64_t slots[TAI_STACK_SLOTS];
  } inlined;
  TaiStack &stack = inlined.stack;
  stack = {reinterpret_cast<char *>(inlined.slots), 0, TAI_STACK_SLOTS};
  auto push = [&](uint64_t value) {
    if (stack.size == stack.capacity)
      grow(frame, &stack);
    reinterpret_cast<uint64_t *>(stack.slots)[stack.size++] = value;
  };
  for (uint64_t i = 0; i < 8 * TAI_STACK_SLOTS; ++i)
    push(i);
  EXPECT_EQ(stack.size, 8 * TAI_STACK_SLOTS);
  for (uint64_t i = 0; i < 8 * TAI_STACK_SLOTS; ++i)
    EXPECT_EQ(reinterpret_cast<uint64_t *>(stack.slots)[i], i);
  EXPECT_TRUE(read().failure.ok());
  // The stack has 832 bytes, which a limit of 1024 does not allow to double.
  push(0);
  EXPECT_EQ(stack.size, 1);
  release(&stack);
  Status failure = read().failure;
  EXPECT_EQ(failure.code(), StatusCode::Memory);
  EXPECT_EQ(failure.message(), "out of memory: a gradient records more than "
                               "832 B of values in one iteration");
}

TEST_F(DeviceLibrary, SaysWhereTheHeapIsUsedUp) {
  auto *allocate = TAI_FIND(tai_rt_local_alloc);
  auto *release = TAI_FIND(tai_rt_local_free);
  TaiFrame *frame = makeState(0);
  setDeviceHeapBytes(4096);
  void *one = allocate(frame, 3000, "{} are too much", "a.py:3:4");
  ASSERT_NE(one, nullptr);
  // An allocation of zero bytes succeeds and takes no memory.
  void *none = allocate(frame, 0, "{} are too much", "");
  EXPECT_NE(none, nullptr);
  EXPECT_TRUE(read().failure.ok());
  EXPECT_EQ(allocate(frame, 2048, "{} are too much", "a.py:3:4"), nullptr);
  Status failure = read().failure;
  EXPECT_EQ(failure.code(), StatusCode::Memory);
  EXPECT_EQ(failure.message(), "2.0 KiB are too much");
  EXPECT_EQ(failure.where(), "a.py:3:4");
  release(none);
  release(one);
  one = allocate(frame, 4096, "", "");
  EXPECT_NE(one, nullptr);
  release(one);
  // A stack below its limit fails to grow as well if the heap is full.
  auto *grow = TAI_FIND(tai_rt_stack_grow_at);
  frame = makeState(0);
  setDeviceHeapBytes(8);
  struct {
    TaiStack stack;
    uint64_t slots[TAI_STACK_SLOTS];
  } inlined;
  inlined.stack = {reinterpret_cast<char *>(inlined.slots), TAI_STACK_SLOTS,
                   TAI_STACK_SLOTS};
  grow(frame, &inlined.stack, "no room for {}", "b.py:1:2");
  setDeviceHeapBytes(0);
  EXPECT_EQ(inlined.stack.size, 0);
  EXPECT_EQ(read().failure.message(), "no room for 208 B");
  EXPECT_EQ(read().failure.where(), "b.py:1:2");
}

//===----------------------------------------------------------------------===//
// Reductions and barriers
//===----------------------------------------------------------------------===//

/// The target after a reduction of a value into it.
template <typename T> T combined(void (*reduce)(T *, T), T target, T value) {
  reduce(&target, value);
  return target;
}

TEST_F(DeviceLibrary, Reductions) {
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_add_f32), 1.5f, 2.0f), 3.5f);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_add_f64), 1.5, 2.0), 3.5);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_add_i32), INT32_MAX, 1),
            INT32_MIN);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_add_i64), -5, 3), -2);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_mul_f32), 1.5f, 2.0f), 3.0f);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_mul_f64), -1.5, 2.0), -3.0);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_mul_i32), -3, 7), -21);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_mul_i64), 1, 1), 1);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_min_i32), -1, 1), -1);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_min_u32), ~0u, 1u), 1u);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_max_i32), -1, 1), 1);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_max_u32), ~0u, 1u), ~0u);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_min_i64), -1, 1), -1);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_max_i64), -1, 1), 1);
  EXPECT_EQ(combined<uint64_t>(TAI_FIND(tai_dev_reduce_min_u64), ~0ull, 1), 1u);
  EXPECT_EQ(combined<uint64_t>(TAI_FIND(tai_dev_reduce_max_u64), ~0ull, 1),
            ~0ull);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_and_i32), 6, 3), 2);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_or_i32), 6, 3), 7);
  EXPECT_EQ(combined(TAI_FIND(tai_dev_reduce_xor_i32), 6, 3), 5);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_and_i64), 6, 3), 2);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_or_i64), 6, 3), 7);
  EXPECT_EQ(combined<int64_t>(TAI_FIND(tai_dev_reduce_xor_i64), 6, 3), 5);
}

/// As in arith.minimumf, NaN wins on either side, and -0 is less than 0.
template <typename T>
void checkExtremes(void (*min)(T *, T), void (*max)(T *, T)) {
  T nan = std::numeric_limits<T>::quiet_NaN();
  T infinity = std::numeric_limits<T>::infinity();
  for (auto *reduce : {min, max}) {
    EXPECT_TRUE(std::isnan(combined<T>(reduce, nan, 1)));
    EXPECT_TRUE(std::isnan(combined<T>(reduce, 1, nan)));
    EXPECT_TRUE(std::isnan(combined<T>(reduce, nan, nan)));
  }
  EXPECT_TRUE(std::signbit(combined<T>(min, 0, -T(0))));
  EXPECT_TRUE(std::signbit(combined<T>(min, -T(0), 0)));
  EXPECT_FALSE(std::signbit(combined<T>(max, 0, -T(0))));
  EXPECT_FALSE(std::signbit(combined<T>(max, -T(0), 0)));
  EXPECT_EQ(combined<T>(min, infinity, -2), -2);
  EXPECT_EQ(combined<T>(max, -infinity, -2), -2);
}

TEST_F(DeviceLibrary, ExtremesOfFloats) {
  checkExtremes(TAI_FIND(tai_dev_reduce_min_f32),
                TAI_FIND(tai_dev_reduce_max_f32));
  checkExtremes(TAI_FIND(tai_dev_reduce_min_f64),
                TAI_FIND(tai_dev_reduce_max_f64));
}

TEST_F(DeviceLibrary, NoUpdateIsLost) {
  auto *multiply = TAI_FIND(tai_dev_reduce_mul_i64);
  auto *add = TAI_FIND(tai_dev_reduce_add_f32);
  int64_t product = 1;
  float sum = 0;
  uint64_t expected = 1;
  for (int i = 0; i < 4000; ++i)
    expected *= 3;
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i)
    threads.emplace_back([&] {
      for (int repeat = 0; repeat < 1000; ++repeat) {
        multiply(&product, 3);
        add(&sum, 1);
      }
    });
  for (std::thread &thread : threads)
    thread.join();
  EXPECT_EQ(static_cast<uint64_t>(product), expected);
  EXPECT_EQ(sum, 4000.0f);
}

TEST_F(DeviceLibrary, GridBarrier) {
  auto *barrier = TAI_FIND(tai_dev_grid_barrier);
  constexpr int blocks = 3, rounds = 200;
  uint32_t word = 0;
  std::atomic<int> arrived{0};
  std::atomic<int> wrong{0};
  std::vector<std::thread> threads;
  for (int block = 0; block < blocks; ++block)
    threads.emplace_back([&, block] {
      blockId = block;
      for (int round = 1; round <= rounds; ++round) {
        ++arrived;
        barrier(&word, blocks);
        if (arrived != round * blocks)
          ++wrong;
        barrier(&word, blocks);
      }
    });
  for (std::thread &thread : threads)
    thread.join();
  EXPECT_EQ(wrong, 0);
  // A single block waits for no other block.
  word = 0;
  barrier(&word, 1);
  barrier(&word, 1);
}

/// A tree of 4 cells, each with a list of up to 100 numbers, or with 100 cells
/// whose activity is in bits, like that of the outer cells.
struct SparseTree {
  explicit SparseTree(bool isList) {
    nodes[0] = {0,
                -1,
                0,
                1,
                4,
                4,
                4,
                800,
                0,
                3200,
                &activity[0],
                &gone[0],
                &marks[0],
                "no cell {}",
                "full",
                nullptr,
                nullptr,
                0};
    nodes[1] = {isList,
                0,
                0,
                2,
                400,
                100,
                100,
                8,
                0,
                3208,
                &activity[1],
                &gone[1],
                &marks[1],
                "no cell {}",
                "full",
                nullptr,
                nullptr,
                0};
    tree = {2, nodes, steps, nullptr};
    *reinterpret_cast<TaiDeviceTree **>(memory + 248) = &tree;
  }
  char *base() { return memory + 256; }
  uint64_t *bits() { return reinterpret_cast<uint64_t *>(base() + 3200); }
  int32_t *lengths() { return reinterpret_cast<int32_t *>(base() + 3208); }
  int64_t *numbers() { return reinterpret_cast<int64_t *>(base()); }

  alignas(256) char memory[256 + 3208 + 56] = {};
  TaiDeviceStep steps[2] = {{4, 800}, {100, 8}};
  TaiDeviceNode nodes[2];
  TaiDeviceTree tree;
  TaiDeviceActivity activity[2] = {{0, 0, 1}, {0, 0, 1}};
  uint64_t gone[8] = {};
  uint64_t marks[2] = {};
};

TEST_F(DeviceLibrary, ActivatesCells) {
  auto *activate = TAI_FIND(tai_rt_activate);
  auto *deactivate = TAI_FIND(tai_rt_deactivate);
  TaiFrame *frame = makeState(0);
  SparseTree tree(/*isList=*/false);
  std::vector<std::thread> threads;
  for (int thread = 0; thread < 4; ++thread)
    threads.emplace_back([&] {
      for (int64_t cell = 130; cell < 270; ++cell)
        EXPECT_EQ(activate(frame, tree.base(), 1, cell, ""), 1);
    });
  for (std::thread &thread : threads)
    thread.join();
  EXPECT_EQ(tree.bits()[0], 6u);
  for (int64_t cell = 0; cell < 400; ++cell)
    EXPECT_EQ(tree.bits()[1 + cell / 64] >> (cell % 64) & 1,
              uint64_t(cell >= 130 && cell < 270))
        << cell;
  for (const TaiDeviceActivity &activity : tree.activity) {
    EXPECT_EQ(activity.changes, TAI_DEVICE_ACTIVITY_CHANGED);
    EXPECT_EQ(activity.isNew, 1u);
  }
  // Words 2, 3 and 4 contain the bits of the cells from 130 on.
  EXPECT_EQ(tree.marks[0], 1u);
  EXPECT_EQ(tree.marks[1], 0x1cu);

  // Deactivates cell 1 with all of its contents, but not the next cell.
  std::fill(tree.numbers() + 130, tree.numbers() + 270, 7);
  deactivate(frame, tree.base(), 0, 1, "");
  EXPECT_EQ(tree.bits()[0], 4u);
  for (int64_t cell = 0; cell < 400; ++cell) {
    bool stays = cell >= 200 && cell < 270;
    EXPECT_EQ(tree.bits()[1 + cell / 64] >> (cell % 64) & 1, uint64_t(stays));
    EXPECT_EQ(tree.numbers()[cell], stays ? 7 : 0) << cell;
    bool removed = cell >= 130 && cell < 200;
    EXPECT_EQ(tree.gone[1 + cell / 64] >> (cell % 64) & 1, uint64_t(removed));
  }
  EXPECT_EQ(tree.gone[0], 2u);
  EXPECT_TRUE(tree.activity[1].changes & TAI_DEVICE_CELLS_REMOVED);

  // Operations that change no activity leave no marks.
  tree.activity[0] = tree.activity[1] = {0, 0, 1};
  EXPECT_EQ(activate(frame, tree.base(), 1, 200, ""), 1);
  deactivate(frame, tree.base(), 0, 1, "");
  for (const TaiDeviceActivity &activity : tree.activity)
    EXPECT_EQ(activity.changes | activity.isNew, 0u);
  EXPECT_TRUE(read().failure.ok());

  EXPECT_EQ(activate(frame, tree.base(), 0, 4, "a.py:3:1"), 0);
  Status failure = read().failure;
  EXPECT_EQ(failure.message(), "no cell 4");
  EXPECT_EQ(failure.where(), "a.py:3:1");
}

TEST_F(DeviceLibrary, AppendsToLists) {
  auto *append = TAI_FIND(tai_rt_append);
  auto *deactivate = TAI_FIND(tai_rt_deactivate);
  TaiFrame *frame = makeState(0);
  SparseTree tree(/*isList=*/true);
  std::vector<std::thread> threads;
  std::atomic<int> refused{0};
  for (int thread = 0; thread < 4; ++thread)
    threads.emplace_back([&] {
      for (int i = 0; i < 26; ++i) {
        int64_t at = append(frame, tree.base(), 1, 2, "");
        if (at < 0)
          ++refused;
        else
          ++tree.numbers()[200 + at];
      }
    });
  for (std::thread &thread : threads)
    thread.join();
  // Each place was appended once, up to the capacity of the list.
  EXPECT_EQ(refused, 4);
  EXPECT_EQ(std::vector<int64_t>(tree.numbers(), tree.numbers() + 400), [] {
    std::vector<int64_t> expected(400);
    std::fill(expected.begin() + 200, expected.begin() + 300, 1);
    return expected;
  }());
  EXPECT_EQ(tree.lengths()[2], 100);
  EXPECT_EQ(tree.bits()[0], 4u);
  EXPECT_EQ(tree.marks[1], 4u);
  EXPECT_EQ(read().failure.message(), "full");

  deactivate(frame, tree.base(), 1, 250, "");
  EXPECT_EQ(tree.lengths()[2], 0);
  EXPECT_EQ(tree.numbers()[200], 0);
  EXPECT_EQ(tree.bits()[0], 4u);
  EXPECT_EQ(reinterpret_cast<int32_t *>(&tree.gone[1])[2], 100);
}

/// One level of many cells: bits, or lists of at most 50 elements.
struct ManyCells {
  static constexpr int64_t listCapacity = 50;
  ManyCells(bool isList, int64_t units)
      : isList(isList), units(units), steps{{units * perUnit(), 4}},
        memory(static_cast<size_t>(256 + 8 * units)),
        values(static_cast<size_t>(units * perUnit())),
        marks(static_cast<size_t>((units + 63) / 64)),
        gone(static_cast<size_t>(units)),
        list(static_cast<size_t>(4 + units * perUnit())),
        sums(static_cast<size_t>(units / TAI_DEVICE_LIST_TILE + 1)) {
    // The cells are at another address, so that there is only memory for bits.
    node = {isList,
            -1,
            0,
            1,
            units * perUnit(),
            units * perUnit(),
            isList ? listCapacity : units * perUnit(),
            4,
            reinterpret_cast<char *>(values.data()) - base(),
            0,
            &activity,
            gone.data(),
            marks.data(),
            "no cell {}",
            "full",
            nullptr,
            nullptr,
            0};
    *reinterpret_cast<TaiDeviceTree **>(memory.data() + 248) = &tree;
  }
  int64_t perUnit() const { return isList ? listCapacity : 64; }
  char *base() { return memory.data() + 256; }
  uint64_t address() { return reinterpret_cast<uint64_t>(base()); }
  uint64_t listAddress() { return reinterpret_cast<uint64_t>(list.data()); }
  const TaiDeviceListHeader &header() const {
    return *reinterpret_cast<const TaiDeviceListHeader *>(list.data());
  }
  std::vector<int64_t> found() const {
    const int64_t *first = list.data() + 4;
    return {first, first + header().count};
  }

  bool isList;
  int64_t units;
  TaiDeviceStep steps[1];
  TaiDeviceNode node;
  TaiDeviceTree tree{1, &node, steps, nullptr};
  TaiDeviceActivity activity{0, 0, 1};
  std::vector<char> memory;
  std::vector<int32_t> values;
  std::vector<uint64_t> marks, gone;
  std::vector<int64_t> list;
  std::vector<int64_t> sums;
};

TEST_F(DeviceLibrary, ListsActiveCells) {
  auto *activate = TAI_FIND(tai_rt_activate);
  auto *deactivate = TAI_FIND(tai_rt_deactivate);
  auto *make = TAI_FIND(tai_dev_list_cells);
  auto *count = TAI_FIND(tai_dev_list_count);
  auto *scan = TAI_FIND(tai_dev_list_scan);
  auto *write = TAI_FIND(tai_dev_list_write);
  auto *deactivateAll = TAI_FIND(tai_dev_deactivate_list);
  TaiFrame *frame = makeState(0);
  static_assert(sizeof(TaiDeviceListHeader) == 4 * sizeof(int64_t));
  for (bool isList : {false, true})
    for (bool inParts : {false, true}) {
      // A number of cells that is no multiple of a tile, with empty tiles among
      // them.
      ManyCells cells(isList, 5 * TAI_DEVICE_LIST_TILE + 77);
      auto inBlocks = [&](int32_t blocks, auto body) {
        gridDim = blocks;
        for (blockId = blocks; blockId-- > 0;)
          body();
        blockId = 0;
        gridDim = 1;
      };
      auto update = [&] {
        uint64_t tree = cells.address(), list = cells.listAddress();
        auto sums = reinterpret_cast<uint64_t>(cells.sums.data());
        if (!inParts) {
          inBlocks(2, [&] { make(tree, 0, list); });
          return;
        }
        inBlocks(4, [&] { count(tree, 0, list, sums); });
        inBlocks(2, [&] { scan(tree, 0, list, sums); });
        inBlocks(3, [&] { write(tree, 0, list, sums); });
      };
      std::vector<int64_t> expected;
      auto expect = [&] {
        update();
        EXPECT_EQ(cells.found(), expected);
        EXPECT_EQ(cells.header().version, cells.activity.version);
        EXPECT_EQ(cells.activity.isNew, 0u);
      };
      expect();

      uint64_t random = 1;
      for (int64_t unit = 0; unit < cells.units; ++unit) {
        random = random * 6364136223846793005u + 1442695040888963407u;
        int64_t tile = unit / TAI_DEVICE_LIST_TILE;
        if (random >> 62 == 0 || tile == 2)
          continue;
        int64_t most = random >> 40 & 63, first = unit * cells.perUnit();
        for (int64_t i = 0; i <= most % cells.perUnit(); ++i)
          if (isList || most == 63 || (random >> i & 1))
            expected.push_back(first + i);
      }
      for (int64_t cell : expected)
        EXPECT_EQ(activate(frame, cells.base(), 0, cell, ""), 1);
      EXPECT_EQ(cells.activity.isNew, 1u);
      expect();
      ASSERT_GT(expected.size(), 10000u);

      // A list that is up to date is not rebuilt.
      uint64_t version = cells.activity.version;
      cells.list[4] = -7;
      update();
      EXPECT_EQ(cells.found().front(), -7);
      EXPECT_EQ(cells.activity.version, version);

      int64_t gone = expected[expected.size() / 2] / cells.perUnit();
      deactivate(frame, cells.base(), 0, gone * cells.perUnit(), "");
      if (!isList)
        activate(frame, cells.base(), 0, gone * 64, "");
      else
        expected.erase(
            std::remove_if(expected.begin(), expected.end(),
                           [&](int64_t c) { return c / 50 == gone; }),
            expected.end());
      if (!isList &&
          !std::binary_search(expected.begin(), expected.end(), gone * 64))
        expected.insert(
            std::lower_bound(expected.begin(), expected.end(), gone * 64),
            gone * 64);
      expect();
      EXPECT_EQ(cells.activity.version, version + 1);

      std::fill(cells.values.begin(), cells.values.end(), 3);
      cells.activity.changes = 0;
      inBlocks(3,
               [&] { deactivateAll(cells.address(), 0, cells.listAddress()); });
      std::vector<int32_t> left(cells.values.size(), 3);
      for (int64_t cell : expected)
        left[cell] = 0;
      EXPECT_EQ(cells.values, left);
      EXPECT_EQ(cells.activity.changes,
                TAI_DEVICE_ACTIVITY_CHANGED | TAI_DEVICE_CELLS_REMOVED);
      expected.clear();
      expect();
    }
  EXPECT_TRUE(read().failure.ok());
}
} // namespace
