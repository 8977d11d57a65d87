//===- DeviceCompiler.h - From a gpu.module to an image ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device half of the compiler: makes an image that a runtime::Device loads
// from the `gpu.module` that the lowering leaves. For CUDA that is PTX text,
// for the emulated device object code of the host. The device library, and
// where it is called libdevice, CUDA's math library, are linked in before the
// code is optimised.
//
// Kernels are the functions with the attribute `gpu.kernel` or `nvvm.kernel`,
// numbered in their order. The emulated device calls a kernel `f` by `f.slots`,
// which takes the address of the parameters, each in its own type at the start
// of eight bytes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_DEVICECOMPILER_H
#define TAI_CODEGEN_DEVICECOMPILER_H

#include "mlir/IR/Operation.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "tai/Runtime/Queue/DeviceQueue.h"
#include "llvm/ADT/ArrayRef.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/Support/Error.h"
#include <memory>
#include <string>
#include <vector>

namespace mlir {
class DialectRegistry;
class ModuleOp;
} // namespace mlir

namespace mlir::tai {

/// The device that code is compiled for, by the words of runtime::Device.
struct DeviceTarget {
  runtime::DeviceKind kind = runtime::DeviceKind::Cuda;
  /// "sm_90"; not looked at for the emulated device.
  std::string name;

  bool operator==(const DeviceTarget &other) const {
    return kind == other.kind && name == other.name;
  }
  std::string str() const;
};

/// The suffix of the functions that the emulated device calls.
constexpr llvm::StringLiteral kSlotsSuffix = ".slots";

/// Device code on its way to an image.
struct DeviceCode {
  std::unique_ptr<llvm::LLVMContext> context;
  std::unique_ptr<llvm::Module> module;
  /// Names of the kernels, in the order of their numbers, and where they stand
  /// in the source.
  std::vector<std::string> functions, places;
  /// See DeviceImage.
  std::vector<std::vector<int64_t>> accesses;
  /// As in the image.
  std::vector<int64_t> blockSizes;
  /// What each function says of the most threads of a block.
  std::vector<std::string> mostThreads;
};

/// The `gpu.module` of a lowered module. Null where there is none; an error
/// where there are several.
llvm::Expected<Operation *> findDeviceModule(ModuleOp module);

/// Registers what the translation of device code needs.
void registerDeviceTranslations(DialectRegistry &registry);

/// Adds the function by which the emulated device calls a kernel.
llvm::Function *addSlotsFunction(llvm::Function &kernel);

/// The bitcode of the device library.
llvm::ArrayRef<char> getDeviceLibrary(runtime::DeviceKind kind);

/// Used by one thread at a time. The floats follow the options: with fastMath,
/// division and square root are approximate and denormal numbers of 32 bits are
/// zero; with contract, a product and a sum may be rounded once; without both,
/// every operation is rounded as IEEE 754 says.
class DeviceCompiler {
public:
  static llvm::Expected<std::unique_ptr<DeviceCompiler>>
  create(const DeviceTarget &target, const CodegenOptions &options);
  ~DeviceCompiler();

  /// Translates, links the libraries, and hides all but the kernels. Failures
  /// of the translation itself are reported as diagnostics and have no text.
  llvm::Expected<DeviceCode> translate(Operation *deviceModule);
  llvm::Error optimize(DeviceCode &code);
  /// PTX text, or object code of the host.
  llvm::Expected<runtime::DeviceImage> emit(DeviceCode &code);

  /// For code that is put together without a translation: an empty module, and
  /// what makes an image of it. `prepare`, where given, runs when the libraries
  /// are linked; what is not visible is hidden.
  DeviceCode createCode(StringRef name);
  llvm::Expected<runtime::DeviceImage>
  finish(DeviceCode &code,
         llvm::function_ref<bool(const llvm::GlobalValue &)> isVisible,
         llvm::function_ref<void()> prepare = {});
  /// Makes `finish` print what it would give to LLVM's passes, and fail.
  void printInsteadOfFinishing(std::string *text) { printed = text; }

  bool isCuda() const { return target.kind == runtime::DeviceKind::Cuda; }
  /// True once LLVM has met a fatal error: this is then no longer of use.
  bool isBroken() const;

private:
  DeviceCompiler(const DeviceTarget &target, const CodegenOptions &options);
  llvm::Error link(llvm::Module &module);
  llvm::Error linkLibdevice(llvm::Module &module);
  void setTarget(llvm::Module &module);
  void prepareForCuda(llvm::Module &module);
  void runPasses(llvm::Module &module);
  llvm::Error guard(DeviceCode &code, StringRef place,
                    llvm::function_ref<void()> task);

  DeviceTarget target;
  CodegenOptions options;
  /// For CUDA.
  std::unique_ptr<llvm::TargetMachine> machine;
  bool hasVectorAtomics = false;
  /// For the emulated device.
  std::unique_ptr<ObjectCompiler> objects;
  bool broken = false;
  std::string *printed = nullptr;
};

/// Makes one kernel, `tai_program`, of the bodies of kernels, given by the
/// bitcode of their images and by their names; see tai/ABI/DeviceAbi.h.
/// For TAI_SCOPE_NONE, makes a kernel of each of these functions of the
/// device library, with `_kernel` behind its name.
llvm::Expected<runtime::DeviceImage>
makeProgram(DeviceCompiler &compiler, const runtime::ProgramPlan &plan);

} // namespace mlir::tai

#endif // TAI_CODEGEN_DEVICECOMPILER_H
