//===- WatchedViews.cpp - Fields that other libraries may write -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "WatchedViews.h"
#include "ArrayArguments.h"
#include "TensorView.h"

#include <utility>
#include <vector>

using namespace taipy;

namespace {

struct View {
  uint64_t begin, bytes, digest;
};

/// The views that a thread watches while it records.
struct Watched {
  py::object tape;
  std::vector<View> views;
  bool looksAtAll;
  /// The length of the tape after the last launch: each write of Python is a
  /// record. Negative before the first launch, because the values at which one
  /// differentiates may come through a view.
  long long records = -1;

  long long countRecords() const {
    static const Name name("records");
    py::object count = take(get(tape.ptr(), name));
    return count ? PyLong_AsLongLong(count.ptr()) : -1;
  }
  uint64_t digestOf(const View &view) const {
    return looksAtAll ? digest(view.begin, view.bytes)
                      : sample(view.begin, view.bytes);
  }
  bool isComparable() const {
    return records >= 0 && records == countRecords();
  }
};
/// Not an object itself: a thread ends without Python's lock.
thread_local Watched *watched = nullptr;

} // namespace

bool taipy::haveViewsChanged() {
  if (__builtin_expect(!watched, true) || !watched->isComparable())
    return false;
  for (const View &view : watched->views)
    if (watched->digestOf(view) != view.digest)
      return true;
  return false;
}

void taipy::renewViews() {
  if (__builtin_expect(!watched, true))
    return;
  watched->records = watched->countRecords();
  for (View &view : watched->views)
    view.digest = watched->digestOf(view);
}

void taipy::bindWatchedViews(py::module_ &module) {
  // The caller keeps the memory, until it calls this with no views.
  module.def("watch_views",
             [](const py::object &tape,
                const std::vector<std::pair<uint64_t, uint64_t>> &memory,
                bool looksAtAll) {
               delete std::exchange(watched, nullptr);
               if (memory.empty())
                 return;
               auto made = std::make_unique<Watched>();
               made->tape = tape;
               made->looksAtAll = looksAtAll;
               for (auto [begin, bytes] : memory)
                 made->views.push_back({begin, bytes, 0});
               watched = made.release();
             });
  // The numbers of those that have changed. They count as unchanged from now
  // on.
  module.def("take_changed_views", [] {
    std::vector<size_t> changed;
    if (!watched)
      return changed;
    bool isComparable = watched->isComparable();
    for (size_t i = 0; i < watched->views.size(); ++i) {
      View &view = watched->views[i];
      uint64_t now = watched->digestOf(view);
      if (isComparable && now != view.digest)
        changed.push_back(i);
      view.digest = now;
    }
    return changed;
  });
}
