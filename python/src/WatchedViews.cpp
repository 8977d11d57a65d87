//===- WatchedViews.cpp - Fields that other libraries may write -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "WatchedViews.h"
#include "ArrayArguments.h"
#include "TensorView.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>
#include <vector>

using namespace taipy;

namespace {

/// Elements of `size` bytes, `step` bytes apart. Elements of other fields may
/// lie in between.
struct View {
  uint64_t begin, size, step, count;
  bool isOnDevice;
  uint64_t digest = 0;

  /// Returns the part of the view that is compared: all elements, or a sample
  /// spread over the field.
  View sampled() const {
    constexpr uint64_t bytes = 2048, alignment = 16;
    if (count * size <= bytes)
      return *this;
    View some = *this;
    if (step == size) {
      // Pieces of several elements, which a device copies by aligned words.
      constexpr uint64_t piece = 64;
      some.count = bytes / piece;
      some.step =
          (count * size - piece) / (some.count - 1) / alignment * alignment;
      some.size = piece;
    } else {
      some.count = std::max<uint64_t>(bytes / size, 2);
      some.step = (count - 1) / (some.count - 1) * step;
    }
    return some;
  }
  bool isDense() const { return count == 1 || step == size; }
};

/// The views that a thread watches while it records.
struct Watched {
  py::object tape;
  ContextRef context;
  std::vector<View> views;
  bool looksAtAll;
  /// The length of the tape after the last launch: each write of Python is a
  /// record. Negative before the first launch, because the program may use a
  /// view to set the values at which it differentiates.
  long long records = -1;
  /// A copy of the compared memory, if it is on a device or not dense.
  std::vector<char> copy;

  long long countRecords() const {
    static const Name name("records");
    py::object count = take(get(tape.ptr(), name));
    return count ? PyLong_AsLongLong(count.ptr()) : -1;
  }
  /// False if a Python exception has been raised.
  bool digestOf(const View &whole, uint64_t &result) {
    View view = looksAtAll ? whole : whole.sampled();
    uint64_t bytes = view.count * view.size;
    if (view.isDense() && !view.isOnDevice) {
      result = digest(view.begin, bytes);
      return true;
    }
    copy.resize(bytes);
    if (view.isOnDevice) {
      if (!readOnDevice(view))
        return false;
    } else {
      for (uint64_t i = 0; i < view.count; ++i)
        std::memcpy(copy.data() + i * view.size,
                    reinterpret_cast<const char *>(view.begin) + i * view.step,
                    view.size);
    }
    result = digest(reinterpret_cast<uint64_t>(copy.data()), bytes);
    return true;
  }
  bool isComparable() const {
    return records >= 0 && records == countRecords();
  }
  /// Finds out whether memory has changed. Unless `changed` is null, the
  /// numbers of changed views are appended to it, and the new digests replace
  /// the old ones.
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
  bool readOnDevice(const View &view) {
    bool isDense = view.isDense();
    uint64_t bytes = isDense ? view.count * view.size : view.size;
    TaiStatus status = taiContextReadOnDevice(
        context->handle, reinterpret_cast<const void *>(view.begin),
        isDense ? 0 : static_cast<int64_t>(view.step),
        static_cast<int64_t>(bytes),
        isDense ? 1 : static_cast<int64_t>(view.count), copy.data());
    if (!afterCall())
      return false;
    if (status == TAI_OK)
      return true;
    setError(context->handle, status);
    return false;
  }
};
/// A pointer, since destructors at the end of a thread run without Python's
/// lock.
thread_local Watched *watched = nullptr;

} // namespace

int taipy::watchingViews = 0;

Changed taipy::compareViews() {
  if (!watched || !watched->isComparable())
    return Changed::No;
  return watched->compare(nullptr);
}

bool taipy::digestViews() { return !watched || watched->renew(); }

void taipy::bindWatchedViews(py::module_ &module) {
  // The caller keeps the memory until it calls this function with no views. A
  // view has an address, the bytes of an element, the bytes from one element to
  // the next, and a count. `has_launched`: launches have already been recorded.
  module.def(
      "watch_views",
      [](const py::object &tape,
         const std::vector<std::array<uint64_t, 4>> &memory, bool looksAtAll,
         const ContextRef &context, bool hasLaunched) {
        watchingViews -= watched ? 1 : 0;
        delete std::exchange(watched, nullptr);
        if (memory.empty())
          return;
        auto made = std::make_unique<Watched>();
        made->tape = tape;
        made->context = context;
        made->looksAtAll = looksAtAll;
        for (auto [begin, size, step, count] : memory) {
          bool isOnDevice = taiContextIsOnDevice(
              context->handle, reinterpret_cast<const void *>(begin));
          if (!afterCall())
            throw py::error_already_set();
          made->views.push_back({begin, size, step, count, isOnDevice});
        }
        if (hasLaunched && !made->renew())
          throw py::error_already_set();
        watched = made.release();
        ++watchingViews;
      },
      py::arg("tape"), py::arg("memory"), py::arg("looks_at_all"),
      py::arg("context").none(true), py::arg("has_launched"));
  // The numbers of the views that have changed, which count as unchanged from
  // now on.
  module.def("take_changed_views", [] {
    std::vector<size_t> changed;
    if (watched && watched->compare(&changed) == Changed::Error)
      throw py::error_already_set();
    return changed;
  });
}
