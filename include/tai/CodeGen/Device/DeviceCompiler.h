//===- DeviceCompiler.h - From a gpu.module to an image ---------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The device half of the compiler: makes an image that a runtime::Device loads
// from the `gpu.module` that the lowering leaves. For CUDA the image is PTX
// text, for the emulated device object code of the host. The device library,
// and libdevice (CUDA's math library) where it is called, are linked in before
// the code is optimised.
//
// Kernels are the functions with the attribute `gpu.kernel` or `nvvm.kernel`,
// numbered in their order. The emulated device calls a kernel `f` by `f.slots`,
// which takes the address of the parameters, each in its own type at the start
// of eight bytes.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_CODEGEN_DEVICE_DEVICECOMPILER_H
#define TAI_CODEGEN_DEVICE_DEVICECOMPILER_H

#include "mlir/IR/Operation.h"
#include "tai/CodeGen/ObjectCompiler.h"
#include "tai/Runtime/Programs/ProgramPlan.h"
#include "llvm/ADT/ArrayRef.h"
#include "llvm/IR/LLVMContext.h"
#include "llvm/IR/Module.h"
#include "llvm/Support/Error.h"
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace mlir {
class DialectRegistry;
class ModuleOp;
} // namespace mlir

namespace mlir::tai {

/// The device that code is compiled for, in the terms of runtime::Device.
struct DeviceTarget {
  runtime::DeviceKind kind = runtime::DeviceKind::Cuda;
  /// The architecture, such as "sm_90"; ignored for the emulated device.
  std::string name;

  bool operator==(const DeviceTarget &other) const {
    return kind == other.kind && name == other.name;
  }
  std::string str() const;
};

/// The suffix of the names of the functions by which the emulated device calls
/// kernels.
constexpr llvm::StringLiteral kSlotsSuffix = ".slots";

/// The code of a device module between its translation to LLVM IR and the
/// emission of an image.
struct DeviceCode {
  std::unique_ptr<llvm::LLVMContext> context;
  std::unique_ptr<llvm::Module> module;
  /// The names of the device kernels, in the order of their numbers, and their
  /// source locations.
  std::vector<std::string> functions, places;
  /// See DeviceImage::accesses.
  std::vector<std::vector<int64_t>> accesses;
  /// See DeviceImage::blockSizes.
  std::vector<int64_t> blockSizes;
  /// For each device kernel, the most threads that one block may have, as text.
  std::vector<std::string> mostThreads;
};

/// Finds the `gpu.module` of a lowered module. Null if there is none; an error
/// if there are several.
llvm::Expected<Operation *> findDeviceModule(ModuleOp module);

/// Registers the translations to LLVM IR that the dialects of device code need.
void registerDeviceTranslations(DialectRegistry &registry);

/// Adds the function by which the emulated device calls a kernel.
llvm::Function *addSlotsFunction(llvm::Function &kernel);

/// The bitcode of the project's device library for a kind of device.
llvm::ArrayRef<char> getDeviceLibrary(runtime::DeviceKind kind);

/// Compiles device code; used by one thread at a time. Float semantics follow
/// the options: with fastMath, division and square root are approximate; with
/// contract, a product and a sum may be rounded once; without both, every
/// operation is rounded as IEEE 754 says.
class DeviceCompiler {
public:
  static llvm::Expected<std::unique_ptr<DeviceCompiler>>
  create(const DeviceTarget &target, const CodegenOptions &options);
  ~DeviceCompiler();

  /// Translates a device module to LLVM IR, links the device libraries, and
  /// makes all functions but the kernels internal. Failures of the translation
  /// itself are reported as diagnostics and have no text.
  llvm::Expected<DeviceCode> translate(Operation *deviceModule);
  llvm::Error optimize(DeviceCode &code);
  /// Emits the image of translated device code: PTX text for CUDA, or object
  /// code of the host for the emulated device.
  llvm::Expected<runtime::DeviceImage> emit(DeviceCode &code);

  /// For code that is assembled as LLVM IR instead of translated: an empty
  /// module, and the steps from there to an image. `prepare`, if given, runs
  /// after the libraries are linked; symbols for which `isVisible` is false are
  /// internalised.
  DeviceCode createCode(StringRef name);
  llvm::Expected<runtime::DeviceImage>
  finish(DeviceCode &code,
         llvm::function_ref<bool(const llvm::GlobalValue &)> isVisible,
         llvm::function_ref<void()> prepare = {});
  /// A hook that sees the linked LLVM module before LLVM's passes run on it. It
  /// may fail, or return the image that the passes would lead to.
  using LinkedHook =
      std::function<llvm::Expected<std::optional<runtime::DeviceImage>>(
          const llvm::Module &)>;
  /// Makes `finish` call the hook before LLVM's passes; null removes the hook.
  void setLinkedHook(LinkedHook hook) { linkedHook = std::move(hook); }

  bool isCuda() const { return target.kind == runtime::DeviceKind::Cuda; }
  /// True after a fatal error in LLVM: the compiler must not be used any more.
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
  /// Emits object code of the host, for the emulated device.
  std::unique_ptr<ObjectCompiler> objects;
  bool broken = false;
  LinkedHook linkedHook;
};

/// Fuses the bodies of several device kernels, given by the bitcode of their
/// images and by their names, into one kernel, `tai_program`; see
/// tai/ABI/DeviceAbi.h. For TAI_SCOPE_NONE, makes a separate kernel `f_kernel`
/// of each of the given functions `f` of the device library.
llvm::Expected<runtime::DeviceImage>
makeProgram(DeviceCompiler &compiler, const runtime::ProgramPlan &plan);

} // namespace mlir::tai

#endif // TAI_CODEGEN_DEVICE_DEVICECOMPILER_H
