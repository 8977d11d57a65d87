//===- TextLimits.cpp - Text that MLIR's parser cannot read ---------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Dialect/Tai/IR/TextLimits.h"
#include "mlir/IR/AttrTypeSubElements.h"
#include "mlir/IR/BuiltinTypeInterfaces.h"
#include "mlir/IR/Operation.h"
#include "llvm/ADT/STLExtras.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/ADT/StringMap.h"
#include "llvm/ADT/StringSwitch.h"
#include "llvm/Support/FileSystem.h"
#include "llvm/Support/MemoryBuffer.h"
#include "llvm/Support/raw_ostream.h"
#include <cstdio>
#include <unistd.h>

using namespace mlir;
using namespace mlir::tai;

namespace {
/// The largest number of dimensions of one type.
constexpr unsigned kMostDimensions = 1024;
/// The largest number of operators of one affine expression.
constexpr unsigned kMostOperators = 4096;
/// The largest number of digits in the number of a result (123 in %0#123).
constexpr size_t kMostDigits = 6;

/// True if `text` begins with a list of dimensions or symbols of an affine map,
/// in these brackets, that is too long. The parser's time grows with the square
/// of the list's length.
bool isLongList(StringRef text, char begin, char end) {
  StringRef list = text.take_until([&](char c) { return c == end; });
  return text.starts_with(StringRef(&begin, 1)) &&
         list.count(',') >= kMostDimensions;
}

/// True if an affine map or set is too long; `text` begins after its keyword
/// `affine_map` or `affine_set`.
bool isLongMap(StringRef text) {
  text = text.ltrim();
  if (!text.consume_front("<"))
    return false;
  text = text.ltrim();
  if (isLongList(text, '(', ')'))
    return true;
  size_t end = text.find(')');
  return end != StringRef::npos &&
         isLongList(text.drop_front(end + 1).ltrim(), '[', ']');
}

std::string getLongMapMessage() {
  return ("an affine map has more than " + llvm::Twine(kMostDimensions) +
          " dimensions or symbols, which is not read")
      .str();
}

class Scanner {
public:
  explicit Scanner(StringRef text) : text(text) {}
  std::optional<TextProblem> run();

private:
  struct Open {
    char bracket;
    unsigned operators = 0;
  };

  void refuse(const llvm::Twine &message) {
    if (problem)
      return;
    StringRef before = text.take_front(at);
    unsigned column = before.size() - (before.rfind('\n') + 1);
    problem =
        TextProblem{at, message.str(),
                    static_cast<unsigned>(before.count('\n') + 1), column + 1};
  }
  void checkDepth(unsigned depth) {
    deepest = std::max(deepest, depth);
    if (depth > kMostNested)
      refuse("the text is nested more than " + llvm::Twine(kMostNested) +
             " levels deep here, which is not read");
  }
  void countOperator() {
    if (!open.empty() && open.back().bracket != '{' &&
        ++open.back().operators > kMostOperators)
      refuse("an expression has more than " + llvm::Twine(kMostOperators) +
             " operators, which is not read");
  }
  void close(char bracket) {
    char first = llvm::StringSwitch<char>(StringRef(&bracket, 1))
                     .Case(")", '(')
                     .Case("]", '[')
                     .Case("}", '{')
                     .Default('<');
    // A closing bracket without a match is ignored: it is a syntax error, or
    // part of an arrow or a comparison.
    if (!open.empty() && open.back().bracket == first)
      open.pop_back();
  }
  StringRef rest() const { return text.drop_front(at + 1); }
  void skipComment();
  void skipString();
  void readWord();
  void readAlias(char kind);
  void endAlias();

  StringRef text;
  size_t at = 0;
  SmallVector<Open> open;
  unsigned minuses = 0;
  unsigned dimensions = 0;
  /// The nesting depth of each attribute or type alias, by its name with `#` or
  /// `!`.
  llvm::StringMap<unsigned> aliases;
  std::string defined;
  unsigned deepest = 0;
  std::optional<TextProblem> problem;
};
} // namespace

