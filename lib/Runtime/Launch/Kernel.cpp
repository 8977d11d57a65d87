//===- Kernel.cpp - Kernels of the runtime --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Lazy compilation of kernels, and queries of summaries.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Kernel.h"
#include "tai/Runtime/Launch/AccessChecks.h"
#include <algorithm>

using namespace mlir::tai::runtime;

bool CallerAdjoints::areZero(const uint64_t *callerSlots) const {
  if (hasArrays)
    return false;
  for (const Result &result : results) {
    auto *bytes = reinterpret_cast<const char *>(callerSlots[result.slot]);
    if (std::any_of(bytes, bytes + result.bytes, [](char c) { return c; }))
      return false;
  }
  return true;
}

Kernel::Kernel(KernelInfo kernelInfo)
    : info(std::move(kernelInfo)), adjointVariants(*this, info, section) {
  function.store(info.function, std::memory_order_release);
}

//===----------------------------------------------------------------------===//
// Operations that a kernel's provider need not have
//===----------------------------------------------------------------------===//

KernelProvider::~KernelProvider() = default;

static Status hasNoCode(const Kernel &kernel) {
  return Status::failure(StatusCode::Usage,
                         "kernel '" + kernel.name() + "' has no code");
}

Status KernelProvider::compile(Kernel &kernel, TaiKernelFn &) {
  return hasNoCode(kernel);
}

KernelFlows KernelProvider::findFlows(const Kernel &) { return {}; }

Status KernelProvider::makeChecked(CheckedKernel &) {
  return Status::success();
}

Status KernelProvider::makeTangent(KernelPtr &) { return Status::success(); }

//===----------------------------------------------------------------------===//
// Kernels
//===----------------------------------------------------------------------===//

Status Kernel::resolve() {
  if (resolved())
    return Status::success();
  Lock lock(section);
  if (lock.isAgain())
    return lock.check();
  if (resolved())
    return Status::success();
  if (!info.provider)
    return hasNoCode(*this);
  // A failed compilation is tried again at the next launch, because its cause,
  // such as a full disk, may be gone by then.
  TaiKernelFn result = nullptr;
  Status status = info.provider->compile(*this, result);
  if (!status)
    return status;
  if (!result)
    return Status::failure(StatusCode::Internal,
                           "kernel '" + name() + "' was compiled to nothing");
  function.store(result, std::memory_order_release);
  return status;
}

const KernelFlows &Kernel::flows() {
  Lock lock(section);
  static const KernelFlows unknown;
  if (!valueFlows && lock.isAgain())
    return unknown;
  if (!valueFlows)
    valueFlows =
        info.provider ? info.provider->findFlows(*this) : KernelFlows();
  return *valueFlows;
}

Status Kernel::resolveTangent(Kernel *&result) {
  Lock lock(section);
  if (lock.isAgain())
    return lock.check();
  if (!tangent) {
    KernelPtr made;
    if (info.provider)
      if (Status status = info.provider->makeTangent(made); !status)
        return status;
    tangent = std::move(made);
  }
  result = *tangent ? tangent->get() : this;
  return Status::success();
}

void Kernel::setTrees(std::vector<TreePtr> trees) {
  Lock lock(section);
  for (TreePtr &tree : trees)
    for (const TreePtr &known : info.trees)
      if (tree && known && tree->name() == known->name())
        tree = known;
  info.trees = std::move(trees);
  forget();
}

void Kernel::setSummary(std::vector<Access> summary) {
  Lock lock(section);
  info.summary = std::move(summary);
  forget();
}

void Kernel::setLoopLevels(std::vector<LoopLevel> levels) {
  Lock lock(section);
  info.loopLevels = std::move(levels);
  forget();
}

