//===- CacheStore.h - Bytes on disk, by key ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Keeps compiled code between processes. Compiled code is run, so the folder
// must belong to this user alone; and a process may be killed at any point, so
// an entry appears by rename, whole, and is checked whenever it is read. A
// cache that cannot be used costs time and never a result: no call here fails.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_CACHE_CACHESTORE_H
#define TAI_RUNTIME_CACHE_CACHESTORE_H

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace mlir::tai::runtime {

struct CacheStats {
  int64_t hits = 0;
  int64_t misses = 0;
  int64_t corrupt = 0; // entries found broken (they are misses too)
  int64_t stored = 0;
  int64_t pruned = 0;
};

class CacheStore {
public:
  /// Uses `folder`, made with mode 0700 where missing; "" is no cache. At most
  /// `maxBytes` are kept, those used last. `warn` is told at most once about
  /// each kind of trouble; the standard error by default.
  using Warn = std::function<void(const std::string &message)>;
  explicit CacheStore(std::string folder, int64_t maxBytes = int64_t(1) << 30,
                      Warn warn = nullptr);
  ~CacheStore();
  CacheStore(const CacheStore &) = delete;
  CacheStore &operator=(const CacheStore &) = delete;

  /// False where there is no folder that may be trusted and written.
  bool usable() const { return folderDescriptor >= 0; }
  const std::string &folder() const { return path; }

  /// The bytes stored for the key; nothing if there are none or if the entry
  /// is not exactly what was stored. Any bytes make a key. Any thread.
  std::optional<std::string> get(std::string_view key);
  /// Stores; false if that was not possible. Any thread.
  bool put(std::string_view key, std::string_view bytes);
  /// The same on a thread of its own, since waiting for the disk takes
  /// milliseconds. Until it is done, get() may not find the entry.
  void putLater(std::string key, std::string bytes);
  /// The right to make the entry of a key. Processes that want it meanwhile
  /// wait, and then find it. Given back when the last copy goes, or when the
  /// process ends, however it does.
  using Claim = std::shared_ptr<void>;
  /// Waits for whoever has the right now, but no longer than so many seconds:
  /// then, or where no file can be locked, the claim is null, and two may make
  /// the entry. `goesOn`, if there is one, is asked at least every 20 ms
  /// whether to wait on. Any thread.
  Claim claim(std::string_view key, double mostSeconds = 60,
              const std::function<bool()> &goesOn = nullptr);
  /// Waits for what putLater has begun; so does the destructor.
  void flush();
  /// Removes least recently used entries beyond the limit, and what killed
  /// processes left behind.
  void prune();
  /// Removes every entry.
  void clean();
  /// Checks every entry, removes the broken ones; returns how many were good.
  int64_t verify();

  CacheStats stats() const;
  struct Size {
    int64_t entries = 0, bytes = 0;
  };
  Size size() const;

  /// The name of the entry of a key inside the folder.
  static std::string fileName(std::string_view key);

private:
  int openFolder(std::string &reason) const;
  std::optional<std::string> readEntry(const std::string &name,
                                       const std::string_view *key,
                                       bool &broken) const;
  void warnOnce(int kind, const std::string &message);

  std::string path;
  int64_t maxBytes;
  Warn warn;
  int folderDescriptor = -1;
  std::atomic<uint64_t> nextTemporary{0};
  struct Writer;
  Writer &currentWriter();

  std::atomic<int64_t> hits{0}, misses{0}, corrupt{0}, stored{0}, pruned{0};
  std::atomic<unsigned> warned{0};
  std::atomic<int64_t> bytesSincePrune{0};
  std::atomic<bool> prunedOnce{false};
  /// Held by callers of putLater and flush for a moment, never by the writer.
  std::mutex writerMutex;
  std::unique_ptr<Writer> writer;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_CACHE_CACHESTORE_H
