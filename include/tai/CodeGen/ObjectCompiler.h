//===- ObjectCompiler.h - LLVM IR to object code for this CPU ---*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The LLVM half of the compiler: optimises a module for the CPU of the options,
// by default the CPU of this process, and emits object code or assembly into
// memory. Target machines are costly to make, so an ObjectCompiler is kept and
// used again, by one thread at a time.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_OBJECTCOMPILER_H
#define TAI_CODEGEN_OBJECTCOMPILER_H

#include "llvm/ADT/ArrayRef.h"
#include "llvm/ADT/SmallVector.h"
#include "llvm/ADT/StringRef.h"
#include "llvm/Support/Error.h"
#include <memory>
#include <string>

namespace llvm {
class Module;
class TargetMachine;
class raw_pwrite_stream;
} // namespace llvm

namespace mlir::tai {

class VectorMath;

/// The options that affect machine code; see Options.def.
struct CodegenOptions {
#define TAI_CODEGEN_OPTION(type, member, initial, key) type member = initial;
#include "tai/Support/Options.def"

  bool operator==(const CodegenOptions &other) const {
    bool same = true;
#define TAI_CODEGEN_OPTION(type, member, initial, key)                         \
  same &= member == other.member;
#include "tai/Support/Options.def"
    return same;
  }
};

/// Sets the fast-math flags on all float operations of an LLVM module.
void allowFastMath(llvm::Module &module);

/// The libraries of vector functions that this process can load, by the names
/// under which it loads them. Code may call their functions; cached code is
/// valid for the same libraries only.
llvm::ArrayRef<llvm::StringRef> getVectorLibraries();

/// A CPU that code is made for, as LLVM describes it.
struct TargetCpu {
  std::string triple;
  std::string name;
  std::string features;

  /// The CPU that this process runs on.
  static const TargetCpu &getHost();

  /// The CPU that LLVM knows by `name`, or the host's CPU if `name` is empty.
  /// Fails if LLVM knows none, or if the host cannot run its code.
  static llvm::Expected<TargetCpu> find(llvm::StringRef name);
};

class ObjectCompiler {
public:
  static llvm::Expected<std::unique_ptr<ObjectCompiler>>
  create(const CodegenOptions &options);
  ~ObjectCompiler();

  const CodegenOptions &getOptions() const { return options; }

  /// Sets the target triple and data layout of an LLVM module, for steps before
  /// optimize().
  void setTarget(llvm::Module &module);

  /// Sets the target of an LLVM module and runs the optimisation pipeline on
  /// it.
  llvm::Error optimize(llvm::Module &module);

  /// Emits the object code of an optimised LLVM module.
  llvm::Expected<llvm::SmallVector<char, 0>> emitObject(llvm::Module &module);

  /// Emits the assembly text of an optimised LLVM module.
  llvm::Expected<std::string> emitAssembly(llvm::Module &module);

  /// True after a fatal error in LLVM. The compiler and the LLVM module must
  /// then be neither used nor destroyed, but leaked.
  bool isBroken() const { return broken; }

private:
  explicit ObjectCompiler(const CodegenOptions &options);
  void runPasses(llvm::Module &module);
  llvm::Error emit(llvm::Module &module, llvm::raw_pwrite_stream &stream,
                   bool assembly);

  CodegenOptions options;
  std::unique_ptr<llvm::TargetMachine> machine;
  /// The functions, such as sine, that vectorized loops may call in a form for
  /// vectors.
  std::unique_ptr<VectorMath> vectorMath;
  bool broken = false;
};

} // namespace mlir::tai

#endif // TAI_CODEGEN_OBJECTCOMPILER_H
