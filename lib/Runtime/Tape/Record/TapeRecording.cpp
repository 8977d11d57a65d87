//===- TapeRecording.cpp - The recorded sequence --------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapeRecording.h"
#include <algorithm>
#include <unordered_map>

using namespace mlir::tai::runtime;

std::unique_ptr<TapeRecording::Write>
TapeRecording::Write::make(FieldPtr field, const HostWrite &write,
                           Status &status) {
  auto made = std::make_unique<Write>();
  made->view = write;
  if (write.index)
    made->index.assign(write.index, write.index + field->rank());
  made->field = std::move(field);
  const auto *bytes = static_cast<const char *>(write.bytes);
  int64_t count = write.numBytes();
  made->bytes.reserve(static_cast<size_t>(count));
  status = safepoint::runInPieces(
      count, FieldCopies::bytesPerSafepoint, /*canStop=*/true,
      [&](int64_t at, int64_t size) {
        made->bytes.insert(made->bytes.end(), bytes + at, bytes + at + size);
        return Status::success();
      });
  return made;
}

HostWrite TapeRecording::Write::get() const {
  HostWrite write = view;
  write.bytes = bytes.data();
  write.index = index.data();
  return write;
}

void TapeRecording::keep(Kernel &kernel) {
  if (std::none_of(kept.begin(), kept.end(), [&](const KernelPtr &known) {
        return known.get() == &kernel;
      }))
    kept.push_back(kernel.shared_from_this());
}

void TapeRecording::addCallback(TapeCallback callback, uint64_t start,
                                uint64_t next) {
  reverseCallbacks |= static_cast<bool>(callback.backward);
  // The launches of the function keep their numbers: called again, the function
  // draws the same random numbers.
  if (!anyLaunch) {
    anyLaunch = true;
    firstLaunch = start;
  }
  if (next > firstLaunch)
    lastLaunch = next - 1 - firstLaunch;
  all.records.push_back(
      {nullptr, start - firstLaunch, callbacks.size(), Kind::Callback});
  callbacks.push_back(std::move(callback));
}

void TapeRecording::addWrite(std::unique_ptr<Write> write) {
  all.records.push_back({nullptr, 0, writes.size(), Kind::Write});
  writes.push_back(std::move(write));
}

std::vector<FieldOverwrite> TapeRecording::overwrites() const {
  std::vector<FieldOverwrite> result;
  std::unordered_map<const Field *, int64_t> lastUse;
  for (size_t i = 0; i < size(); ++i) {
    if (!all.records[i].kernel)
      continue;
    const std::vector<Access> &summary = all.records[i].kernel->summary();
    for (const Access &access : summary) {
      if (access.kind != AccessKind::Write)
        continue;
      auto earlier = lastUse.find(access.field.get());
      if (earlier != lastUse.end())
        result.push_back(
            {static_cast<int64_t>(i), access.field.get(), earlier->second});
    }
    for (const Access &access : summary)
      lastUse[access.field.get()] = static_cast<int64_t>(i);
  }
  return result;
}

bool TapeRecording::Launches::operator==(const Launches &other) const {
  return slots == other.slots && records.size() == other.records.size() &&
         std::equal(records.begin(), records.end(), other.records.begin(),
                    [](const Record &one, const Record &two) {
                      return one.kernel == two.kernel &&
                             one.payload == two.payload && one.kind == two.kind;
                    });
}

std::string TapeRecording::describe(const Record &record) const {
  if (record.kernel)
    return "@" + record.kernel->name();
  return record.kind == Kind::Write
             ? "(write of @" + write(record).field->name() + ")"
             : "(host function)";
}
