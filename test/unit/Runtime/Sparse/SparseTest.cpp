//===- SparseTest.cpp - Activity of cells, on one thread and on many ------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "../../Utils/RuntimeTestUtils.h"
#include "tai/ABI/Abi.h"
#include <algorithm>
#include <atomic>
#include <cstdio>
#include <numeric>
#include <random>
#include <set>
#include <thread>

using namespace mlir::tai::runtime;
using namespace mlir::tai::runtime::test;

namespace {
/// A level of a path.
struct Level {
  char kind; // 'd'ense, 's'parse, or 'l'ist
  int64_t cells;
};

/// A tree with a single path, which ends in cells with an i32 field.
struct Path {
  TreePtr tree;
  FieldPtr field;
  std::vector<SparseNode *> nodes;
};
} // namespace

static Status makePath(Runtime &runtime, const std::string &name,
                       const std::vector<Level> &levels, Path &path) {
  // Compute strides from the innermost level to the outermost.
  std::vector<int64_t> strides(levels.size());
  int64_t stride = 4;
  for (size_t i = levels.size(); i-- > 0;) {
    strides[i] = stride;
    stride *= levels[i].cells;
  }
  int64_t offset = (stride + 4095) / 4096 * 4096;
  std::vector<SparseInfo> infos;
  SparseInfo info;
  int64_t cells = 1, parent = -1;
  std::vector<int64_t> cellsOf;
  for (size_t i = 0; i < levels.size(); ++i) {
    info.steps.push_back({levels[i].cells, strides[i]});
    cells *= levels[i].cells;
    cellsOf.push_back(cells);
    if (levels[i].kind == 'd')
      continue;
    info.label = "level " + std::to_string(i) + " above @" + name;
    info.isList = levels[i].kind == 'l';
    info.parent = static_cast<int>(parent);
    info.activityOffset = offset;
    offset += info.isList ? (cells / levels[i].cells * 4 + 63) / 64 * 64
                          : (cells + 511) / 512 * 64;
    parent = static_cast<int64_t>(infos.size());
    infos.push_back(info);
  }
  FieldInfo field;
  field.name = name;
  field.layout.scalar = ScalarKind::I32;
  field.layout.sparseNode = static_cast<int>(parent);
  field.layout.indices.resize(1);
  size_t innermost = levels.size() - 1;
  while (levels[innermost].kind == 'd')
    --innermost;
  int64_t divisor = cells;
  for (size_t i = 0; i < levels.size(); ++i) {
    divisor /= levels[i].cells;
    int64_t worth = i <= innermost ? cellsOf[innermost] / cellsOf[i] : 0;
    field.layout.indices[0].push_back(
        {divisor, levels[i].cells, strides[i], worth});
  }
  Status status =
      runtime.store().addTree(name + "_tree", offset, field.tree, infos);
  if (!status)
    return status;
  path.tree = field.tree;
  for (auto &node : path.tree->sparseNodes())
    path.nodes.push_back(node.get());
  return runtime.store().addField(std::move(field), path.field);
}

static std::vector<int64_t> activeCells(SparseNode &node) {
  return node.list()->cells;
}

static std::vector<int64_t> numbers(int64_t count) {
  std::vector<int64_t> all(static_cast<size_t>(count));
  std::iota(all.begin(), all.end(), 0);
  return all;
}

/// Runs `body(thread)` on several threads, which begin together.
template <typename Body> static void onThreads(int count, const Body &body) {
  std::atomic<int> waiting{count};
  std::vector<std::thread> threads;
  for (int t = 0; t < count; ++t)
    threads.emplace_back([&, t] {
      waiting.fetch_sub(1);
      while (waiting.load() > 0)
        std::this_thread::yield();
      body(t);
    });
  for (std::thread &thread : threads)
    thread.join();
}

static constexpr int kThreads = 8;