void Scanner::skipComment() {
  size_t end = std::min(text.find('\n', at), text.size());
  // At a separator `// -----`, brackets and aliases are forgotten: tools split
  // a text there, and the parts are independent.
  if (text.slice(at, end).starts_with("// -----")) {
    open.clear();
    aliases.clear();
    defined.clear();
  }
  at = end - 1;
}

void Scanner::skipString() {
  for (++at; at < text.size() && text[at] != '"' && text[at] != '\n'; ++at)
    at += text[at] == '\\';
}

/// Reads a name or a number, which may contain the dimensions of a type.
void Scanner::readWord() {
  StringRef word = text.drop_front(at).take_while([](char c) {
    return llvm::isAlnum(c) || c == '_' || c == '$' || c == '.' || c == '?';
  });
  at += std::max<size_t>(word.size(), 1) - 1;
  if (word == "mod" || word == "floordiv" || word == "ceildiv")
    return countOperator();
  if ((word == "affine_map" || word == "affine_set") && isLongMap(rest()))
    return refuse(getLongMapMessage());
  // A shape such as 1x2x?x, up to the first letter other than x.
  StringRef run = word.take_while(
      [](char c) { return llvm::isDigit(c) || c == 'x' || c == '?'; });
  dimensions += run.count('x');
  if (dimensions > kMostDimensions)
    refuse("a type has more than " + llvm::Twine(kMostDimensions) +
           " dimensions, which is not read");
  if (run.size() != word.size())
    dimensions = 0;
}

/// Reads `#name` or `!name`: a definition if `=` follows outside all brackets.
void Scanner::readAlias(char kind) {
  StringRef name = rest().take_while(
      [](char c) { return llvm::isAlnum(c) || c == '_' || c == '$'; });
  if (name.empty())
    return;
  if (kind == '#' && name.take_while(llvm::isDigit).size() > kMostDigits)
    return refuse("no operation has so many results");
  std::string key = (llvm::Twine(kind) + name).str();
  StringRef behind = rest().drop_front(name.size());
  at += name.size();
  if (open.empty() && behind.ltrim().starts_with("=")) {
    endAlias();
    defined = std::move(key);
    return;
  }
  if (auto known = aliases.find(key); known != aliases.end())
    checkDepth(open.size() + known->second);
}

void Scanner::endAlias() {
  // The alias counts as one level more than its text, so that chains of aliases
  // have a limit.
  if (!defined.empty())
    aliases[defined] = deepest + 1;
  defined.clear();
  deepest = 0;
}

std::optional<TextProblem> Scanner::run() {
  for (; at < text.size() && !problem; ++at) {
    char c = text[at];
    if (c == ' ' || c == '\t' || c == '\r')
      continue;
    if (c == '\n') {
      // An alias definition ends with its line, or where its brackets close.
      if (open.empty())
        endAlias();
      continue;
    }
    if (c != '-')
      minuses = 0;
    if (!llvm::isAlnum(c) && c != '?' && c != '[' && c != ']')
      dimensions = 0;
    switch (c) {
    case '/':
      if (rest().starts_with("/"))
        skipComment();
      break;
    case '"':
      skipString();
      break;
    case '<':
      // An array attribute with elements of type `index` would end the process,
      // too.
      if (StringRef inside = rest().ltrim();
          text.take_front(at).rtrim().ends_with("array") &&
          inside.consume_front("index") && inside.ltrim().starts_with(":"))
        refuse("an array attribute holds integers of known width or floats, "
               "not 'index'");
      if (rest().starts_with("="))
        break;
      [[fallthrough]];
    case '(':
    case '[':
    case '{':
      open.push_back({c});
      checkDepth(open.size());
      break;
    case ')':
    case ']':
    case '}':
    case '>':
      close(c);
      break;
    case ',':
      if (!open.empty())
        open.back().operators = 0;
      break;
    case '-':
      if (rest().starts_with(">")) {
        ++at;
        break;
      }
      countOperator();
      if (++minuses > kMostNested)
        checkDepth(minuses);
      break;
    case '+':
    case '*':
      countOperator();
      break;
    case '#':
    case '!':
      readAlias(c);
      break;
    default:
      if (llvm::isAlnum(c) || c == '_' || c == '?')
        readWord();
      break;
    }
  }
  return problem;
}

