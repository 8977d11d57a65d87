//===- KernelAdjoint.cpp - The adjoint of a kernel ------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/KernelAdjoint.h"
#include "tai/Runtime/Launch/Kernel.h"

using namespace mlir::tai::runtime;

static Status hasNoAdjoint(const Kernel &kernel, bool zeroes) {
  return Status::failure(
      StatusCode::Usage,
      "kernel '" + kernel.name() + "' has no adjoint" +
          (zeroes ? " that zeroes the adjoints of what it stores" : ""));
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

KernelAdjoint::KernelAdjoint(Kernel &kernel, const KernelInfo &info,
                             Section &section)
    : kernel(kernel), info(info), section(section) {
  forms[0].kernel = info.adjoint;
  if (info.zeroesAdjoints)
    forms[1].kernel = info.adjoint;
}

bool KernelAdjoint::canZero() const {
  return info.zeroesAdjoints ||
         (info.provider && info.provider->makesZeroingAdjoints());
}

/// A tape records the values that the plan names: without a plan, the records
/// lack the values that the adjoint reads.
static Status planFailed(const Status &why) {
  return Status::failure(why.code(), why.message(), why.where(), why.detail());
}

Status KernelAdjoint::resolve(Kernel *&adjoint, bool zeroes) {
  Section::Entry lock(section);
  if (lock.isAgain())
    return lock.check();
  adjoint = nullptr;
  if (!info.differentiable)
    return Status::success();
  Form &form = forms[zeroes];
  if (!form.asked && !form.kernel) {
    if (!info.provider)
      return hasNoAdjoint(kernel, zeroes);
    Status status = info.provider->makeAdjoint(kernel, {zeroes}, form.kernel);
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

Status KernelAdjoint::resolveStored(Kernel *&adjoint, bool zeroes) {
  Section::Entry lock(section);
  if (lock.isAgain())
    return lock.check();
  Form &form = storedForms[zeroes];
  if (!form.asked && info.provider) {
    Status status = info.provider->makeAdjoint(
        kernel, {zeroes, /*readsStored=*/true}, form.kernel);
    if (!status)
      return status;
    form.asked = true;
  }
  adjoint = form.kernel.get();
  form.known.store(adjoint, std::memory_order_release);
  return Status::success();
}

const AdjointAccesses &KernelAdjoint::plan() {
  Section::Entry lock(section);
  if (planned && (!planned->provisional || lock.isAgain()))
    return *planned;
  // If isAgain(), a handler that has interrupted this function asks for the
  // plan. It gets an empty plan, since a handler cannot launch kernels (see
  // Kernel::checkHandler).
  static const AdjointAccesses unknown;
  if (lock.isAgain())
    return unknown;
  auto made = std::make_unique<AdjointAccesses>();
  if (info.differentiable && info.provider) {
    // If there is no adjoint, the plan stays empty. The error is reported only
    // when a reverse sweep needs the plan.
    planFailure = info.provider->planAdjoint(kernel, *made);
    if (!planFailure) {
      bool provisional = made->provisional;
      *made = AdjointAccesses();
      made->provisional = provisional;
    }
  } else if (info.differentiable) {
    made->reads = info.summary;
  }
  if (planned && made->provisional)
    return *planned;
  // The plan is stored last, so that other threads never see a kernel without
  // its plan.
  planned.swap(made);
  provisional = std::move(made);
  return *planned;
}