TEST(RuntimeSparse, ThreadsActivateTheSameCells) {
  Runtime runtime;
  Path path;
  ASSERT_OK(
      makePath(runtime, "x", {{'s', 7}, {'d', 3}, {'s', 130}, {'d', 4}}, path));
  SparseNode &outer = *path.nodes[0], &inner = *path.nodes[1];
  for (int round = 0; round < 20; ++round) {
    std::atomic<int64_t> changed{0};
    onThreads(kThreads, [&](int thread) {
      std::vector<int64_t> order = numbers(inner.numCells());
      std::shuffle(order.begin(), order.end(), std::mt19937(thread + round));
      for (int64_t cell : order)
        changed += inner.activate(cell);
    });
    // Each cell was activated once.
    EXPECT_EQ(changed, inner.numCells());
    EXPECT_EQ(inner.numActive(), inner.numCells());
    EXPECT_EQ(outer.numActive(), outer.numCells());
    EXPECT_EQ(activeCells(inner), numbers(inner.numCells()));
    EXPECT_EQ(activeCells(outer), numbers(outer.numCells()));
    EXPECT_EQ(runtime.memory().activeCellBytes(), inner.numCells() * 16);
    outer.deactivateAll();
    EXPECT_EQ(inner.numActive(), 0);
    EXPECT_EQ(outer.numActive(), 0);
    EXPECT_TRUE(activeCells(inner).empty());
    EXPECT_EQ(runtime.memory().activeCellBytes(), 0);
  }
}

TEST(RuntimeSparse, ThreadsAppendToTheSameList) {
  Runtime runtime;
  Path path;
  ASSERT_OK(makePath(runtime, "x", {{'s', 5}, {'l', 1000}}, path));
  SparseNode &list = *path.nodes[1];
  std::vector<std::vector<int64_t>> given(kThreads);
  std::atomic<int64_t> refused{0};
  onThreads(kThreads, [&](int thread) {
    for (int i = 0; i < 150; ++i) {
      int64_t at = list.append(3);
      if (at < 0)
        ++refused;
      else
        given[thread].push_back(at);
    }
  });
  std::vector<int64_t> all;
  for (const std::vector<int64_t> &some : given) {
    EXPECT_TRUE(std::is_sorted(some.begin(), some.end()));
    all.insert(all.end(), some.begin(), some.end());
  }
  std::sort(all.begin(), all.end());
  EXPECT_EQ(all, numbers(1000));
  EXPECT_EQ(refused, kThreads * 150 - 1000);
  EXPECT_EQ(list.length(3), 1000);
  EXPECT_EQ(list.numActive(), 1000);
  EXPECT_EQ(activeCells(*path.nodes[0]), std::vector<int64_t>{3});
}

TEST(RuntimeSparse, ThreadsLengthenAListByWriting) {
  Runtime runtime;
  Path path;
  ASSERT_OK(makePath(runtime, "x", {{'d', 4}, {'l', 500}}, path));
  SparseNode &list = *path.nodes[0];
  onThreads(kThreads, [&](int thread) {
    for (int64_t i = thread; i < 400; i += kThreads)
      for (int64_t l = 0; l < 4; ++l)
        list.activate(l * 500 + i);
  });
  EXPECT_EQ(list.numActive(), 1600);
  for (int64_t l = 0; l < 4; ++l)
    EXPECT_EQ(list.length(l), 400);
}

TEST(RuntimeSparse, ThreadsDeactivateCellsOfOneWord) {
  Runtime runtime;
  Path path;
  ASSERT_OK(makePath(runtime, "x", {{'s', 256}, {'s', 3}}, path));
  SparseNode &outer = *path.nodes[0], &inner = *path.nodes[1];
  auto *values = reinterpret_cast<int32_t *>(path.field->data());
  for (int64_t cell = 0; cell < inner.numCells(); ++cell) {
    inner.activate(cell);
    values[cell] = 1;
  }
  // Deactivate all cells but every eighth, which other threads activate
  // meanwhile.
  onThreads(kThreads, [&](int thread) {
    for (int64_t cell = thread; cell < 256; cell += kThreads)
      if (thread == 5)
        inner.activate(cell * 3 + 1);
      else
        outer.deactivate(cell);
  });
  EXPECT_EQ(outer.numActive(), 32);
  EXPECT_EQ(inner.numActive(), 96);
  for (int64_t cell = 0; cell < inner.numCells(); ++cell)
    ASSERT_EQ(values[cell], cell / 3 % kThreads == 5);
}

