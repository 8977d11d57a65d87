//===- CacheStore.cpp - Bytes on disk, by key -----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// An entry is a header, the key and the bytes. The header holds the sizes and a
// checksum over all three, and the key is compared whole: so an entry that was
// truncated, changed or renamed is detected. All files are reached through the
// descriptor of the folder that was checked.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Support/XXHash.h"
#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <deque>
#include <dirent.h>
#include <fcntl.h>
#include <mutex>
#include <pthread.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>
#include <utility>

using namespace mlir::tai::runtime;

namespace {
struct Header {
  char magic[8];
  uint32_t version;
  uint32_t headerBytes;
  uint64_t keyBytes;
  uint64_t payloadBytes;
  uint64_t checksum; // of the header with this field zero, the key, the bytes
};
constexpr char magicText[8] = {'T', 'A', 'I', 'C', 'A', 'C', 'H', 'E'};
constexpr uint32_t formatVersion = 1;
constexpr char suffix[] = ".tai";
constexpr char temporaryPrefix[] = ".tmp-";
constexpr char lockPrefix[] = ".lock-";
/// The journal, a file of the cache folder: the time when the folder was last
/// searched for entries to prune, then a byte for each `journalUnit` bytes
/// stored since. Processes append to it without a lock.
constexpr char journalName[] = ".stored";
constexpr int64_t journalUnit = 4096;
constexpr int64_t journalLife = 24 * 3600; // seconds
/// An upper bound for the size of an entry, above that of any compiled code: a
/// file whose header says more is not an entry.
constexpr uint64_t mostEntryBytes = uint64_t(1) << 31;
/// Temporary files older than this, in seconds, are leftovers of killed
/// processes.
constexpr time_t temporaryLife = 3600;

enum Trouble { FolderTrouble, EntryTrouble, WriteTrouble };

/// A file descriptor that closes itself.
struct Descriptor {
  int number;
  explicit Descriptor(int number) : number(number) {}
  ~Descriptor() {
    if (number >= 0)
      close(number);
  }
  Descriptor(const Descriptor &) = delete;
  Descriptor &operator=(const Descriptor &) = delete;
  explicit operator bool() const { return number >= 0; }
};

uint64_t checksumOf(Header header, std::string_view key,
                    std::string_view bytes) {
  header.checksum = 0;
  uint64_t sum = xxh64(&header, sizeof(header));
  sum = xxh64(key.data(), key.size(), sum);
  return xxh64(bytes.data(), bytes.size(), sum);
}

bool endsWith(std::string_view text, std::string_view end) {
  return text.size() >= end.size() &&
         text.substr(text.size() - end.size()) == end;
}
bool startsWith(std::string_view text, std::string_view start) {
  return text.substr(0, start.size()) == start;
}

bool readAll(int file, char *to, size_t size) {
  while (size) {
    ssize_t got = read(file, to, size);
    if (got < 0 && errno == EINTR)
      continue;
    if (got <= 0)
      return false;
    to += got;
    size -= static_cast<size_t>(got);
  }
  return true;
}

bool writeAll(int file, const char *from, size_t size) {
  while (size) {
    ssize_t put = write(file, from, size);
    if (put < 0 && errno == EINTR)
      continue;
    if (put <= 0)
      return false;
    from += put;
    size -= static_cast<size_t>(put);
  }
  return true;
}

/// Makes the cache folder and the folders above it, for this user alone.
bool makeFolders(const std::string &path) {
  for (size_t at = 1; at != std::string::npos;) {
    at = path.find('/', at);
    std::string part = path.substr(0, at);
    if (mkdir(part.c_str(), 0700) != 0 && errno != EEXIST && errno != EISDIR) {
      // mkdir can also fail for a folder that exists but cannot be written to;
      // only a missing folder is an error.
      int why = errno;
      struct stat info;
      if (stat(part.c_str(), &info) != 0) {
        errno = why;
        return false;
      }
    }
    if (at != std::string::npos)
      ++at;
  }
  return true;
}

/// The first folder on the path in which any user may rename the files of other
/// users, or "". A sticky folder, such as /tmp, does not allow this.
std::string findOpenFolder(const std::string &path) {
  char *real = realpath(path.c_str(), nullptr);
  if (!real)
    return {};
  std::string way = real;
  std::free(real);
  for (size_t at = way.find('/', 1);; at = way.find('/', at + 1)) {
    std::string part = at == std::string::npos ? way : way.substr(0, at);
    struct stat info;
    if (stat(part.c_str(), &info) == 0 && (info.st_mode & S_IWOTH) &&
        !(info.st_mode & S_ISVTX))
      return part;
    if (at == std::string::npos)
      return {};
  }
}

/// Removes a file, or a folder that holds nothing.
bool removeFrom(int folder, const std::string &name) {
  return unlinkat(folder, name.c_str(), 0) == 0 ||
         unlinkat(folder, name.c_str(), AT_REMOVEDIR) == 0;
}

/// Calls body(name) for each file of the folder.
template <typename Body> void forEachFile(int folder, const Body &body) {
  int copy = openat(folder, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (copy < 0)
    return;
  DIR *stream = fdopendir(copy);
  if (!stream) {
    close(copy);
    return;
  }
  while (dirent *entry = readdir(stream))
    body(std::string(entry->d_name));
  closedir(stream);
}
} // namespace

//===----------------------------------------------------------------------===//
// CacheStore
//===----------------------------------------------------------------------===//

CacheStore::CacheStore(std::string folderPath, int64_t mostBytes, Warn warning)
    : path(std::move(folderPath)), maxBytes(mostBytes),
      warn(std::move(warning)) {
  if (path.empty())
    return;
  std::string reason;
  folderDescriptor = openFolder(reason);
  if (folderDescriptor < 0)
    warnOnce(FolderTrouble,
             "the compile cache '" + path + "' is not used: " + reason);
}

CacheStore::~CacheStore() {
  flush();
  if (folderDescriptor >= 0)
    close(folderDescriptor);
}

int CacheStore::openFolder(std::string &reason) const {
  if (!makeFolders(path)) {
    reason = std::strerror(errno);
    return -1;
  }
  // A link of another user is not followed, since its owner could make it point
  // elsewhere at any time.
  struct stat link;
  if (lstat(path.c_str(), &link) == 0 && S_ISLNK(link.st_mode) &&
      link.st_uid != geteuid()) {
    reason = "it is a link that belongs to another user";
    return -1;
  }
  int folder = open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder < 0) {
    reason = std::strerror(errno);
    return -1;
  }
  struct stat info;
  if (fstat(folder, &info) != 0)
    reason = std::strerror(errno);
  else if (info.st_uid != geteuid())
    reason = "it belongs to another user";
  else if (info.st_mode & (S_IWGRP | S_IWOTH))
    reason = "others may write to it, and compiled code is run (chmod 700)";
  else if (faccessat(folder, ".", W_OK | X_OK, AT_EACCESS) != 0)
    reason = std::strerror(errno);
  else if (std::string open = findOpenFolder(path); !open.empty())
    reason = "others may write to '" + open +
             "' above it, and put another folder in its place (chmod o-w)";
  else
    return folder;
  close(folder);
  return -1;
}

