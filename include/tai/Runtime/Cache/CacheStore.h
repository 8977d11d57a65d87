//===- CacheStore.h - Bytes on disk, by key ---------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Keeps compiled code between processes. The code is executed, so the folder
// must belong to this user alone; a process may be killed at any point, so an
// entry is renamed into place when complete, and verified on each read. An
// unusable cache costs time and never a result: no call here fails.
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
  /// Uses `folder`, created with mode 0700 if missing; "" disables the cache.
  /// Keeps at most `maxBytes` bytes, the most recently used entries. `warn`, by
  /// default the standard error, gets at most one message for each kind of
  /// problem.
  using Warn = std::function<void(const std::string &message)>;
  explicit CacheStore(std::string folder, int64_t maxBytes = int64_t(1) << 30,
                      Warn warn = nullptr);
  ~CacheStore();
  CacheStore(const CacheStore &) = delete;
  CacheStore &operator=(const CacheStore &) = delete;

  /// False if the cache is disabled, or its folder is not writable or not
  /// trusted.
  bool usable() const { return folderDescriptor >= 0; }
  const std::string &folder() const { return path; }

  /// Returns the bytes stored for a key; none if there is no entry or if the
  /// entry is damaged. Keys are arbitrary bytes. Thread-safe.
  std::optional<std::string> get(std::string_view key);
  /// Stores an entry in the cache; false if that was not possible. Thread-safe.
  bool put(std::string_view key, std::string_view bytes);
  /// Stores an entry on a background thread, since writing to the disk takes
  /// milliseconds. Until the thread is done, get() may not find the entry.
  void putLater(std::string key, std::string bytes);
  /// The exclusive right, among processes, to make the entry of a key: a file
  /// lock. Other processes wait, and then find the entry. Released with the
  /// last copy, or when the process ends for whatever reason.
  using Claim = std::shared_ptr<void>;
  /// Claims the right to make an entry. Waits until the current owner releases
  /// the claim, at most `mostSeconds`: after that, or where files cannot be
  /// locked, the result is null, and two processes may make the entry.
  /// `goesOn`, if given, is called at least every 20 ms; waiting ends when it
  /// returns false. Thread-safe.
  Claim claim(std::string_view key, double mostSeconds = 60,
              const std::function<bool()> &goesOn = nullptr);
  /// Waits until the entries of all putLater calls are written, as the
  /// destructor does.
  void flush();
  /// Removes least recently used entries beyond the limit, and temporary files
  /// of killed processes. `put` does so after each sixteenth of the limit that
  /// all processes together have stored, and once a day.
  void prune();
  /// Removes every entry.
  void clean();
  /// Verifies every entry and removes the damaged ones; returns the number of
  /// undamaged entries.
  int64_t verify();

  CacheStats stats() const;
  struct Size {
    int64_t entries = 0, bytes = 0;
  };
  Size size() const;

  /// The name of the file, within the cache folder, that holds the entry of
  /// `key`.
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
  bool noteStored(int64_t bytes);
  void beginJournal();

  std::atomic<int64_t> hits{0}, misses{0}, corrupt{0}, stored{0}, pruned{0};
  std::atomic<unsigned> warned{0};
  std::atomic<int64_t> bytesSincePrune{0};
  std::atomic<bool> prunedOnce{false};
  /// A mutex that callers of putLater and flush hold for a moment. The writing
  /// thread never locks it.
  std::mutex writerMutex;
  std::unique_ptr<Writer> writer;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_CACHE_CACHESTORE_H
