//===- CacheStoreTest.cpp - The store of compiled code --------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Cache/CacheStore.h"
#include "tai/Support/XXHash.h"
#include "gtest/gtest.h"
#include <cstdlib>
#include <cstring>
#include <dirent.h>
#include <fcntl.h>
#include <fstream>
#include <signal.h>
#include <sstream>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

using namespace mlir::tai::runtime;

namespace {
/// Provides a folder for each test, and collects the warnings.
class RuntimeCache : public ::testing::Test {
protected:
  void SetUp() override {
    const char *base = std::getenv("TMPDIR");
    root = std::string(base && *base ? base : "/tmp") + "/tai-cache-XXXXXX";
    ASSERT_NE(mkdtemp(root.data()), nullptr);
    folder = root + "/cache";
  }
  void TearDown() override {
    for (const std::string &path : {folder, root + "/a/b", root + "/a"}) {
      chmod(path.c_str(), 0700);
      unlink((path + "/.stored").c_str());
      for (const std::string &name : files(path))
        unlink((path + "/" + name).c_str());
      rmdir(path.c_str());
      unlink(path.c_str());
    }
    rmdir(root.c_str());
  }
  /// All files but the journal.
  static std::vector<std::string> files(const std::string &path) {
    std::vector<std::string> names;
    if (DIR *stream = opendir(path.c_str())) {
      while (dirent *entry = readdir(stream))
        if ((entry->d_name[0] != '.' || std::strlen(entry->d_name) > 2) &&
            std::strcmp(entry->d_name, ".stored") != 0)
          names.push_back(entry->d_name);
      closedir(stream);
    }
    return names;
  }
  CacheStore::Warn collect() {
    return [this](const std::string &text) { warnings.push_back(text); };
  }
  std::string fileOf(std::string_view key) {
    return folder + "/" + CacheStore::fileName(key);
  }
  static std::string slurp(const std::string &path) {
    std::ifstream file(path, std::ios::binary);
    std::stringstream text;
    text << file.rdbuf();
    return text.str();
  }
  static void spill(const std::string &path, const std::string &text) {
    std::ofstream(path, std::ios::binary | std::ios::trunc) << text;
  }

  std::string root, folder;
  std::vector<std::string> warnings;
};
} // namespace

// The values are from the reference implementation.
TEST(RuntimeHash, KnownAnswers) {
  EXPECT_EQ(xxh64("", 0), 0xEF46DB3751D8E999u);
  EXPECT_EQ(xxh64("a", 1), 0xD24EC4F1A98C6E5Bu);
  EXPECT_EQ(xxh64("abc", 3), 0x44BC2CF5AD770999u);
  std::string text = "Nobody inspects the spammish repetition";
  EXPECT_EQ(xxh64(text.data(), text.size()), 0xFBCEA83C8A378BF1u);
}