/// Finds affine maps in bytecode, to which MLIR writes them as text, and checks
/// them.
static std::optional<TextProblem> findBytecodeProblem(StringRef bytes) {
  for (StringRef name : {"affine_map", "affine_set"})
    for (size_t at = bytes.find(name); at != StringRef::npos;
         at = bytes.find(name, at + 1))
      if (isLongMap(bytes.drop_front(at + name.size())))
        return TextProblem{at, getLongMapMessage(), 1, 1};
  return std::nullopt;
}

/// True for texts that begin with the magic number of MLIR's bytecode.
static bool isBytecode(StringRef bytes) { return bytes.starts_with("ML\xefR"); }

std::optional<TextProblem> tai::findTextProblem(StringRef text) {
  return isBytecode(text) ? findBytecodeProblem(text) : Scanner(text).run();
}

LogicalResult tai::checkDimensions(Operation *module) {
  AttrTypeWalker walker;
  walker.addWalk([](ShapedType type) {
    bool isLong = type.hasRank() && type.getRank() > kMostDimensions;
    return isLong ? WalkResult::interrupt() : WalkResult::advance();
  });
  auto isLong = [&](auto part) { return walker.walk(part).wasInterrupted(); };
  WalkResult found = module->walk([&](Operation *op) {
    bool isRefused = isLong(op->getAttrDictionary()) ||
                     llvm::any_of(op->getResultTypes(), isLong);
    for (Region &region : op->getRegions())
      for (Block &block : region)
        isRefused |= llvm::any_of(block.getArgumentTypes(), isLong);
    if (!isRefused)
      return WalkResult::advance();
    emitError(op->getLoc())
        << "a type of '" << op->getName().getStringRef() << "' has more than "
        << kMostDimensions << " dimensions, which is not read";
    return WalkResult::interrupt();
  });
  return failure(found.wasInterrupted());
}

//===----------------------------------------------------------------------===//
// Tools
//===----------------------------------------------------------------------===//

/// Checks the text of an input file, and reports its problem if there is one.
static bool checkFile(StringRef name, StringRef text) {
  // Binary files, such as libraries, are not parsed.
  if (text.contains('\0') && !isBytecode(text))
    return true;
  std::optional<TextProblem> problem = findTextProblem(text);
  if (!problem)
    return true;
  llvm::errs() << name << ":" << problem->line << ":" << problem->column
               << ": error: " << problem->message << "\n";
  return false;
}

/// Checks the standard input, and replaces it by a file with the same contents.
static bool checkStandardInput() {
  auto input = llvm::MemoryBuffer::getSTDIN();
  std::FILE *copy = std::tmpfile();
  if (!input || !copy)
    return true;
  StringRef text = (*input)->getBuffer();
  std::fwrite(text.data(), 1, text.size(), copy);
  std::rewind(copy);
  // The copy stays open as the standard input.
  ::dup2(::fileno(copy), ::fileno(stdin));
  return checkFile("<stdin>", text);
}

bool tai::checkToolInput(int argc, char **argv) {
  bool hasInput = false;
  for (int i = 1; i < argc; ++i) {
    StringRef argument(argv[i]);
    StringRef name = argument.ltrim('-').split('=').first;
    if (argument.starts_with("-") && argument.size() > 1) {
      // Tools with these options read no input.
      if (name.starts_with("help") || name.starts_with("list-") ||
          name.starts_with("show-") || name == "version" || name == "h")
        return true;
      // The next argument is the name of an output file.
      if (name == "o" && !argument.contains('='))
        ++i;
      continue;
    }
    if (argument == "-" || !llvm::sys::fs::is_regular_file(argument))
      continue;
    auto file = llvm::MemoryBuffer::getFile(argument);
    if (!file)
      continue;
    // A binary file is probably a plugin, not an input.
    hasInput |= !(*file)->getBuffer().starts_with("\x7f"
                                                  "ELF");
    if (!checkFile(argument, (*file)->getBuffer()))
      return false;
  }
  return hasInput || ::isatty(::fileno(stdin)) || checkStandardInput();
}
