//===- OutputFilter.cpp - Messages beside those of the server -------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "OutputFilter.h"
#include "mlir/Support/LLVM.h"
#include "llvm/ADT/STLFunctionalExtras.h"
#include "llvm/Support/FormatVariadic.h"
#include "llvm/Support/raw_ostream.h"
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <thread>
#include <unistd.h>

using namespace mlir;
using namespace mlir::tai;

namespace {
struct Output {
  std::mutex mutex;
  std::FILE *file = stdout;
  bool isPretty = false;
  std::thread thread;
  /// The number of requests that the server has not answered.
  int pending = 0;
  bool hasEnded = false;
  std::condition_variable answered;

  void write(StringRef message) {
    std::lock_guard<std::mutex> lock(mutex);
    std::fprintf(file, "Content-Length: %zu\r\n\r\n", message.size());
    std::fwrite(message.data(), 1, message.size(), file);
    std::fflush(file);
  }
  std::string print(const llvm::json::Value &value) const {
    return isPretty ? llvm::formatv("{0:2}\n", value).str()
                    : llvm::formatv("{0}", value).str();
  }
};
} // namespace

/// Never destroyed: the thread may run until the program ends.
static Output &getOutput() {
  static auto *output = new Output;
  return *output;
}

/// Adds to the capabilities of the server that `@` begins a symbol, which this
/// program completes.
static std::string addTrigger(StringRef message) {
  if (!message.contains("\"triggerCharacters\""))
    return message.str();
  llvm::Expected<llvm::json::Value> value = llvm::json::parse(message);
  if (!value) {
    llvm::consumeError(value.takeError());
    return message.str();
  }
  llvm::json::Object *object = value->getAsObject();
  for (StringRef key : {"result", "capabilities", "completionProvider"})
    object = object ? object->getObject(key) : nullptr;
  if (!object)
    return message.str();
  if (llvm::json::Array *triggers = object->getArray("triggerCharacters"))
    triggers->push_back("@");
  return getOutput().print(*value);
}

/// True for the answer to a request.
static bool isAnswer(StringRef message) {
  llvm::Expected<llvm::json::Value> value = llvm::json::parse(message);
  if (!value) {
    llvm::consumeError(value.takeError());
    return false;
  }
  llvm::json::Object *object = value->getAsObject();
  return object && object->get("id") && !object->get("method");
}

static void setPending(llvm::function_ref<void(Output &)> change) {
  Output &output = getOutput();
  {
    std::lock_guard<std::mutex> lock(output.mutex);
    change(output);
  }
  output.answered.notify_all();
}

static void passMessages(int from) {
  std::FILE *input = ::fdopen(from, "r");
  size_t size = 0;
  char line[256];
  while (std::fgets(line, sizeof line, input)) {
    StringRef header = StringRef(line).trim();
    if (header.consume_front("Content-Length:")) {
      if (header.trim().getAsInteger(10, size))
        size = 0;
      continue;
    }
    if (!header.empty() || size == 0)
      continue;
    std::string message(size, '\0');
    if (std::fread(message.data(), 1, size, input) != size)
      break;
    size = 0;
    getOutput().write(addTrigger(message));
    if (isAnswer(message))
      setPending([](Output &output) { --output.pending; });
  }
  std::fclose(input);
  setPending([](Output &output) { output.hasEnded = true; });
}

void tai::filterStandardOutput(bool isPretty) {
  Output &output = getOutput();
  output.isPretty = isPretty;
  int ends[2];
  int given = ::dup(::fileno(stdout));
  if (given < 0 || ::pipe(ends) != 0)
    return;
  ::dup2(ends[1], ::fileno(stdout));
  ::close(ends[1]);
  output.file = ::fdopen(given, "w");
  output.thread = std::thread(passMessages, ends[0]);
}

void tai::noteRequest() {
  setPending([](Output &output) { ++output.pending; });
}

void tai::writeAnswer(llvm::json::Value answer) {
  Output &output = getOutput();
  {
    std::unique_lock<std::mutex> lock(output.mutex);
    output.answered.wait(
        lock, [&] { return output.pending <= 0 || output.hasEnded; });
  }
  output.write(output.print(answer));
}

void tai::finishStandardOutput() {
  Output &output = getOutput();
  if (!output.thread.joinable())
    return;
  llvm::outs().flush();
  ::close(::fileno(stdout));
  output.thread.join();
}