TEST_F(RuntimeCache, GivesBackWhatWasStored) {
  CacheStore store(folder, 1 << 30, collect());
  ASSERT_TRUE(store.usable());
  struct stat info;
  ASSERT_EQ(stat(folder.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0700u);
  EXPECT_FALSE(store.get("key"));
  std::string bytes("some\0bytes", 10), large(1000000, 'x');
  EXPECT_TRUE(store.put("key", bytes));
  EXPECT_TRUE(store.put("", large));
  EXPECT_TRUE(store.put("empty", ""));
  EXPECT_EQ(store.get("key"), bytes);
  EXPECT_EQ(store.get(""), large);
  EXPECT_EQ(store.get("empty"), "");
  EXPECT_TRUE(store.put("key", "newer"));
  // Another process would see the same entries.
  CacheStore other(folder);
  EXPECT_EQ(other.get("key"), "newer");
  EXPECT_EQ(store.size().entries, 3);
  EXPECT_EQ(store.verify(), 3);
  EXPECT_EQ(store.stats().hits, 3);
  EXPECT_EQ(store.stats().misses, 1);
  EXPECT_EQ(store.stats().stored, 4);
  EXPECT_TRUE(warnings.empty());
  store.clean();
  EXPECT_EQ(store.size().entries, 0);
  EXPECT_TRUE(files(folder).empty());
}

TEST_F(RuntimeCache, StoresInTheBackground) {
  {
    CacheStore store(folder, 1 << 30, collect());
    for (int i = 0; i < 20; ++i)
      store.putLater("k" + std::to_string(i), std::string(1000, char('a' + i)));
    store.flush();
    for (int i = 0; i < 20; ++i)
      EXPECT_EQ(store.get("k" + std::to_string(i)),
                std::string(1000, char('a' + i)));
    store.putLater("last", "v"); // the destructor waits
    pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      alarm(200);
      store.flush();
      store.putLater("child", "w");
      store.flush();
      _exit(store.get("child") == "w" ? 0 : 1);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
  CacheStore store(folder);
  EXPECT_EQ(store.get("last"), "v");
  EXPECT_EQ(store.size().entries, 22);
  EXPECT_TRUE(warnings.empty());
  CacheStore none("");
  none.putLater("k", "v");
  none.flush();
}

TEST_F(RuntimeCache, MakesFoldersAbove) {
  CacheStore store(root + "/a/b", 1 << 30, collect());
  EXPECT_TRUE(store.usable());
  EXPECT_TRUE(store.put("k", "v"));
}

TEST_F(RuntimeCache, NoFolderIsNoCache) {
  CacheStore store("", 1 << 30, collect());
  EXPECT_FALSE(store.usable());
  EXPECT_FALSE(store.get("k"));
  EXPECT_FALSE(store.put("k", "v"));
  store.prune();
  store.clean();
  EXPECT_EQ(store.verify(), 0);
  EXPECT_TRUE(warnings.empty());
}

// Damages an entry in every way, at every byte: the entry is never used, one
// warning is issued in all, and the entry can be stored again.
TEST_F(RuntimeCache, DetectsEveryDamage) {
  CacheStore store(folder, 1 << 30, collect());
  ASSERT_TRUE(store.put("the key", "the compiled code of a kernel"));
  ASSERT_TRUE(store.put("other", "the compiled code of a kernel"));
  std::string good = slurp(fileOf("the key"));
  ASSERT_GT(good.size(), 36u);
  int64_t damaged = 0;
  auto expectMiss = [&](const std::string &content) {
    spill(fileOf("the key"), content);
    ASSERT_FALSE(store.get("the key"));
    ASSERT_EQ(store.stats().corrupt, ++damaged);
  };
  for (size_t at = 0; at < good.size(); ++at) {
    expectMiss(good.substr(0, at));
    for (int bit = 0; bit < 8; ++bit) {
      std::string flipped = good;
      flipped[at] = char(flipped[at] ^ 1 << bit);
      expectMiss(flipped);
    }
  }
  expectMiss(good + '\0');
  expectMiss(std::string(good.size(), '\0'));
  expectMiss(slurp(fileOf("other"))); // swapped
  EXPECT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(store.put("the key", "again"));
  EXPECT_EQ(store.get("the key"), "again");
  // verify() removes the broken entry and keeps the intact one.
  spill(fileOf("other"), good);
  EXPECT_EQ(store.verify(), 1);
  EXPECT_EQ(store.size().entries, 1);
}

TEST_F(RuntimeCache, FollowsNoLinkInTheFolder) {
  CacheStore store(folder, 1 << 30, collect());
  ASSERT_TRUE(store.put("k", "v"));
  ASSERT_EQ(rename(fileOf("k").c_str(), (folder + "/elsewhere").c_str()), 0);
  ASSERT_EQ(symlink("elsewhere", fileOf("k").c_str()), 0);
  EXPECT_FALSE(store.get("k"));
  EXPECT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(store.put("k", "w"));
  EXPECT_EQ(store.get("k"), "w");
}

// Whatever file has the name of an entry, no reader waits for it, and a new
// entry replaces it.
TEST_F(RuntimeCache, WaitsForNothingInTheFolder) {
  CacheStore store(folder, 1 << 30, collect());
  auto expectReplaced = [&](const char *what) {
    ASSERT_FALSE(store.get("k")) << what;
    EXPECT_EQ(store.verify(), 0) << what;
    ASSERT_TRUE(store.put("k", what));
    EXPECT_EQ(store.get("k"), what);
    unlink(fileOf("k").c_str());
  };
  // Ends the test if something does wait.
  alarm(100);
  ASSERT_EQ(mkfifo(fileOf("k").c_str(), 0600), 0);
  ASSERT_FALSE(store.get("k"));
  ASSERT_TRUE(store.put("k", "over a pipe"));
  EXPECT_EQ(store.get("k"), "over a pipe");
  unlink(fileOf("k").c_str());
  ASSERT_EQ(mkfifo(fileOf("k").c_str(), 0600), 0);
  expectReplaced("pipe");
  ASSERT_EQ(mkdir(fileOf("k").c_str(), 0700), 0);
  ASSERT_FALSE(store.get("k"));
  ASSERT_TRUE(store.put("k", "over a folder"));
  EXPECT_EQ(store.get("k"), "over a folder");
  unlink(fileOf("k").c_str());
  ASSERT_EQ(mkdir(fileOf("k").c_str(), 0700), 0);
  expectReplaced("folder");
  int server = socket(AF_UNIX, SOCK_STREAM, 0);
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  ASSERT_LT(fileOf("k").size(), sizeof(address.sun_path));
  std::strcpy(address.sun_path, fileOf("k").c_str());
  ASSERT_EQ(
      bind(server, reinterpret_cast<sockaddr *>(&address), sizeof(address)), 0);
  expectReplaced("socket");
  close(server);
  // A FIFO in place of the lock file is replaced, too.
  std::string lock = folder + "/.lock-" + CacheStore::fileName("k");
  ASSERT_EQ(mkfifo(lock.c_str(), 0600), 0);
  (void)store.claim("k");
  EXPECT_TRUE(store.claim("k"));
  alarm(0);
  EXPECT_EQ(warnings.size(), 1u);
  EXPECT_TRUE(files(folder).empty());
}

// A file whose header claims more bytes than there is memory.
TEST_F(RuntimeCache, BelievesNoSize) {
  CacheStore store(folder, 1 << 30, collect());
  ASSERT_TRUE(store.put("k", "v"));
  std::string entry = slurp(fileOf("k"));
  uint64_t keyBytes = 1, size = uint64_t(1) << 40;
  uint64_t payload = size - 40 - keyBytes;
  entry.replace(24, sizeof(payload), reinterpret_cast<char *>(&payload),
                sizeof(payload));
  spill(fileOf("k"), entry);
  if (truncate(fileOf("k").c_str(), static_cast<off_t>(size)) != 0)
    GTEST_SKIP() << "the file system has no files with holes of this size";
  EXPECT_FALSE(store.get("k"));
  EXPECT_EQ(warnings.size(), 1u);
}

// A user who may rename a folder above can replace the cache by another folder.
TEST_F(RuntimeCache, RefusesFoldersBelowOpenOnes) {
  mkdir((root + "/a").c_str(), 0700);
  chmod((root + "/a").c_str(), 0777);
  {
    CacheStore store(root + "/a/b", 1 << 30, collect());
    EXPECT_FALSE(store.usable());
    ASSERT_EQ(warnings.size(), 1u);
    EXPECT_NE(warnings[0].find("others may write to '"), std::string::npos);
    EXPECT_NE(warnings[0].find("/a' above it"), std::string::npos)
        << warnings[0];
  }
  // In a sticky folder, users can rename only their own entries.
  chmod((root + "/a").c_str(), 01777);
  CacheStore store(root + "/a/b", 1 << 30, collect());
  EXPECT_TRUE(store.usable());
  EXPECT_EQ(warnings.size(), 1u);
}

TEST_F(RuntimeCache, RefusesFoldersThatOthersMayWrite) {
  for (mode_t mode : {0777, 0770, 0702}) {
    mkdir(folder.c_str(), 0700);
    chmod(folder.c_str(), mode);
    warnings.clear();
    CacheStore store(folder, 1 << 30, collect());
    EXPECT_FALSE(store.usable());
    EXPECT_FALSE(store.put("k", "v"));
    EXPECT_FALSE(store.get("k"));
    ASSERT_EQ(warnings.size(), 1u);
    EXPECT_NE(warnings[0].find("others may write to it"), std::string::npos)
        << warnings[0];
  }
}

TEST_F(RuntimeCache, RefusesFoldersOfOthers) {
  if (geteuid() != 0)
    GTEST_SKIP() << "only root can give a folder away";
  mkdir(folder.c_str(), 0700);
  ASSERT_EQ(chown(folder.c_str(), 12345, 12345), 0);
  CacheStore store(folder, 1 << 30, collect());
  EXPECT_FALSE(store.usable());
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("it belongs to another user"), std::string::npos);
  ASSERT_EQ(chown(folder.c_str(), 0, 0), 0);
}

TEST_F(RuntimeCache, DoesWithoutAFolder) {
  {
    CacheStore store("/proc/tai-no-such/cache", 1 << 30, collect());
    EXPECT_FALSE(store.usable());
    EXPECT_FALSE(store.put("k", "v"));
  }
  EXPECT_EQ(warnings.size(), 1u);
  // A file is where the folder should be.
  spill(folder, "file");
  CacheStore store(folder, 1 << 30, collect());
  EXPECT_FALSE(store.usable());
  EXPECT_EQ(warnings.size(), 2u);
}

TEST_F(RuntimeCache, SurvivesAFullDisk) {
  CacheStore store(folder, 1 << 30, collect());
  ASSERT_TRUE(store.put("small", "v"));
  // In a child, since a limit on file sizes affects the whole process.
  pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    signal(SIGXFSZ, SIG_IGN);
    rlimit limit = {10000, 10000};
    setrlimit(RLIMIT_FSIZE, &limit);
    bool good = !store.put("large", std::string(100000, 'x')) &&
                !store.put("larger", std::string(200000, 'x')) &&
                warnings.size() == 1 && store.get("small") == "v" &&
                !store.get("large") && store.put("small2", "w");
    _exit(good ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  EXPECT_EQ(files(folder).size(), 2u) << "nothing half-written is left";
}

TEST_F(RuntimeCache, SurvivesItsFolder) {
  CacheStore store(folder, 1 << 30, collect());
  ASSERT_TRUE(store.put("k", "v"));
  unlink(fileOf("k").c_str());
  unlink((folder + "/.stored").c_str());
  ASSERT_EQ(rmdir(folder.c_str()), 0);
  EXPECT_FALSE(store.get("k"));
  EXPECT_FALSE(store.put("k", "v"));
  EXPECT_EQ(warnings.size(), 1u);
}

TEST_F(RuntimeCache, PrunesWhatWasUsedLongAgo) {
  CacheStore store(folder, 100000, collect());
  std::string bytes(20000, 'x');
  auto age = [&](std::string_view key, time_t seconds) {
    timespec times[2] = {{time(nullptr) - seconds, 0},
                         {time(nullptr) - seconds, 0}};
    ASSERT_EQ(utimensat(AT_FDCWD, fileOf(key).c_str(), times, 0), 0);
  };
  for (const char *key : {"a", "b", "c", "d"}) {
    ASSERT_TRUE(store.put(key, bytes));
    age(key, key[0] == 'b' ? 5000 : 1000);
  }
  age("a", 9000);
  EXPECT_EQ(store.get("a"), bytes); // used again: the youngest now
  ASSERT_TRUE(store.put("e", bytes));
  store.prune();
  EXPECT_LE(store.size().bytes, 100000);
  EXPECT_TRUE(store.get("a"));
  EXPECT_FALSE(store.get("b"));
  EXPECT_TRUE(store.get("e"));
  EXPECT_GE(store.stats().pruned, 1);
  // Files that a killed process left are deleted after a while.
  spill(folder + "/.tmp-1-2-3", "half");
  store.prune();
  EXPECT_EQ(access((folder + "/.tmp-1-2-3").c_str(), F_OK), 0);
  timespec old[2] = {{time(nullptr) - 7200, 0}, {time(nullptr) - 7200, 0}};
  utimensat(AT_FDCWD, (folder + "/.tmp-1-2-3").c_str(), old, 0);
  store.prune();
  EXPECT_NE(access((folder + "/.tmp-1-2-3").c_str(), F_OK), 0);
}

// A new session does not scan the folder again; all sessions together keep the
// limit.
TEST_F(RuntimeCache, LooksThroughTheFolderNowAndThen) {
  std::string journal = folder + "/.stored", bytes(20000, 'x');
  auto exists = [&](const std::string &path) {
    return access(path.c_str(), F_OK) == 0;
  };
  auto store = [&](const std::string &key, int64_t most) {
    CacheStore one(folder, most, collect());
    ASSERT_TRUE(one.put(key, bytes));
  };
  auto leave = [&](const std::string &name) {
    std::string path = folder + "/" + name;
    spill(path, "half");
    timespec old[2] = {{time(nullptr) - 7200, 0}, {time(nullptr) - 7200, 0}};
    utimensat(AT_FDCWD, path.c_str(), old, 0);
    return path;
  };
  store("first", 1 << 30);
  ASSERT_TRUE(exists(journal));
  std::string left = leave(".tmp-1-2-3");
  store("second", 1 << 30);
  EXPECT_TRUE(exists(left)) << "the folder was looked through again";
  // A day later, the folder is scanned again.
  int64_t begun = time(nullptr) - 2 * 24 * 3600;
  spill(journal, std::string(reinterpret_cast<char *>(&begun), sizeof begun));
  store("third", 1 << 30);
  EXPECT_FALSE(exists(left));
  // Unreadable journals have no effect.
  for (const char *text : {"", "abc"}) {
    left = leave(".tmp-1-2-3");
    spill(journal, text);
    store("fourth", 1 << 30);
    EXPECT_FALSE(exists(left));
  }
  left = leave(".tmp-1-2-3");
  unlink(journal.c_str());
  ASSERT_EQ(mkfifo(journal.c_str(), 0600), 0);
  store("fifth", 1 << 30);
  EXPECT_FALSE(exists(left));
  store("sixth", 1 << 30);
  // Each of 100 sessions stores a fifth of the limit.
  for (int i = 0; i < 100; ++i)
    store("k" + std::to_string(i), 100000);
  EXPECT_LE(CacheStore(folder).size().bytes, 100000 + 100000 / 16 + 20100);
  EXPECT_TRUE(warnings.empty());
}

// Several processes need the same entries at once: only one process creates
// each entry.
TEST_F(RuntimeCache, OneProcessMakesAnEntry) {
  constexpr int keys = 6;
  std::string log = root + "/log";
  spill(log, "");
  auto work = [&] {
    CacheStore store(folder, 1 << 30, [](const std::string &) {});
    for (int k = 0; k < keys; ++k) {
      std::string key = "key" + std::to_string(k);
      if (store.get(key))
        continue;
      CacheStore::Claim claim = store.claim(key, /*mostSeconds=*/1e6);
      if (!claim)
        return 1;
      if (store.get(key))
        continue;
      int file = open(log.c_str(), O_WRONLY | O_APPEND);
      if (write(file, "made\n", 5) != 5 || !store.put(key, "code"))
        return 2;
      close(file);
    }
    return 0;
  };
  std::vector<pid_t> children;
  for (int i = 0; i < 8; ++i) {
    pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0)
      _exit(work());
    children.push_back(child);
  }
  for (pid_t child : children) {
    int status = 0;
    waitpid(child, &status, 0);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
  EXPECT_EQ(slurp(log).size(), 5u * keys);
  unlink(log.c_str());
  // No lock files are left.
  EXPECT_EQ(files(folder).size(), size_t(keys));
}

// When the owner of a claim is killed, the next process gets the claim at once,
// and waiting processes stop waiting.
TEST_F(RuntimeCache, ClaimsEndWithTheirOwners) {
  CacheStore store(folder, 1 << 30, collect());
  int ready[2];
  ASSERT_EQ(pipe(ready), 0);
  pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    CacheStore mine(folder);
    CacheStore::Claim claim = mine.claim("k");
    char byte = claim ? 'y' : 'n';
    (void)!write(ready[1], &byte, 1);
    for (;;)
      pause();
  }
  char byte = 0;
  ASSERT_EQ(read(ready[0], &byte, 1), 1);
  ASSERT_EQ(byte, 'y');
  // While another process holds the claim, processes continue without it.
  EXPECT_FALSE(store.claim("k", /*mostSeconds=*/0.01));
  EXPECT_TRUE(store.claim("another", /*mostSeconds=*/0));
  kill(child, SIGKILL);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_TRUE(store.claim("k", /*mostSeconds=*/0));
  close(ready[0]);
  close(ready[1]);
  EXPECT_TRUE(files(folder).empty());
  EXPECT_TRUE(warnings.empty());
}

// A claim stops waiting when it is asked to, even if it would wait for days.
TEST_F(RuntimeCache, ClaimsAreWaitedForAsLongAsIsWanted) {
  CacheStore store(folder, 1 << 30, collect());
  CacheStore::Claim claim = store.claim("k");
  ASSERT_TRUE(claim);
  int asked = 0;
  EXPECT_FALSE(
      store.claim("k", /*mostSeconds=*/1e6, [&] { return ++asked < 3; }));
  EXPECT_EQ(asked, 3);
}

// A child that is forked meanwhile does not keep a claim that its parent
// releases.
TEST_F(RuntimeCache, ClaimsAreNotInherited) {
  CacheStore store(folder, 1 << 30, collect());
  CacheStore::Claim claim = store.claim("k");
  ASSERT_TRUE(claim);
  EXPECT_FALSE(store.claim("k", /*mostSeconds=*/0));
  pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0)
    for (;;)
      pause();
  claim.reset();
  EXPECT_TRUE(store.claim("k", /*mostSeconds=*/0));
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
}

