//===- Halos.h - Halos that are current -------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The rows of other processes that a process of a mesh has fetched and that
// have not changed since. A loop whose halos are current needs no exchange.
// Everything that changes rows removes their halos: loops do by the exchange
// `stale`, the host by remove(), and reverse sweeps, which restore former rows,
// by removeAll(). All ranks do so alike, and leave out the same exchanges.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_HALOS_H
#define TAI_RUNTIME_STORAGE_HALOS_H

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace mlir::tai::runtime {

/// The halos of a part of a field. `field` is the address of the field's first
/// element, and `address`, with the extents and strides in bytes, the part.
struct Halo {
  const void *field;
  const void *address;
  std::vector<int64_t> extents, strides;
  int64_t before, after;
};

/// The halos of the fields of one runtime. Launches of several threads may use
/// it at once.
class Halos {
public:
  /// True if the rows are there.
  bool isCurrent(const Halo &halo) const;
  void add(Halo halo);
  /// Removes the halos of a part that has changed. Parts of the same form at
  /// other addresses have other elements.
  void removeChanged(const Halo &part);
  /// Removes all halos of a field.
  void remove(const void *field);
  void removeAll();

private:
  template <typename Predicate> void removeIf(Predicate isGone);

  /// Guards the list. `isEmpty` tells writes of the host in programs without a
  /// mesh that there is nothing to remove.
  mutable std::mutex mutex;
  std::vector<Halo> known;
  std::atomic<bool> isEmpty{true};
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_HALOS_H
