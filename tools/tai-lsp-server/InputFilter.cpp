//===- InputFilter.cpp - Keeps unreadable text from the server ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "InputFilter.h"
#include "Completion.h"
#include "OutputFilter.h"
#include "tai/Dialect/Tai/IR/TextLimits.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/ADT/StringMap.h"
#include "llvm/Support/JSON.h"
#include "llvm/Support/raw_ostream.h"
#include <cstdio>
#include <thread>
#include <unistd.h>

using namespace mlir;
using namespace mlir::tai;

/// Cuts off the text in `object` at the first part that the parser cannot read.
static void cut(llvm::json::Object *object) {
  if (!object)
    return;
  std::optional<StringRef> text = object->getString("text");
  if (!text)
    return;
  if (std::optional<TextProblem> problem = findTextProblem(*text)) {
    std::string start = text->take_front(problem->at).str();
    (*object)["text"] = std::move(start);
  }
}

/// Keeps the text of a document that a message opens or changes.
static void keepText(llvm::json::Object &params,
                     llvm::StringMap<std::string> &documents) {
  llvm::json::Object *document = params.getObject("textDocument");
  std::optional<StringRef> uri =
      document ? document->getString("uri") : std::nullopt;
  if (!uri)
    return;
  if (std::optional<StringRef> text = document->getString("text"))
    documents[*uri] = text->str();
  // A change replaces the document: see the capabilities of the server.
  if (llvm::json::Array *changes = params.getArray("contentChanges"))
    for (llvm::json::Value &change : *changes)
      if (llvm::json::Object *object = change.getAsObject())
        if (std::optional<StringRef> text = object->getString("text"))
          documents[*uri] = text->str();
}

/// Answers a request for the completion of a symbol. False if the server has to
/// answer.
static bool complete(StringRef message,
                     const llvm::StringMap<std::string> &documents) {
  llvm::Expected<llvm::json::Value> value = llvm::json::parse(message);
  if (!value) {
    llvm::consumeError(value.takeError());
    return false;
  }
  llvm::json::Object *root = value->getAsObject();
  llvm::json::Object *params = root ? root->getObject("params") : nullptr;
  llvm::json::Object *document =
      params ? params->getObject("textDocument") : nullptr;
  llvm::json::Object *position =
      params ? params->getObject("position") : nullptr;
  if (!document || !position || !root->get("id") ||
      root->getString("method") != "textDocument/completion")
    return false;
  auto it = documents.find(document->getString("uri").value_or(""));
  if (it == documents.end())
    return false;
  std::optional<llvm::json::Array> items =
      completeSymbol(it->second, position->getInteger("line").value_or(0),
                     position->getInteger("character").value_or(0));
  if (!items)
    return false;
  writeAnswer(llvm::json::Object{
      {"jsonrpc", "2.0"},
      {"id", *root->get("id")},
      {"result", llvm::json::Object{{"isIncomplete", false},
                                    {"items", std::move(*items)}}}});
  return true;
}

/// Returns the message to pass on to the server; empty if the message is
/// dropped.
static std::string filter(StringRef message) {
  // JSON is parsed by recursion as well: drop messages that nest too deeply.
  if (findTextProblem(message))
    return {};
  static llvm::StringMap<std::string> documents;
  if (message.contains("textDocument/completion") &&
      complete(message, documents))
    return {};
  if (message.contains("\"id\"") && message.contains("\"method\""))
    noteRequest();
  if (!message.contains("\"text\""))
    return message.str();
  llvm::Expected<llvm::json::Value> value = llvm::json::parse(message);
  if (!value) {
    llvm::consumeError(value.takeError());
    return message.str();
  }
  llvm::json::Object *root = value->getAsObject();
  llvm::json::Object *params = root ? root->getObject("params") : nullptr;
  if (!params)
    return message.str();
  keepText(*params, documents);
  cut(params->getObject("textDocument"));
  if (llvm::json::Array *changes = params->getArray("contentChanges"))
    for (llvm::json::Value &change : *changes)
      cut(change.getAsObject());
  std::string text;
  llvm::raw_string_ostream(text) << *value;
  return text;
}

static bool readLine(std::FILE *input, std::string &line) {
  line.clear();
  for (int c; (c = std::fgetc(input)) != EOF;) {
    line += static_cast<char>(c);
    if (c == '\n')
      return true;
  }
  return !line.empty();
}

static void write(std::FILE *output, StringRef text) {
  std::fwrite(text.data(), 1, text.size(), output);
  std::fflush(output);
}

static void passDelimited(std::FILE *input, std::FILE *output) {
  std::string message, line;
  while (readLine(input, line)) {
    StringRef text = StringRef(line).ltrim();
    if (!text.starts_with("// -----")) {
      // Comment lines are skipped, because they are not part of the message.
      if (!text.starts_with("//"))
        message += line;
      continue;
    }
    write(output, filter(message) + "\n" + line);
    message.clear();
  }
  write(output, filter(message));
}

static void passFramed(std::FILE *input, std::FILE *output) {
  constexpr StringLiteral length("Content-Length:");
  std::string line;
  size_t size = 0;
  while (readLine(input, line)) {
    StringRef header = StringRef(line).trim();
    if (header.consume_front(length)) {
      if (header.trim().getAsInteger(10, size))
        size = 0;
      continue;
    }
    if (!header.empty() || size == 0)
      continue;
    std::string message(size, '\0');
    if (std::fread(message.data(), 1, size, input) != size)
      return;
    size = 0;
    message = filter(message);
    if (!message.empty())
      write(output,
            (length + " " + llvm::Twine(message.size()) + "\r\n\r\n" + message)
                .str());
  }
}

void tai::filterStandardInput(bool isDelimited) {
  int ends[2];
  int given = ::dup(::fileno(stdin));
  if (given < 0 || ::pipe(ends) != 0)
    return;
  ::dup2(ends[0], ::fileno(stdin));
  ::close(ends[0]);
  std::thread([=] {
    std::FILE *input = ::fdopen(given, "r");
    std::FILE *output = ::fdopen(ends[1], "w");
    if (isDelimited)
      passDelimited(input, output);
    else
      passFramed(input, output);
    // The pipe is closed, because the server ends when its input ends.
    std::fclose(output);
  }).detach();
}