// A list is in the order of memory, however many threads create it.
TEST(RuntimeSparse, ListsMadeInParallelAreTheSame) {
  Options one, many;
  one.threads = 1;
  many.threads = 5;
  Runtime serial(one), parallel(many);
  for (bool isList : {false, true}) {
    std::string name = isList ? "l" : "s";
    std::vector<Level> levels = {{'s', 1000}, {isList ? 'l' : 's', 700}};
    Path a, b;
    ASSERT_OK(makePath(serial, name, levels, a));
    ASSERT_OK(makePath(parallel, name, levels, b));
    std::mt19937 random(7);
    for (int i = 0; i < 120000; ++i) {
      // Dense in some regions, empty in others.
      int64_t cell =
          static_cast<int64_t>(std::min(random() % 700000, random() % 700000));
      a.nodes[1]->activate(cell);
      b.nodes[1]->activate(cell);
    }
    ASSERT_GT(a.nodes[1]->numActive(), 1 << 15);
    std::vector<int64_t> cells = activeCells(*a.nodes[1]);
    EXPECT_EQ(static_cast<int64_t>(cells.size()), a.nodes[1]->numActive());
    EXPECT_TRUE(std::is_sorted(cells.begin(), cells.end()));
    EXPECT_EQ(cells, activeCells(*b.nodes[1]));
    // A second request reuses the list; after a change, the list is recreated.
    activeCells(*b.nodes[1]);
    EXPECT_EQ(b.nodes[1]->listsMade(), 1);
    EXPECT_EQ(b.nodes[1]->listsReused(), 1);
    b.nodes[0]->deactivate(cells.front() / 700);
    EXPECT_LT(activeCells(*b.nodes[1]).size(), cells.size());
    EXPECT_EQ(b.nodes[1]->listsMade(), 2);
  }
}

// A list that is created while cells become active contains the cells that were
// active before, each once.
TEST(RuntimeSparse, ListsWhileOthersActivate) {
  Runtime runtime;
  Path path;
  ASSERT_OK(makePath(runtime, "x", {{'s', 4000}, {'d', 2}}, path));
  SparseNode &node = *path.nodes[0];
  for (int64_t cell = 0; cell < 4000; cell += 4)
    node.activate(cell);
  std::atomic<bool> right{true};
  onThreads(kThreads, [&](int thread) {
    if (thread % 2) {
      for (int64_t cell = thread; cell < 4000; cell += kThreads)
        node.activate(cell);
      return;
    }
    for (int i = 0; i < 200; ++i) {
      std::vector<int64_t> cells = activeCells(node);
      bool fits =
          std::adjacent_find(cells.begin(), cells.end(),
                             std::greater_equal<int64_t>()) == cells.end();
      for (int64_t cell = 0; cell < 4000; cell += 4)
        fits &= std::binary_search(cells.begin(), cells.end(), cell);
      if (!fits)
        right = false;
    }
  });
  EXPECT_TRUE(right);
  std::vector<int64_t> now = activeCells(node);
  EXPECT_EQ(static_cast<int64_t>(now.size()), node.numActive());
}

//===----------------------------------------------------------------------===//
// Comparison with sets
//===----------------------------------------------------------------------===//

