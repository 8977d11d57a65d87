//===- ShadowLog.cpp - Results of shadow execution ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/ShadowLog.h"
#include <algorithm>
#include <cmath>
#include <string_view>
#include <sys/mman.h>
#include <tuple>
#include <unistd.h>

using namespace mlir::tai::runtime;

char *tai_rt_shadows = nullptr;

Status shadow::reserve() {
  static std::mutex mutex;
  std::lock_guard<std::mutex> lock(mutex);
  // The table of shadows ends with an additional page, in which a vector ends
  // that begins in the last entries.
  constexpr size_t size = 2 * (TAI_SHADOW_MASK + 1) + 4096;
  if (tai_rt_shadows) {
    // The entries of earlier contexts are discarded, because the entry of an
    // f64 could be taken for the entry of an f32 that is zero. Contexts that
    // are in use lose their shadows, too.
    madvise(tai_rt_shadows, size, MADV_DONTNEED);
    return Status::success();
  }
  void *table = mmap(nullptr, size, PROT_READ | PROT_WRITE,
                     MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (table == MAP_FAILED)
    return Status::failure(
        StatusCode::Memory,
        "option 'shadow': the system refuses 32 GiB of addresses for shadows "
        "(they take memory as they are used); raise the limit of addresses of "
        "the process (ulimit -v)");
  tai_rt_shadows = static_cast<char *>(table);
  return Status::success();
}

void shadow::forget(const void *address, int64_t bytes) {
  if (!tai_rt_shadows || bytes <= 0)
    return;
  // The low bits of an address select its entry in the table of shadows, so a
  // range of addresses can pass the end of the table and continue at its start.
  const char *at = static_cast<const char *>(address);
  while (bytes > 0) {
    uint64_t first = reinterpret_cast<uintptr_t>(at) & TAI_SHADOW_MASK;
    auto count = static_cast<int64_t>(std::min<uint64_t>(
        static_cast<uint64_t>(bytes), TAI_SHADOW_MASK + 1 - first));
    std::memset(tai_rt_shadows + 2 * first, 0, static_cast<size_t>(2 * count));
    at += count;
    bytes -= count;
  }
}

static uint64_t makeIdentity() {
  static std::atomic<uint64_t> count{0};
  return ++count;
}

ShadowLog::ShadowLog() : identity(makeIdentity()) {}

ShadowLog::Site &ShadowLog::add(TaiShadowSite &named) {
  const char *text = reinterpret_cast<const char *>(&named + 1);
  std::lock_guard<std::mutex> lock(mutex);
  auto found = sites.find(std::string_view(text));
  if (found == sites.end())
    found = sites.emplace(text, std::make_unique<Site>(text)).first;
  named.site = found->second.get();
  __atomic_store_n(&named.log, identity, __ATOMIC_RELEASE);
  return *found->second;
}

std::vector<ShadowRow> ShadowLog::rows() const {
  std::lock_guard<std::mutex> lock(mutex);
  std::vector<ShadowRow> rows;
  for (const auto &[text, site] : sites) {
    int64_t lost = site->lost, flips = site->flips, wild = site->nonFinite;
    if (!lost && !flips && !wild)
      continue;
    size_t first = text.find('\n'), second = text.find('\n', first + 1);
    std::lock_guard<std::mutex> worst(site->worst);
    rows.push_back(
        {text.substr(0, first), text.substr(first + 1, second - first - 1),
         text.substr(second + 1), site->precision, lost, site->cancellations,
         flips, wild, site->errorMade, site->errorIn,
         std::max(std::log2(site->growth.load()), 0.0)});
  }
  std::sort(rows.begin(), rows.end(),
            [](const ShadowRow &a, const ShadowRow &b) {
              return std::tie(b.bitsLost, a.place, a.operation, a.kernel) <
                     std::tie(a.bitsLost, b.place, b.operation, b.kernel);
            });
  return rows;
}

void ShadowLog::clear() {
  std::lock_guard<std::mutex> lock(mutex);
  for (auto &[text, site] : sites) {
    std::lock_guard<std::mutex> worst(site->worst);
    site->lost = site->cancellations = site->flips = site->nonFinite = 0;
    site->growth = site->errorMade = site->errorIn = 0;
  }
}
