//===- OutputFile.cpp - Files that tools write ----------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "OutputFile.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/Process.h"
#include "llvm/Support/Signals.h"
#include "llvm/Support/raw_ostream.h"
#include <cstdlib>
#include <string>

using namespace mlir;
namespace fs = llvm::sys::fs;

/// The name of the temporary file while the file exists. A global variable,
/// because drivers call `exit` on wrong options and on a full disk.
static std::string &getTemporary() {
  static std::string name;
  return name;
}

static void removeTemporary() {
  std::string &name = getTemporary();
  if (name.empty())
    return;
  fs::remove(name);
  llvm::sys::DontRemoveFileOnSignal(name);
  name.clear();
}

/// The range of arguments that name the output, and the name; empty without -o.
static std::pair<int, int> findOutput(int argc, char **argv, StringRef &name) {
  for (int i = 1; i < argc; ++i) {
    StringRef word(argv[i]);
    if (word == "--")
      break;
    if (!word.consume_front("-"))
      continue;
    word.consume_front("-");
    if (word == "o" && i + 1 < argc) {
      name = argv[i + 1];
      return {i, i + 2};
    }
    if (word.consume_front("o=")) {
      name = word;
      return {i, i + 1};
    }
  }
  return {0, 0};
}

/// Makes the temporary file for `name`. Returns the file that it replaces, or
/// "" if `name` is written to directly: for a device, or in a folder where no
/// other file can be made.
static std::string makeTemporary(StringRef name) {
  SmallString<128> target(name);
  bool exists = fs::exists(name);
  if (exists && (!fs::is_regular_file(name) || fs::real_path(name, target)))
    return {};
  int descriptor;
  SmallString<128> made;
  if (fs::createUniqueFile(target + ".%%%%%%%%.tmp", descriptor, made))
    return {};
  llvm::sys::Process::SafelyCloseFileDescriptor(descriptor);
  if (exists)
    if (llvm::ErrorOr<fs::perms> permissions = fs::getPermissions(target))
      fs::setPermissions(made, *permissions);
  getTemporary() = made.str().str();
  std::atexit(removeTemporary);
  llvm::sys::RemoveFileOnSignal(made);
  return target.str().str();
}

int tai::runWithOutput(int argc, char **argv,
                       llvm::function_ref<LogicalResult(int, char **)> driver) {
  StringRef name;
  auto [begin, end] = findOutput(argc, argv, name);
  std::string target;
  if (!name.empty() && name != "-")
    target = makeTemporary(name);
  if (target.empty())
    return failed(driver(argc, argv));

  std::string output = "-o=" + getTemporary();
  SmallVector<char *> words(argv, argv + begin);
  words.push_back(output.data());
  words.append(argv + end, argv + argc);
  words.push_back(nullptr);
  int status = failed(driver(words.size() - 1, words.data()));
  if (status == 0) {
    if (std::error_code error = fs::rename(getTemporary(), target)) {
      llvm::errs() << name << ": error: cannot be written: " << error.message()
                   << "\n";
      status = 1;
    }
  }
  removeTemporary();
  return status;
}