TEST(RuntimeSparse, RandomActivityIsThatOfSets) {
  for (unsigned seed = 0; seed < 60; ++seed) {
    std::mt19937 random(seed);
    Runtime runtime;
    std::vector<Level> levels;
    for (unsigned i = 0, n = 1 + random() % 3; i < n; ++i)
      levels.push_back({"dsl"[random() % 3],
                        static_cast<int64_t>(1 + random() % (i ? 40 : 90))});
    levels.push_back({"sl"[random() % 2], int64_t(1 + random() % 70)});
    Path path;
    ASSERT_OK(makePath(runtime, "x", levels, path));
    size_t count = path.nodes.size();
    auto *values = reinterpret_cast<int32_t *>(path.field->data());
    int64_t all = path.nodes.back()->numCells();
    std::vector<std::set<int64_t>> active(count);
    std::vector<int32_t> expected(static_cast<size_t>(all), 0);
    auto activate = [&](size_t at, int64_t cell) {
      for (size_t k = at + 1; k-- > 0;) {
        SparseNode &node = *path.nodes[k];
        int64_t own = cell / (path.nodes[at]->numCells() / node.numCells());
        int64_t first = node.info().isList ? own - own % node.capacity() : own;
        for (int64_t c = first; c <= own; ++c)
          active[k].insert(c);
      }
    };
    for (int step = 0; step < 60; ++step) {
      size_t at = random() % count;
      SparseNode &node = *path.nodes[at];
      int64_t cell = static_cast<int64_t>(random() % node.numCells());
      if (random() % 3) {
        bool wasActive = active[at].count(cell);
        EXPECT_EQ(node.activate(cell), !wasActive);
        activate(at, cell);
        if (at + 1 == count)
          values[cell] = expected[cell] = step + 1;
        continue;
      }
      node.deactivate(cell);
      if (!active[at].count(cell) &&
          !(node.info().isList &&
            active[at].count(cell - cell % node.capacity())))
        continue;
      int64_t first = cell, last = cell + 1;
      if (node.info().isList) {
        first = cell - cell % node.capacity();
        last = first + node.capacity();
      }
      for (size_t k = at; k < count; ++k) {
        int64_t span = path.nodes[k]->numCells() / node.numCells();
        active[k].erase(active[k].lower_bound(first * span),
                        active[k].lower_bound(last * span));
      }
      int64_t span = all / node.numCells();
      std::fill(expected.begin() + first * span, expected.begin() + last * span,
                0);
    }
    for (size_t k = 0; k < count; ++k) {
      EXPECT_EQ(activeCells(*path.nodes[k]),
                std::vector<int64_t>(active[k].begin(), active[k].end()))
          << "seed " << seed;
      EXPECT_EQ(path.nodes[k]->numActive(), int64_t(active[k].size()));
    }
    EXPECT_TRUE(std::equal(expected.begin(), expected.end(), values))
        << "seed " << seed;
  }
}

//===----------------------------------------------------------------------===//
// Memory
//===----------------------------------------------------------------------===//

static long residentPages() {
  long size = 0, resident = 0;
  if (FILE *file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &size, &resident) != 2)
      resident = 0;
    std::fclose(file);
  }
  return resident;
}

TEST(RuntimeSparse, RoundsOfTreesLeakNothing) {
  Runtime runtime;
  auto rounds = [&](int count) {
    for (int i = 0; i < count; ++i) {
      Path path;
      ASSERT_OK(makePath(runtime, "x", {{'s', 1 << 12}, {'d', 1 << 12}}, path));
      for (int64_t cell : {0, 77, 4095})
        set(*path.field, {cell << 12}, 1);
      ASSERT_EQ(activeCells(*path.nodes[0]).size(), 3u);
      ASSERT_OK(runtime.destroyTree("x_tree"));
    }
  };
  rounds(1000);
  long before = residentPages();
  rounds(9000);
#ifndef TAI_TEST_SANITIZED
  EXPECT_LE(residentPages(), before + before / 100 + 64);
#else
  (void)before;
#endif
  EXPECT_EQ(runtime.memory().activeCellBytes(), 0);
}

// Deactivation returns whole pages, except pages that a cell shares with the
// next.
TEST(RuntimeSparse, RoundsOfActivityLeakNothing) {
  Runtime runtime;
  Path path;
  ASSERT_OK(makePath(runtime, "x", {{'s', 1 << 10}, {'d', 1 << 14}}, path));
  long before = residentPages();
  for (int round = 0; round < 2; ++round) {
    for (int64_t cell = 0; cell < 1 << 10; ++cell) {
      for (int64_t page = 0; page < 16; ++page)
        set(*path.field, {(cell << 14) + page * 1024}, 1);
      path.nodes[0]->deactivate(cell);
    }
#ifndef TAI_TEST_SANITIZED
    // 16 pages of each cell were written to.
    EXPECT_LE(residentPages(), before + (1 << 10) + 256);
#else
    (void)before;
#endif
  }
}