void CacheStore::warnOnce(int kind, const std::string &message) {
  if (warned.fetch_or(1u << kind) & 1u << kind)
    return;
  if (warn)
    warn(message);
  else
    std::fprintf(stderr, "tai: warning: %s\n", message.c_str());
}

std::string CacheStore::fileName(std::string_view key) {
  char name[48];
  std::snprintf(
      name, sizeof(name), "%016llx%016llx%s",
      static_cast<unsigned long long>(xxh64(key.data(), key.size(), 0)),
      static_cast<unsigned long long>(xxh64(key.data(), key.size(), 0x746169)),
      suffix);
  return name;
}

/// Reads and checks an entry of the cache; `key` may be null if an entry of any
/// key is wanted.
std::optional<std::string> CacheStore::readEntry(const std::string &name,
                                                 const std::string_view *key,
                                                 bool &broken) const {
  broken = false;
  // A pipe in place of the file would wait for a writer.
  Descriptor file(
      openat(folderDescriptor, name.c_str(),
             O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY));
  if (!file) {
    // Opening an entry fails in this way if the file is a link or a socket.
    broken = errno == ELOOP || errno == ENXIO;
    return std::nullopt;
  }
  broken = true;
  struct stat info;
  if (fstat(file.number, &info) != 0 || !S_ISREG(info.st_mode) ||
      info.st_uid != geteuid() ||
      info.st_size < static_cast<off_t>(sizeof(Header)))
    return std::nullopt;
  Header header;
  if (!readAll(file.number, reinterpret_cast<char *>(&header), sizeof(header)))
    return std::nullopt;
  uint64_t rest = static_cast<uint64_t>(info.st_size) - sizeof(header);
  if (rest > mostEntryBytes ||
      std::memcmp(header.magic, magicText, sizeof(magicText)) != 0 ||
      header.version != formatVersion || header.headerBytes != sizeof(header) ||
      header.keyBytes > rest || header.payloadBytes != rest - header.keyBytes)
    return std::nullopt;
  std::string content(rest, '\0');
  if (!readAll(file.number, content.data(), content.size()))
    return std::nullopt;
  std::string_view storedKey(content.data(), header.keyBytes);
  std::string_view bytes(content.data() + header.keyBytes, header.payloadBytes);
  if (checksumOf(header, storedKey, bytes) != header.checksum ||
      (key ? storedKey != *key : fileName(storedKey) != name))
    return std::nullopt;
  broken = false;
  // The modification time stands for the time of last use, for pruning; a
  // precision of a minute suffices.
  if (info.st_mtime + 60 < time(nullptr))
    (void)futimens(file.number, nullptr);
  return content.substr(header.keyBytes);
}