int64_t Kernel::touchedBytes() const {
  struct Touched {
    int64_t read = 0, written = 0;
  };
  std::unordered_map<const Field *, Touched> fields;
  for (const Access &access : info.summary) {
    const Field &field = *access.field;
    if (field.sparseNode())
      return -1;
    int64_t bytes = field.hostBytes();
    for (const FixedIndex &fixed : access.fixed)
      bytes /= std::max<int64_t>(
          field.shape()[static_cast<size_t>(fixed.dimension)], 1);
    Touched &touched = fields[&field];
    if (access.kind != AccessKind::Write)
      touched.read = std::max(touched.read, bytes);
    if (access.kind != AccessKind::Read)
      touched.written = std::max(touched.written, bytes);
  }
  int64_t sum = 0;
  for (const auto &[field, touched] : fields)
    sum += touched.read + touched.written;
  return fields.empty() ? -1 : sum;
}

bool Kernel::uses(const Tree &tree) const {
  return std::any_of(
      info.trees.begin(), info.trees.end(),
      [&](const TreePtr &other) { return other.get() == &tree; });
}

void Kernel::setDeviceImage(std::shared_ptr<const DeviceImage> image) {
  Lock lock(section);
  info.image = std::move(image);
  forget();
}

static void addOnce(std::vector<Field *> &fields, Field *field) {
  if (std::find(fields.begin(), fields.end(), field) == fields.end())
    fields.push_back(field);
}

template <typename T>
static void replace(std::vector<T> &old, std::vector<T> &&made) {
  if (old != made)
    old = std::move(made);
}

Status Kernel::bind(uint64_t epoch) {
  Lock lock(section);
  if (boundEpoch.load(std::memory_order_acquire) == epoch)
    return Status::success();
  for (const TreePtr &tree : info.trees)
    if (!tree)
      return Status::failure(StatusCode::Usage,
                             "kernel '" + name() +
                                 "' uses a tree that has been destroyed");
    else if (!tree->isThere())
      return Status::failure(StatusCode::Usage,
                             "kernel '" + name() + "' uses tree '" +
                                 tree->name() + "', which has been destroyed");
  // A launch of another thread may be using the tables of the kernel, so a
  // table that is equal to the new one is kept.
  std::vector<void *> newBases;
  std::vector<SparseNode *> nodes;
  newBases.reserve(info.trees.size());
  for (const TreePtr &tree : info.trees) {
    newBases.push_back(tree->base());
    for (const std::unique_ptr<SparseNode> &node : tree->sparseNodes())
      nodes.push_back(node.get());
  }
  std::vector<const SparseNode *> levels;
  levels.reserve(info.loopLevels.size());
  for (const LoopLevel &level : info.loopLevels)
    levels.push_back(info.trees[level.tree]->sparseNodes()[level.node].get());
  std::vector<Field *> changed, targets, sources, stored;
  for (const Access &access : info.summary) {
    Field *field = access.field.get();
    bool changes = access.kind != AccessKind::Read;
    if (changes && field->isAdjoint())
      addOnce(changed, field);
    if (field->adjoint())
      addOnce(changes ? sources : targets, field);
    if (field->adjoint() && access.kind == AccessKind::Write)
      addOnce(stored, field);
  }
  bool uses = std::any_of(
      info.summary.begin(), info.summary.end(),
      [](const Access &access) { return access.field->isAdjoint(); });
  if (bound.usesAdjoints != uses)
    bound.usesAdjoints = uses;
  replace(bound.bases, std::move(newBases));
  replace(bound.sparseNodes, std::move(nodes));
  replace(bound.loopLevels, std::move(levels));
  replace(bound.changedAdjoints, std::move(changed));
  replace(bound.adjointTargets, std::move(targets));
  replace(bound.adjointSources, std::move(sources));
  replace(bound.overwritten, std::move(stored));
  boundEpoch.store(epoch, std::memory_order_release);
  return Status::success();
}

Status Kernel::resolveChecked(CheckedKernel *&result) {
  Lock lock(section);
  if (lock.isAgain())
    return lock.check();
  if (!checked && info.provider) {
    auto made = std::make_shared<CheckedKernel>();
    Status status = info.provider->makeChecked(*made);
    if (!status)
      return status;
    checked = std::move(made);
  }
  result = checked.get();
  return Status::success();
}
