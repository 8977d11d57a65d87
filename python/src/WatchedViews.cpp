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
  bool isOnDevice;
};

/// The views that a thread watches while it records.
struct Watched {
  py::object tape;
  ContextRef context;
  std::vector<View> views;
  bool looksAtAll;
  /// The length of the tape after the last launch: each write of Python is a
  /// record. Negative before the first launch, because the values at which one
  /// differentiates may come through a view.
  long long records = -1;
  /// Copies of memory of the device.
  std::vector<char> copy;

  long long countRecords() const {
    static const Name name("records");
    py::object count = take(get(tape.ptr(), name));
    return count ? PyLong_AsLongLong(count.ptr()) : -1;
  }
  /// False if a Python exception has been raised.
  bool digestOf(const View &view, uint64_t &result) {
    if (view.isOnDevice)
      return digestOnDevice(view, result);
    result = looksAtAll ? digest(view.begin, view.bytes)
                        : sample(view.begin, view.bytes);
    return true;
  }
  bool isComparable() const {
    return records >= 0 && records == countRecords();
  }
  /// Whether memory has changed; the new digests replace the old ones.
  Changed compare(std::vector<size_t> *changed) {
    bool comparable = isComparable(), any = false;
    for (size_t i = 0; i < views.size(); ++i) {
      uint64_t now = 0;
      if (!digestOf(views[i], now))
        return Changed::Error;
      if (comparable && now != views[i].digest) {
        any = true;
        if (!changed)
          return Changed::Yes;
        changed->push_back(i);
      }
      if (changed)
        views[i].digest = now;
    }
    return any ? Changed::Yes : Changed::No;
  }
  bool renew() {
    records = countRecords();
    for (View &view : views)
      if (!digestOf(view, view.digest))
        return false;
    return true;
  }

private:
  /// The host waits for the device, which costs some microseconds for a sample.
  bool digestOnDevice(const View &view, uint64_t &result) {
    constexpr uint64_t pieces = 32, size = 64, alignment = 16;
    bool isWhole = looksAtAll || view.bytes <= pieces * size;
    uint64_t rows = isWhole ? 1 : pieces, bytes = isWhole ? view.bytes : size;
    uint64_t step =
        isWhole ? 0
                : (view.bytes - size) / (pieces - 1) / alignment * alignment;
    copy.resize(rows * bytes);
    TaiStatus status = taiContextReadOnDevice(
        context->handle, reinterpret_cast<const void *>(view.begin),
        static_cast<int64_t>(step), static_cast<int64_t>(bytes),
        static_cast<int64_t>(rows), copy.data());
    if (!afterCall())
      return false;
    if (status != TAI_OK) {
      setError(context->handle, status);
      return false;
    }
    result = digest(reinterpret_cast<uint64_t>(copy.data()), copy.size());
    return true;
  }
};
/// Not an object itself: a thread ends without Python's lock.
thread_local Watched *watched = nullptr;

} // namespace

Changed taipy::haveViewsChanged() {
  if (__builtin_expect(!watched, true) || !watched->isComparable())
    return Changed::No;
  return watched->compare(nullptr);
}

bool taipy::renewViews() {
  return __builtin_expect(!watched, true) || watched->renew();
}

void taipy::bindWatchedViews(py::module_ &module) {
  // The caller keeps the memory, until it calls this with no views. Some
  // launches may have been recorded.
  module.def(
      "watch_views",
      [](const py::object &tape,
         const std::vector<std::pair<uint64_t, uint64_t>> &memory,
         bool looksAtAll, const ContextRef &context, bool hasLaunched) {
        delete std::exchange(watched, nullptr);
        if (memory.empty())
          return;
        auto made = std::make_unique<Watched>();
        made->tape = tape;
        made->context = context;
        made->looksAtAll = looksAtAll;
        for (auto [begin, bytes] : memory) {
          bool isOnDevice = taiContextIsOnDevice(
              context->handle, reinterpret_cast<const void *>(begin));
          if (!afterCall())
            throw py::error_already_set();
          made->views.push_back({begin, bytes, 0, isOnDevice});
        }
        if (hasLaunched && !made->renew())
          throw py::error_already_set();
        watched = made.release();
      },
      py::arg("tape"), py::arg("memory"), py::arg("looks_at_all"),
      py::arg("context").none(true), py::arg("has_launched"));
  // The numbers of those that have changed. They count as unchanged from now
  // on.
  module.def("take_changed_views", [] {
    std::vector<size_t> changed;
    if (watched && watched->compare(&changed) == Changed::Error)
      throw py::error_already_set();
    return changed;
  });
}