std::optional<std::string> CacheStore::get(std::string_view key) {
  if (!usable())
    return std::nullopt;
  std::string name = fileName(key);
  bool broken;
  std::optional<std::string> bytes = readEntry(name, &key, broken);
  ++(bytes ? hits : misses);
  corrupt += broken;
  if (broken)
    warnOnce(EntryTrouble, "an entry of the compile cache is damaged and will "
                           "be made again: " +
                               path + "/" + name);
  return bytes;
}

bool CacheStore::put(std::string_view key, std::string_view bytes) {
  if (!usable())
    return false;
  Header header;
  std::memset(&header, 0, sizeof(header));
  std::memcpy(header.magic, magicText, sizeof(magicText));
  header.version = formatVersion;
  header.headerBytes = sizeof(header);
  header.keyBytes = key.size();
  header.payloadBytes = bytes.size();
  header.checksum = checksumOf(header, key, bytes);

  std::string temporary;
  int number = -1;
  for (int attempt = 0; number < 0 && attempt < 16; ++attempt) {
    timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    char name[96];
    std::snprintf(name, sizeof(name), "%s%ld-%lx-%llx", temporaryPrefix,
                  static_cast<long>(getpid()), static_cast<long>(now.tv_nsec),
                  static_cast<unsigned long long>(
                      nextTemporary.fetch_add(1, std::memory_order_relaxed)));
    temporary = name;
    number = openat(folderDescriptor, name,
                    O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0600);
    if (number < 0 && errno != EEXIST)
      break;
  }
  bool good = number >= 0;
  int error = good ? 0 : errno;
  if (good) {
    good =
        writeAll(number, reinterpret_cast<char *>(&header), sizeof(header)) &&
        writeAll(number, key.data(), key.size()) &&
        writeAll(number, bytes.data(), bytes.size()) && fsync(number) == 0;
    error = good ? 0 : errno;
    if (close(number) != 0 && good) {
      good = false;
      error = errno;
    }
    auto rename = [&] {
      return renameat(folderDescriptor, temporary.c_str(), folderDescriptor,
                      fileName(key).c_str()) == 0;
    };
    // If a folder has the name of the entry, this cache has not made it; an
    // empty folder is replaced by the entry.
    if (good && !rename() &&
        (errno != EISDIR || !removeFrom(folderDescriptor, fileName(key)) ||
         !rename())) {
      good = false;
      error = errno;
    }
    if (!good)
      unlinkat(folderDescriptor, temporary.c_str(), 0);
  }
  if (!good) {
    warnOnce(WriteTrouble, "cannot write to the compile cache '" + path +
                               "': " + std::strerror(error));
    return false;
  }
  ++stored;
  // Entries are not counted by looking through the folder, which takes 0.1 s
  // for 60,000 entries.
  if (noteStored(
          static_cast<int64_t>(sizeof(header) + key.size() + bytes.size())))
    prune();
  return true;
}