TEST(RuntimeSparse, RunningOutNamesTheLevel) {
  Options options;
  options.memoryLimit = 1 << 20;
  Runtime runtime(options);
  Path path;
  // 64 GiB of addresses, in cells of 256 KiB; the limit allows four cells.
  ASSERT_OK(makePath(runtime, "x", {{'s', 1 << 18}, {'d', 1 << 16}}, path));
  auto write = [&](int64_t cell) {
    int64_t index = cell << 16;
    return runtime.writes().writeI64(*path.field, &index, 0, 1);
  };
  for (int64_t cell : {0, 1000, 200000, 262143})
    ASSERT_OK(write(cell));
  Status status = write(5);
  EXPECT_EQ(status.code(), StatusCode::Memory);
  EXPECT_EQ(status.message(),
            "out of memory: one more cell of level 0 above @x of 256.0 KiB "
            "each; its 4 active cells take 1.0 MiB, and all fields take 1.0 "
            "MiB of 1.0 MiB");
  // Active cells can be written to, and deactivating cells frees memory for
  // others.
  EXPECT_OK(write(1000));
  path.nodes[0]->deactivate(0);
  EXPECT_OK(write(5));
  std::vector<int64_t> expected = {5, 1000, 200000, 262143};
  EXPECT_EQ(activeCells(*path.nodes[0]), expected);
}

//===----------------------------------------------------------------------===//
// Functions that compiled code calls
//===----------------------------------------------------------------------===//

namespace {
/// The function that a kernel has to call, and the cell.
struct Call {
  Tree *tree;
  char what;
  int64_t number;
  int64_t answer;
};
Call call;
} // namespace

static int32_t makeCall(TaiFrame *frame) {
  char *base = call.tree->base();
  if (call.what == 'a')
    call.answer = tai_rt_activate(frame, base, 0, call.number, "");
  else if (call.what == 'p')
    call.answer = tai_rt_append(frame, base, 0, call.number, "");
  else
    tai_rt_deactivate(frame, base, 0, call.number, "");
  return 0;
}

TEST(RuntimeSparse, CallsOutOfRangeFail) {
  Runtime runtime;
  Path cells, lists;
  ASSERT_OK(makePath(runtime, "x", {{'s', 100}}, cells));
  ASSERT_OK(makePath(runtime, "y", {{'d', 3}, {'l', 5}}, lists));
  auto launch = [&](Path &path, char what, int64_t number) {
    call = {path.tree.get(), what, number, 7};
    auto kernel =
        makeKernel(runtime, "k", makeCall, {{path.field, AccessKind::Write}});
    return runtime.launch(*kernel, nullptr, 0, nullptr);
  };
  for (int64_t number : {int64_t(-1), int64_t(100), INT64_MAX, INT64_MIN})
    for (char what : {'a', 'd'}) {
      Status status = launch(cells, what, number);
      EXPECT_EQ(status.code(), StatusCode::Index);
      EXPECT_EQ(status.message(), "index out of range: there is no cell " +
                                      std::to_string(number) +
                                      " in level 0 above @x, which has 100");
      EXPECT_EQ(call.answer, what == 'a' ? 0 : 7);
    }
  for (int64_t number : {int64_t(-1), int64_t(3), INT64_MAX}) {
    EXPECT_EQ(launch(lists, 'p', number).code(), StatusCode::Index);
    EXPECT_EQ(call.answer, -1);
  }
  EXPECT_EQ(cells.nodes[0]->numActive(), 0);
  EXPECT_EQ(lists.nodes[0]->numActive(), 0);
  for (int i = 0; i < 5; ++i) {
    EXPECT_OK(launch(lists, 'p', 2));
    EXPECT_EQ(call.answer, i);
  }
  EXPECT_EQ(launch(lists, 'p', 2).message(),
            "append to a full list: level 1 above @y holds at most 5 cells");
  EXPECT_OK(launch(cells, 'a', 99));
  EXPECT_EQ(cells.nodes[0]->numActive(), 1);
}
