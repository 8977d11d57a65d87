//===- RuntimeTestUtils.h - Trees and fields for tests ----------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Helpers for the tests of the runtime. Kernels are plain functions here.
//
//===----------------------------------------------------------------------===//

#ifndef TEST_UNIT_RUNTIME_RUNTIMETESTUTILS_H
#define TEST_UNIT_RUNTIME_RUNTIMETESTUTILS_H

#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Tape/Tape.h"
#include "gtest/gtest.h"
#include <cstring>

// Sanitizers keep freed memory for a while, so that memory sizes cannot be
// tested.
#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define TAI_TEST_SANITIZED 1
#endif
#if __has_feature(thread_sanitizer)
#define TAI_TEST_THREAD_SANITIZER 1
#endif
#endif

namespace mlir::tai::runtime::test {

inline ::testing::AssertionResult isOk(const Status &status) {
  if (status.ok())
    return ::testing::AssertionSuccess();
  return ::testing::AssertionFailure()
         << status.message() << " at '" << status.where() << "'";
}
#define EXPECT_OK(expression)                                                  \
  EXPECT_TRUE(::mlir::tai::runtime::test::isOk(expression))
#define ASSERT_OK(expression)                                                  \
  ASSERT_TRUE(::mlir::tai::runtime::test::isOk(expression))

/// A provider with the callbacks of a test; defaults for callbacks that are not
/// set.
class TestProvider final : public KernelProvider {
public:
  std::function<Status(Kernel &, TaiKernelFn &)> onCompile;
  std::function<Status(Kernel &, AdjointVariant, KernelPtr &)> onMakeAdjoint;
  std::function<Status(Kernel &, AdjointAccesses &)> onPlanAdjoint;
  std::function<Status(KernelPtr &)> onMakeTangent;
  bool zeroes = false;

  Status compile(Kernel &kernel, TaiKernelFn &function) override {
    return onCompile ? onCompile(kernel, function)
                     : KernelProvider::compile(kernel, function);
  }
  Status makeAdjoint(Kernel &kernel, AdjointVariant variant,
                     KernelPtr &adjoint) override {
    return onMakeAdjoint && !variant.readsStored
               ? onMakeAdjoint(kernel, variant, adjoint)
               : KernelProvider::makeAdjoint(kernel, variant, adjoint);
  }
  bool makesZeroingAdjoints() const override { return zeroes; }
  Status planAdjoint(Kernel &kernel, AdjointAccesses &plan) override {
    return onPlanAdjoint ? onPlanAdjoint(kernel, plan)
                         : KernelProvider::planAdjoint(kernel, plan);
  }
  Status makeTangent(KernelPtr &tangent) override {
    return onMakeTangent ? onMakeTangent(tangent)
                         : KernelProvider::makeTangent(tangent);
  }
};

/// The test provider in the description of a kernel.
inline TestProvider &provide(KernelInfo &info) {
  if (!info.provider)
    info.provider = std::make_shared<TestProvider>();
  return static_cast<TestProvider &>(*info.provider);
}

/// The levels of a dense row-major field.
inline FieldLayout rowMajor(ScalarKind scalar,
                            const std::vector<int64_t> &shape,
                            const std::vector<int64_t> &element = {},
                            int64_t place = 0) {
  FieldLayout layout;
  layout.scalar = scalar;
  layout.elementShape = element;
  layout.placeOffset = place;
  int64_t stride = byteSize(scalar);
  for (int64_t extent : element)
    stride *= extent;
  layout.indices.resize(shape.size());
  for (size_t d = shape.size(); d-- > 0;) {
    layout.indices[d] = {{1, shape[d], stride}};
    stride *= shape[d];
  }
  return layout;
}

/// A dense field in a tree of its own.
inline FieldPtr makeField(Runtime &runtime, const std::string &name,
                          ScalarKind scalar, const std::vector<int64_t> &shape,
                          const std::vector<int64_t> &element = {},
                          std::string adjoint = "") {
  FieldInfo info;
  info.name = name;
  info.layout = rowMajor(scalar, shape, element);
  info.adjoint = std::move(adjoint);
  int64_t bytes = byteSize(scalar);
  for (int64_t extent : shape)
    bytes *= extent;
  for (int64_t extent : element)
    bytes *= extent;
  FieldPtr field;
  EXPECT_OK(runtime.store().addTree(name + "_tree", bytes, info.tree));
  EXPECT_OK(runtime.store().addField(std::move(info), field));
  return field;
}

/// A field with its adjoint "<name>_grad".
inline FieldPtr makeDifferentiable(Runtime &runtime, const std::string &name,
                                   ScalarKind scalar,
                                   const std::vector<int64_t> &shape) {
  makeField(runtime, name + "_grad", scalar, shape);
  return makeField(runtime, name, scalar, shape, {}, name + "_grad");
}

inline double get(const Field &field, std::vector<int64_t> index = {},
                  int64_t component = 0) {
  double value = 0;
  EXPECT_OK(field.readF64(index.data(), component, value));
  return value;
}
inline void set(Field &field, std::vector<int64_t> index, double value,
                int64_t component = 0) {
  EXPECT_OK(field.writeF64(index.data(), component, value));
}

inline KernelPtr makeKernel(Runtime &runtime, std::string name,
                            TaiKernelFn function, std::vector<Access> summary,
                            int64_t argSlots = 0) {
  KernelInfo info;
  info.name = std::move(name);
  info.function = function;
  info.argSlots = argSlots;
  for (const Access &access : summary) {
    TreePtr tree = runtime.store().findTree(access.field->tree().name());
    bool known = false;
    for (const TreePtr &other : info.trees)
      known |= other == tree;
    if (!known)
      info.trees.push_back(tree);
  }
  info.summary = std::move(summary);
  return runtime.launcher().kernels().create(std::move(info));
}

inline Options withThreads(int threads) {
  Options options;
  options.threads = threads;
  return options;
}

/// Launches a function as a kernel without fields.
inline Status launchOnce(Runtime &runtime, TaiKernelFn function,
                         const uint64_t *args = nullptr, int64_t slots = 0) {
  return runtime.launch(*makeKernel(runtime, "k", function, {}, slots), args,
                        slots, nullptr);
}

inline uint64_t slotOf(double value) {
  uint64_t slot;
  std::memcpy(&slot, &value, sizeof(slot));
  return slot;
}

} // namespace mlir::tai::runtime::test

#endif // TEST_UNIT_RUNTIME_RUNTIMETESTUTILS_H