/// Counts `bytes` in the journal; returns whether the folder should now be
/// searched for entries to prune.
bool CacheStore::noteStored(int64_t bytes) {
  bytesSincePrune += bytes;
  Descriptor file(openat(folderDescriptor, journalName,
                         O_RDWR | O_APPEND | O_CLOEXEC | O_NOFOLLOW |
                             O_NONBLOCK | O_NOCTTY));
  struct stat info;
  int64_t begun = 0;
  bool isGood =
      file && fstat(file.number, &info) == 0 && S_ISREG(info.st_mode) &&
      readAll(file.number, reinterpret_cast<char *>(&begun), sizeof(begun));
  std::string units(
      static_cast<size_t>((bytes + journalUnit - 1) / journalUnit), '\0');
  if (!isGood || !writeAll(file.number, units.data(), units.size()))
    return !prunedOnce || bytesSincePrune > maxBytes / 16;
  int64_t now = time(nullptr);
  int64_t counted = info.st_size - static_cast<int64_t>(sizeof(begun)) +
                    static_cast<int64_t>(units.size());
  return begun > now || begun + journalLife < now ||
         counted * journalUnit > maxBytes / 16;
}

/// Replaces the journal of stored bytes by an empty one.
void CacheStore::beginJournal() {
  removeFrom(folderDescriptor, journalName);
  Descriptor file(openat(folderDescriptor, journalName,
                         O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC,
                         0600));
  int64_t now = time(nullptr);
  if (file)
    (void)writeAll(file.number, reinterpret_cast<char *>(&now), sizeof(now));
}

//===----------------------------------------------------------------------===//
// Claims
//===----------------------------------------------------------------------===//

namespace {
/// A locked file, which is removed before the lock is released. The lock
/// belongs to the open file, so that it ends with the process.
class LockedFile {
public:
  LockedFile(int folder, std::string name, int file)
      : folder(folder), name(std::move(name)), file(file) {}
  ~LockedFile() {
    unlinkat(folder, name.c_str(), 0);
    // Unlock explicitly: a child that was forked meanwhile also has the file
    // open, which would keep the lock after close().
    flock(file, LOCK_UN);
    close(file);
    close(folder);
  }
  LockedFile(const LockedFile &) = delete;
  LockedFile &operator=(const LockedFile &) = delete;

private:
  int folder;
  std::string name;
  int file;
};
} // namespace

CacheStore::Claim CacheStore::claim(std::string_view key, double mostSeconds,
                                    const std::function<bool()> &goesOn) {
  if (!usable())
    return nullptr;
  using Clock = std::chrono::steady_clock;
  auto end = Clock::now() + std::chrono::duration<double>(mostSeconds);
  std::string name = lockPrefix + fileName(key);
  // The first pause is short, as another process makes most code in a few
  // milliseconds.
  auto pause = std::chrono::microseconds(500);
  while (true) {
    Descriptor file(openat(folderDescriptor, name.c_str(),
                           O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC |
                               O_NONBLOCK | O_NOCTTY,
                           0600));
    struct stat info;
    if (!file || fstat(file.number, &info) != 0)
      return nullptr;
    if (!S_ISREG(info.st_mode)) {
      removeFrom(folderDescriptor, name);
      return nullptr;
    }
    bool isLocked = false;
    while (true) {
      isLocked = flock(file.number, LOCK_EX | LOCK_NB) == 0;
      if (isLocked || (errno != EWOULDBLOCK && errno != EINTR))
        break;
      if (Clock::now() >= end || (goesOn && !goesOn()))
        return nullptr;
      std::this_thread::sleep_for(pause);
      pause = std::min(pause * 2, std::chrono::microseconds(20000));
    }
    if (!isLocked || fstat(file.number, &info) != 0)
      return nullptr;
    // The former owner has unlinked the file that is now locked, and other
    // processes will lock a new file of that name: try again.
    if (info.st_nlink == 0) {
      if (Clock::now() >= end)
        return nullptr;
      continue;
    }
    int folder = fcntl(folderDescriptor, F_DUPFD_CLOEXEC, 0);
    if (folder < 0)
      return nullptr;
    return std::make_shared<LockedFile>(folder, std::move(name),
                                        std::exchange(file.number, -1));
  }
}

/// The entries that putLater has still to write, and the thread that writes
/// them, if one runs.
struct CacheStore::Writer {
  CacheStore *store;
  pid_t process = getpid();
  std::mutex mutex;
  std::deque<std::pair<std::string, std::string>> queue;
  bool running = false;
  bool toBeJoined = false;
  pthread_t thread = {};

  explicit Writer(CacheStore *store) : store(store) {}

  static void *run(void *argument) {
    Writer &writer = *static_cast<Writer *>(argument);
    while (true) {
      std::pair<std::string, std::string> next;
      {
        std::lock_guard<std::mutex> lock(writer.mutex);
        writer.running = !writer.queue.empty();
        if (!writer.running)
          return nullptr;
        next = std::move(writer.queue.front());
        writer.queue.pop_front();
      }
      writer.store->put(next.first, next.second);
    }
  }