// Processes write and read the same keys, and some are killed meanwhile: every
// read returns the complete contents of one write.
TEST_F(RuntimeCache, ConcurrentProcesses) {
  auto contentOf = [](int key, int writer) {
    return std::to_string(key) + ":" +
           std::string(size_t(2000 + 371 * writer), char('a' + writer));
  };
  auto work = [&](int writer, int rounds) {
    CacheStore store(folder, 1 << 30, [](const std::string &) {});
    if (!store.usable())
      return 2;
    for (int round = 0; round < rounds; ++round)
      for (int key = 0; key < 5; ++key) {
        std::string name = "key" + std::to_string(key);
        if (auto bytes = store.get(name)) {
          bool known = false;
          for (int other = 0; other < 8; ++other)
            known |= *bytes == contentOf(key, other);
          if (!known)
            return 3;
        }
        if (store.stats().corrupt)
          return 4;
        if (!store.put(name, contentOf(key, writer)))
          return 5;
      }
    return 0;
  };
  std::vector<pid_t> children;
  for (int writer = 0; writer < 8; ++writer) {
    pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0)
      _exit(work(writer, writer < 4 ? 1000000 : 20));
    children.push_back(child);
  }
  for (int writer = 4; writer < 8; ++writer) {
    int status = 0;
    waitpid(children[writer], &status, 0);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0)
        << (WIFEXITED(status) ? WEXITSTATUS(status) : -1);
  }
  for (int writer = 0; writer < 4; ++writer) {
    kill(children[writer], SIGKILL);
    int status = 0;
    waitpid(children[writer], &status, 0);
    EXPECT_TRUE(WIFSIGNALED(status)) << "ended early: a broken read";
  }
  CacheStore store(folder, 1 << 30, collect());
  EXPECT_EQ(store.verify(), 5);
  EXPECT_EQ(store.stats().corrupt, 0);
}
