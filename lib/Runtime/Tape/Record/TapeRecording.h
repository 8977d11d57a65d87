//===- TapeRecording.h - The recorded sequence ------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The sequence as data only: launches with their arguments, host functions, and
// writes of the host.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_LIB_RUNTIME_TAPE_RECORD_TAPERECORDING_H
#define TAI_LIB_RUNTIME_TAPE_RECORD_TAPERECORDING_H

#include "tai/Runtime/Host/FieldCopies.h"
#include "tai/Runtime/Host/HostWrite.h"
#include "tai/Runtime/Launch/Kernel.h"
#include "tai/Runtime/Tape/TapeTypes.h"
#include <algorithm>

namespace mlir::tai::runtime {

class TapeRecording {
public:
  enum class Kind : uint8_t { Launch, Callback, Write };
  struct Record {
    Kernel *kernel;   // of a launch
    uint64_t launch;  // number, relative to the first
    uint64_t payload; // first argument slot, or number of callback or write
    Kind kind = Kind::Launch;
  };
  /// The records with the arguments of all launches.
  struct Launches {
    std::vector<Record> records;
    std::vector<uint64_t> slots;

    /// True if these are the same kernels with the same arguments, whatever the
    /// numbers of the launches; for recordings of launches only.
    bool operator==(const Launches &other) const;
  };
  const Launches &launches() const { return all; }
  /// Allocates memory for as many records and arguments as `expected` has.
  void reserve(const Launches &expected) {
    all.records.reserve(expected.records.size());
    all.slots.reserve(expected.slots.size());
  }

  size_t size() const { return all.records.size(); }
  bool empty() const { return all.records.empty(); }
  const Record &operator[](size_t index) const { return all.records[index]; }
  std::vector<Record>::const_iterator begin() const {
    return all.records.begin();
  }
  std::vector<Record>::const_iterator end() const { return all.records.end(); }
  /// The number of the next record.
  uint32_t next() const { return static_cast<uint32_t>(all.records.size()); }

  /// The arguments and the number of a recorded launch.
  const uint64_t *args(const Record &record) const {
    return all.slots.data() + record.payload;
  }
  uint64_t number(const Record &record) const {
    return firstLaunch + record.launch;
  }
  /// The functions that the record of a host function calls.
  const TapeCallback &callback(const Record &record) const {
    return callbacks[record.payload];
  }
  /// The data of a record of a write by the host.
  HostWrite write(const Record &record) const {
    return writes[record.payload]->get();
  }
  /// Describes a record for display: "@f", "(write of @x)", "(host function)".
  std::string describe(const Record &record) const;

  /// The launched kernels, in order of first launch.
  const std::vector<KernelPtr> &kernels() const { return kept; }
  bool hasCallbacks() const { return !callbacks.empty(); }
  bool onlyLaunches() const { return callbacks.empty() && writes.empty(); }
  /// True if some host function of the recording has a reverse.
  bool callsInReverse() const { return reverseCallbacks; }
  /// True if a record before the given one is a launch.
  bool launchesBefore(size_t index) const {
    return std::any_of(
        begin(), begin() + static_cast<ptrdiff_t>(index),
        [](const Record &record) { return record.kind == Kind::Launch; });
  }

  /// Fields that a record overwrites after an earlier use, by the summaries of
  /// kernels, in the order of the records.
  std::vector<FieldOverwrite> overwrites() const;

  /// Keeps a launched kernel alive as long as the recording.
  void keep(Kernel &kernel);
  void addLaunch(Kernel &kernel, const uint64_t *args, uint64_t number) {
    if (!anyLaunch) {
      anyLaunch = true;
      firstLaunch = number;
    }
    lastLaunch = number - firstLaunch;
    all.records.push_back({&kernel, lastLaunch, all.slots.size()});
    for (int64_t i = 0; i < kernel.tapeSlots(); ++i)
      all.slots.push_back(args[i]);
  }
  /// `start`: the number of the function's first launch (or the number that it
  /// would have). `next`: the number of the first launch after the function.
  void addCallback(TapeCallback callback, uint64_t start, uint64_t next);
  /// A recorded write of the host, which owns the data that its HostWrite
  /// refers to.
  struct Write {
    /// Copies the data of a write; `status` is a failure if the host interrupts
    /// the copy.
    static std::unique_ptr<Write> make(FieldPtr field, const HostWrite &write,
                                       Status &status);
    HostWrite get() const;

    FieldPtr field;
    HostWrite view;
    std::vector<char> bytes;
    std::vector<int64_t> index;
  };
  void addWrite(std::unique_ptr<Write> write);

  /// numLaunches: how many launch numbers the records span. renumber: sets the
  /// number of the first launch, which shifts all numbers.
  uint64_t numLaunches() const { return anyLaunch ? lastLaunch + 1 : 0; }
  void renumber(uint64_t first) { firstLaunch = first; }

private:
  Launches all;
  std::vector<TapeCallback> callbacks;
  std::vector<std::unique_ptr<Write>> writes;
  std::vector<KernelPtr> kept;
  uint64_t firstLaunch = 0;
  uint64_t lastLaunch = 0;
  bool anyLaunch = false;
  bool reverseCallbacks = false;
};

} // namespace mlir::tai::runtime

#endif // TAI_LIB_RUNTIME_TAPE_RECORD_TAPERECORDING_H
