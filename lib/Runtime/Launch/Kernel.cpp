//===- Kernel.cpp - Kernels of the runtime --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Lazy compilation of kernels and adjoints, and queries of summaries.
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

Kernel::Kernel(KernelInfo kernelInfo) : info(std::move(kernelInfo)) {
  function.store(info.function, std::memory_order_release);
  adjointForms[0].kernel = info.adjoint;
  if (info.zeroesAdjoints)
    adjointForms[1].kernel = info.adjoint;
}

//===----------------------------------------------------------------------===//
// Operations that a kernel's provider need not have
//===----------------------------------------------------------------------===//

static Status hasNoAdjoint(const Kernel &kernel, bool zeroes) {
  return Status::failure(
      StatusCode::Usage,
      "kernel '" + kernel.name() + "' has no adjoint" +
          (zeroes ? " that zeroes the adjoints of what it stores" : ""));
}

KernelProvider::~KernelProvider() = default;

static Status hasNoCode(const Kernel &kernel) {
  return Status::failure(StatusCode::Usage,
                         "kernel '" + kernel.name() + "' has no code");
}

Status KernelProvider::compile(Kernel &kernel, TaiKernelFn &) {
  return hasNoCode(kernel);
}

Status KernelProvider::makeAdjoint(Kernel &kernel, AdjointVariant variant,
                                   KernelPtr &) {
  return variant.readsStored ? Status::success()
                             : hasNoAdjoint(kernel, variant.zeroes);
}

Status KernelProvider::planAdjoint(Kernel &kernel, AdjointAccesses &plan) {
  plan.reads = kernel.summary();
  return Status::success();
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

/// A tape records the values that the plan names: without a plan, the records
/// lack the values that the adjoint reads.
static Status planFailed(const Status &why) {
  return Status::failure(why.code(), why.message(), why.where(), why.detail());
}

Status Kernel::resolveAdjoint(Kernel *&adjoint, bool zeroes) {
  Lock lock(section);
  if (lock.isAgain())
    return lock.check();
  adjoint = nullptr;
  if (!info.differentiable)
    return Status::success();
  AdjointForm &form = adjointForms[zeroes];
  if (!form.asked && !form.kernel) {
    if (!info.provider)
      return hasNoAdjoint(*this, zeroes);
    Status status = info.provider->makeAdjoint(*this, {zeroes}, form.kernel);
    if (!status)
      return status;
    form.asked = true;
  }
  if (form.kernel && !planFailure)
    return planFailed(planFailure);
  adjoint = form.kernel.get();
  form.known.store(adjoint, std::memory_order_release);
  return Status::success();
}

Status Kernel::resolveStoredAdjoint(Kernel *&adjoint, bool zeroes) {
  Lock lock(section);
  if (lock.isAgain())
    return lock.check();
  AdjointForm &form = storedForms[zeroes];
  if (!form.asked && info.provider) {
    Status status = info.provider->makeAdjoint(
        *this, {zeroes, /*readsStored=*/true}, form.kernel);
    if (!status)
      return status;
    form.asked = true;
  }
  adjoint = form.kernel.get();
  form.known.store(adjoint, std::memory_order_release);
  return Status::success();
}

const AdjointAccesses &Kernel::plan() {
  Lock lock(section);
  if (adjointPlan && (!adjointPlan->provisional || lock.isAgain()))
    return *adjointPlan;
  // If isAgain(), a handler that has interrupted this function asks for the
  // plan. It gets an empty plan, since a handler cannot launch kernels (see
  // checkHandler).
  static const AdjointAccesses unknown;
  if (lock.isAgain())
    return unknown;
  auto made = std::make_unique<AdjointAccesses>();
  if (info.differentiable && info.provider) {
    // If there is no adjoint, the plan stays empty. The error is reported only
    // when a reverse sweep needs the plan.
    planFailure = info.provider->planAdjoint(*this, *made);
    if (!planFailure) {
      bool provisional = made->provisional;
      *made = AdjointAccesses();
      made->provisional = provisional;
    }
  } else if (info.differentiable) {
    made->reads = info.summary;
  }
  if (adjointPlan && made->provisional)
    return *adjointPlan;
  // The plan is stored last, so that other threads never see a kernel without
  // its plan.
  adjointPlan.swap(made);
  provisionalPlan = std::move(made);
  return *adjointPlan;
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
  if (!tangentAsked && info.provider) {
    Status status = info.provider->makeTangent(tangent);
    if (!status)
      return status;
    tangentAsked = true;
  }
  result = tangent ? tangent.get() : this;
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
  if (usesAdjoints != uses)
    usesAdjoints = uses;
  replace(bases, std::move(newBases));
  replace(sparseNodes, std::move(nodes));
  replace(loopLevels, std::move(levels));
  replace(changedAdjoints, std::move(changed));
  replace(adjointTargets, std::move(targets));
  replace(adjointSources, std::move(sources));
  replace(overwritten, std::move(stored));
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

//===----------------------------------------------------------------------===//
// Activity
//===----------------------------------------------------------------------===//

// An adjoint visits the cells that its primal visited. Under a tape, these
// cells are part of the record of the launch. An adjoint that is launched by
// hand belongs to the last launch of its primal, whose cells are kept here.

void Kernel::noteBegin() {
  std::lock_guard<std::mutex> lock(activityMutex);
  lastBegins.clear();
  for (const SparseNode *node : sparseNodes)
    lastBegins.push_back(node->now());
  lastLoops.clear();
}

void Kernel::noteLoops(const LoopLists &loops) {
  std::lock_guard<std::mutex> lock(activityMutex);
  lastLoops = loops;
}

Status Kernel::checkActivity(LoopLists &loops, bool &wasLaunched) {
  const AdjointAccesses &wants = plan();
  std::lock_guard<std::mutex> lock(activityMutex);
  if (sparseNodes.empty() || lastBegins.size() != sparseNodes.size())
    return Status::success();
  wasLaunched = true;
  loops = lastLoops;
  auto asksFor = [&](const SparseNode *node) {
    for (const FieldPtr &field : wants.activity)
      for (const SparseNode *at = field->sparseNode(); at; at = at->above())
        if (at == node)
          return true;
    return false;
  };
  for (size_t i = 0; i < sparseNodes.size(); ++i) {
    const SparseNode *node = sparseNodes[i];
    if (node->hasRemovedSince(lastBegins[i]))
      return Status::failure(
          StatusCode::Usage,
          "cells of " + node->info().label +
              " were deactivated since kernel '" + name() +
              "' was launched, and its gradient needs them; launch it under a "
              "tape, or deactivate after the gradient");
    if (asksFor(node) && node->hasChangedSince(lastBegins[i]))
      return Status::failure(
          StatusCode::Usage,
          "the gradient of kernel '" + name() + "' asks which cells of " +
              node->info().label +
              " are active, and that has changed since the kernel was "
              "launched; launch it under a tape");
  }
  return Status::success();
}
