//===- KernelAdjoint.h - The adjoint of a kernel ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The plan of a kernel's adjoint, which names the memory that it uses, and the
// variants of the adjoint. Plan and variants are made when they are needed.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_LAUNCH_KERNELADJOINT_H
#define TAI_RUNTIME_LAUNCH_KERNELADJOINT_H

#include "tai/ABI/LaunchAccesses.h"
#include "tai/Runtime/Storage/Field.h"
#include "tai/Runtime/Threads/Section.h"
#include <array>
#include <optional>

namespace mlir::tai::runtime {

class Kernel;
struct KernelInfo;
using KernelPtr = std::shared_ptr<Kernel>;

/// An access of a kernel to a field: an entry of the kernel's summary.
struct Access {
  FieldPtr field;
  AccessKind kind;
  /// The indices that are the same in all iterations of a launch, in the order
  /// of their dimensions: launches with different values of such an index
  /// access different elements.
  std::vector<FixedIndex> fixed = {};
  /// For a write: boxes of elements that the launch certainly stores, whatever
  /// values fields hold. Null if they are unknown or do not form boxes.
  std::shared_ptr<const std::vector<StoredBox>> boxes = nullptr;

  bool operator==(const Access &other) const {
    return field == other.field && kind == other.kind && fixed == other.fixed;
  }
};

/// A loop of an adjoint over a sparse field that can be skipped in cells where
/// all of `sources` are zero; with no sources, it cannot be skipped.
struct SkippableLoop {
  FieldPtr loop;
  std::vector<FieldPtr> sources;
};

/// The memory that the adjoint of a kernel reads and changes; known before the
/// adjoint is compiled.
struct AdjointAccesses {
  /// The primal fields that the adjoint reads.
  std::vector<Access> reads;
  /// Fields of which the adjoint reads the contents from before the launch.
  std::vector<FieldPtr> before;
  /// True if the adjoint re-executes the primal kernel, which changes the
  /// fields that the adjoint reads.
  bool reexecutes = false;
  /// If not empty: the kernels into which this kernel was split. The tape
  /// records them, in this order, instead of this kernel. They take the
  /// arguments of this kernel; one of them may return its results.
  std::vector<KernelPtr> parts;
  /// True if this plan describes the zeroing variant of the adjoint, and the
  /// sweep must launch that variant.
  bool zeroes = false;
  /// True if the plan is preliminary, and must not be cached: it may change
  /// when further adjoint fields are declared.
  bool provisional = false;
  /// Fields for which the adjoint reads which cells of the sparse levels above
  /// them are active.
  std::vector<FieldPtr> activity = {};
  /// The adjoint's loops over sparse fields, which can be skipped in cells
  /// where their sources are zero.
  std::vector<SkippableLoop> flags = {};
  /// The accesses, beside `reads`, of the variant of the adjoint that loads
  /// outputs stored by the kernel; no value if there is no such variant. The
  /// variant is valid if nothing has changed the accessed elements since the
  /// launch.
  std::optional<std::vector<Access>> stored = std::nullopt;
  /// Array arguments whose elements the adjoint reads, by the numbers of the
  /// argument slots that hold their pointers.
  std::vector<int64_t> arrays = {};
};

class KernelAdjoint {
public:
  KernelAdjoint(Kernel &kernel, const KernelInfo &info, Section &section);

  /// Gives the adjoint kernel, or with `zeroes` its zeroing variant; compiles
  /// it if necessary. Null if there is nothing to differentiate. Thread-safe.
  Status resolve(Kernel *&adjoint, bool zeroes = false);
  /// Gives the variant of the adjoint that loads outputs stored by the kernel,
  /// with `zeroes` its zeroing variant; null if there is no such variant.
  /// Requires that plan().stored has a value. Thread-safe.
  Status resolveStored(Kernel *&adjoint, bool zeroes);
  /// The variant that has been resolved, or null.
  Kernel *known(bool zeroes, bool stored) const {
    return form(zeroes, stored).known.load(std::memory_order_acquire);
  }
  /// True if the variant has been requested from the provider.
  bool isAsked(bool zeroes, bool stored) const {
    const Form &found = form(zeroes, stored);
    return found.known.load(std::memory_order_relaxed) || found.asked;
  }
  /// True if there is a variant that zeroes the adjoints of the elements that
  /// the kernel stores.
  bool canZero() const;

  /// Plans the adjoint if it has no plan yet. Thread-safe.
  const AdjointAccesses &plan();
  // The following queries hold for the plan that has been made; false if there
  // is none.
  /// True if the kernel is split into several kernels.
  bool hasParts() const { return planned && !planned->parts.empty(); }
  bool reexecutes() const { return planned && planned->reexecutes; }
  /// The accesses of the variant that loads outputs stored by the kernel; null
  /// if there is no such variant.
  const std::vector<Access> *stored() const {
    return planned && planned->stored ? &*planned->stored : nullptr;
  }
  /// True if the adjoint always zeroes the adjoints of the elements that the
  /// kernel overwrites.
  bool alwaysZeroes() const { return planned && planned->zeroes; }

private:
  /// A variant of the adjoint kernel. There are four: plain and zeroing, each
  /// without and with loading of stored outputs.
  struct Form {
    KernelPtr kernel;
    bool asked = false;
    /// The adjoint kernel, once it has been made: a sweep reads this pointer
    /// without a lock.
    std::atomic<Kernel *> known{nullptr};
  };
  const Form &form(bool zeroes, bool stored) const {
    return stored ? storedForms[zeroes] : forms[zeroes];
  }

  Kernel &kernel;
  const KernelInfo &info;
  /// The lock of the kernel's compilation.
  Section &section;
  std::array<Form, 2> forms, storedForms;
  std::unique_ptr<AdjointAccesses> planned;
  /// The plan before the current plan, kept because other threads may still
  /// read it.
  std::unique_ptr<AdjointAccesses> provisional;
  /// The error of the attempt to plan the adjoint: an adjoint without a plan is
  /// not launched.
  Status planFailure;
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_LAUNCH_KERNELADJOINT_H
