//===- own_llvm.cpp - tai in a program with an LLVM of its own ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// LLVM is linked into this program, with its options and its global objects.
// libtai is loaded beside it, brings the LLVM of the system, and must neither
// meet an option that is registered already nor call into the copy here.
//
//   own_llvm libtai.so
//
//===----------------------------------------------------------------------===//

#include "tai-c/Tai.h"
#include "llvm/IR/IRBuilder.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/IR/Verifier.h"
#include "llvm/Support/CommandLine.h"
#include "llvm/Support/raw_ostream.h"
#include <dlfcn.h>

using namespace llvm;

static cl::opt<std::string> library(cl::Positional, cl::Required);

static const char *const layout = "!tai.root<dense<[i: 4], {x: f64}>>";
static const char *const declaration =
    R"(tai.field @x = @t["x"] : f64, rank 1)";
static const char *const kernel = R"mlir(
  tai.kernel @twice() {
    tai.parallel_for (%i) in @x {
      %value = tai.load @x[%i] : f64
      %sum = arith.addf %value, %value : f64
      tai.store %sum, @x[%i] : f64
    }
    tai.return
  }
)mlir";

/// A function of the C API, as it is declared.
#define FIND(name) reinterpret_cast<decltype(&name)>(dlsym(tai, #name))

/// A module of this program's own LLVM is well formed.
static bool makeModule(LLVMContext &context) {
  Module module("own", context);
  auto *type = FunctionType::get(Type::getInt32Ty(context), false);
  auto *function =
      Function::Create(type, Function::ExternalLinkage, "f", module);
  IRBuilder<> builder(BasicBlock::Create(context, "entry", function));
  builder.CreateRet(builder.getInt32(7));
  return !verifyModule(module, &errs());
}

int main(int argc, char **argv) {
  cl::ParseCommandLineOptions(argc, argv);
  LLVMContext context;
  if (!makeModule(context))
    return 1;
  void *tai = dlopen(library.c_str(), RTLD_NOW | RTLD_GLOBAL);
  if (!tai) {
    errs() << dlerror() << "\n";
    return 1;
  }
  double values[4] = {1, 2, 3, 4};
  for (int round = 0; round < 3; ++round) {
    TaiContext session = FIND(taiContextCreate)();
    TaiField field;
    TaiKernel twice;
    if (FIND(taiContextSetOption)(session, "cache_dir", "") ||
        FIND(taiContextAddTree)(session, "t", layout) ||
        FIND(taiContextAddField)(session, declaration, &field) ||
        FIND(taiFieldCopyFromHost)(field, values) ||
        FIND(taiKernelParse)(session, kernel, "file", "twice", &twice) ||
        FIND(taiKernelLaunch)(twice, nullptr, 0, nullptr) ||
        FIND(taiFieldCopyToHost)(field, values) || !makeModule(context)) {
      errs() << FIND(taiContextLastError)(session).message << "\n";
      return 1;
    }
    FIND(taiContextDestroy)(session);
  }
  outs() << "doubled three times: " << values[3] << "\n";
  return values[3] == 32 ? 0 : 1;
}
