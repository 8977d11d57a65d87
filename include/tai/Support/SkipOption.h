//===- SkipOption.h - The skips as an option of a pass ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Makes `skip=all,-unchanged-lists` an option of passes and pipelines.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_SUPPORT_SKIPOPTION_H
#define TAI_SUPPORT_SKIPOPTION_H

#include "tai/Support/Skips.h"
#include "llvm/Support/CommandLine.h"

namespace llvm::cl {

template <>
class parser<mlir::tai::SkipSet> : public basic_parser<mlir::tai::SkipSet> {
public:
  explicit parser(Option &option) : basic_parser(option) {}

  bool parse(Option &option, StringRef, StringRef text,
             mlir::tai::SkipSet &value) {
    std::string error;
    return !mlir::tai::SkipSet::parse(text, value, error) &&
           option.error(error);
  }
  static void print(raw_ostream &os, const mlir::tai::SkipSet &value) {
    os << value.str();
  }
  void printOptionDiff(const Option &option, const mlir::tai::SkipSet &value,
                       const OptionValue<mlir::tai::SkipSet> &,
                       size_t width) const {
    printOptionName(option, width);
    outs() << "= " << value.str() << '\n';
  }
  StringRef getValueName() const override { return "names"; }
  void anchor() override {}
};

} // namespace llvm::cl

#endif // TAI_SUPPORT_SKIPOPTION_H