  void join() {
    if (toBeJoined)
      pthread_join(thread, nullptr);
    toBeJoined = false;
  }
};

CacheStore::Writer &CacheStore::currentWriter() {
  // A forked child does not have the writer's thread, and the parent writes the
  // entries that it has queued, so the child drops its copy of both.
  if (writer && writer->process != getpid())
    (void)writer.release();
  if (!writer)
    writer = std::make_unique<Writer>(this);
  return *writer;
}

void CacheStore::putLater(std::string key, std::string bytes) {
  if (!usable())
    return;
  std::lock_guard<std::mutex> callers(writerMutex);
  Writer &current = currentWriter();
  {
    std::lock_guard<std::mutex> lock(current.mutex);
    current.queue.emplace_back(std::move(key), std::move(bytes));
    if (current.running)
      return;
    current.running = true;
  }
  current.join();
  // The new thread blocks all signals, which the threads of the program handle.
  sigset_t all, old;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &old);
  current.toBeJoined =
      pthread_create(&current.thread, nullptr, &Writer::run, &current) == 0;
  pthread_sigmask(SIG_SETMASK, &old, nullptr);
  if (!current.toBeJoined)
    Writer::run(&current);
}

void CacheStore::flush() {
  std::lock_guard<std::mutex> callers(writerMutex);
  if (writer)
    currentWriter().join();
}

void CacheStore::prune() {
  if (!usable())
    return;
  prunedOnce = true;
  bytesSincePrune = 0;
  beginJournal();
  struct Entry {
    std::string name;
    timespec used;
    int64_t bytes;
  };
  std::vector<Entry> entries;
  int64_t total = 0;
  time_t now = time(nullptr);
  forEachFile(folderDescriptor, [&](const std::string &name) {
    bool temporary =
        startsWith(name, temporaryPrefix) || startsWith(name, lockPrefix);
    if (!temporary && !endsWith(name, suffix))
      return;
    struct stat info;
    if (fstatat(folderDescriptor, name.c_str(), &info, AT_SYMLINK_NOFOLLOW) !=
        0)
      return;
    if (temporary) {
      if (info.st_mtime + temporaryLife < now)
        unlinkat(folderDescriptor, name.c_str(), 0);
      return;
    }
    entries.push_back({name, info.st_mtim, info.st_size});
    total += info.st_size;
  });
  if (total <= maxBytes)
    return;
  std::sort(entries.begin(), entries.end(), [](const Entry &a, const Entry &b) {
    return a.used.tv_sec != b.used.tv_sec ? a.used.tv_sec < b.used.tv_sec
                                          : a.used.tv_nsec < b.used.tv_nsec;
  });
  int64_t removed = 0;
  // The cache is pruned to 7/8 of its limit, so that storing the next entry
  // does not prune again.
  for (const Entry &entry : entries) {
    if (total <= maxBytes - maxBytes / 8)
      break;
    if (removeFrom(folderDescriptor, entry.name))
      ++removed;
    total -= entry.bytes;
  }
  pruned += removed;
}

void CacheStore::clean() {
  if (!usable())
    return;
  forEachFile(folderDescriptor, [&](const std::string &name) {
    if (startsWith(name, temporaryPrefix) || startsWith(name, lockPrefix) ||
        endsWith(name, suffix) || name == journalName)
      removeFrom(folderDescriptor, name);
  });
}

int64_t CacheStore::verify() {
  int64_t good = 0;
  if (!usable())
    return good;
  forEachFile(folderDescriptor, [&](const std::string &name) {
    if (!endsWith(name, suffix) || startsWith(name, temporaryPrefix) ||
        startsWith(name, lockPrefix))
      return;
    bool broken;
    if (readEntry(name, nullptr, broken))
      ++good;
    else if (broken)
      removeFrom(folderDescriptor, name);
  });
  return good;
}

CacheStats CacheStore::stats() const {
  return {hits, misses, corrupt, stored, pruned};
}

CacheStore::Size CacheStore::size() const {
  Size result;
  if (!usable())
    return result;
  forEachFile(folderDescriptor, [&](const std::string &name) {
    struct stat info;
    if (endsWith(name, suffix) && !startsWith(name, lockPrefix) &&
        fstatat(folderDescriptor, name.c_str(), &info, AT_SYMLINK_NOFOLLOW) ==
            0) {
      ++result.entries;
      result.bytes += info.st_size;
    }
  });
  return result;
}
