//===- DeviceReport.cpp - Failures and output of device code --------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Device/DeviceReport.h"
#include "tai/ABI/Abi.h"
#include "tai/Runtime/Device/FailureNotice.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>
#include <atomic>
#include <cstring>

using namespace mlir::tai::runtime;

TaiDeviceState mlir::tai::runtime::freshDeviceState(uint64_t outputCapacity,
                                                    uint64_t stackLimit) {
  TaiDeviceState state;
  std::memset(&state, 0, sizeof(state));
  state.magic = TAI_DEVICE_STATE_MAGIC;
  state.version = TAI_DEVICE_STATE_VERSION;
  state.outputCapacity = outputCapacity / 8 * 8;
  state.outputEnd = state.outputCapacity;
  state.stackLimit = stackLimit;
  return state;
}

uint64_t mlir::tai::runtime::deviceOutputBytes(const TaiDeviceState &state) {
  if (state.outputUsed <= state.outputCapacity)
    return state.outputUsed;
  return std::min(state.outputEnd, state.outputCapacity);
}

namespace {
/// The fields of a record that device code has written, decoded.
struct Record {
  TaiDeviceRecord header;
  std::vector<uint64_t> slots;
  std::vector<int32_t> kinds, shapes;
  std::string text, where;

  /// Decodes a record of device code from `bytes`; returns false if they do not
  /// form one.
  bool parse(const char *bytes, uint64_t available);
  std::string format();

private:
  void placeByteCounts();
};
} // namespace

bool Record::parse(const char *bytes, uint64_t available) {
  if (available < sizeof(header))
    return false;
  std::memcpy(&header, bytes, sizeof(header));
  if (header.bytes > available || header.bytes > TAI_DEVICE_RECORD_BYTES ||
      header.bytes % 8 || header.count < 0 || header.slots < 0)
    return false;
  // Each size is compared with the limit of a record, so that the sum of the
  // sizes cannot wrap.
  constexpr uint64_t most = TAI_DEVICE_RECORD_BYTES;
  auto count = static_cast<uint64_t>(header.count);
  auto slotCount = static_cast<uint64_t>(header.slots);
  if (count > most || slotCount > most || header.textBytes > most ||
      header.whereBytes > most)
    return false;
  uint64_t needed = sizeof(header) + 8 * slotCount + 8 * count +
                    header.textBytes + 1 + header.whereBytes + 1;
  if (needed > header.bytes)
    return false;
  const char *at = bytes + sizeof(header);
  auto take = [&](auto &values, uint64_t size) {
    values.resize(size);
    uint64_t length = size * sizeof(values[0]);
    if (length) // an empty vector may have no address
      std::memcpy(values.data(), at, length);
    at += length;
  };
  take(slots, slotCount);
  take(kinds, count);
  take(shapes, count);
  take(text, header.textBytes);
  ++at;
  take(where, header.whereBytes);
  uint64_t components = 0;
  for (int32_t shape : shapes) {
    if (shape < 0)
      return false;
    components += static_cast<uint64_t>(shape);
  }
  return components == slotCount;
}

/// Replaces the first placeholder of the text by the first value if that is a
/// byte count, as in some messages of the device library.
void Record::placeByteCounts() {
  if (kinds.empty() || kinds[0] != TAI_DEVICE_VALUE_BYTES || shapes[0] != 1)
    return;
  size_t place = text.find("{}");
  if (place == std::string::npos)
    return;
  text.replace(place, 2, formatBytes(static_cast<int64_t>(slots[0])));
  kinds.erase(kinds.begin());
  shapes.erase(shapes.begin());
  slots.erase(slots.begin());
}

std::string Record::format() {
  placeByteCounts();
  std::string line =
      formatValues(text.c_str(), static_cast<int32_t>(kinds.size()),
                   kinds.data(), shapes.data(), slots.data());
  if (header.lostValues)
    line += " ... (" + std::to_string(header.lostValues) + " more values)";
  if (header.lostBytes)
    line += " ... (" + std::to_string(header.lostBytes) + " more characters)";
  return line;
}

Status mlir::tai::runtime::deviceWentOutOfRange(const std::string &evidence) {
  return Status::failure(
      StatusCode::Index,
      "a kernel used memory outside of its fields and arrays: an index that "
      "depends on data was out of range; ti.init(bounds=\"check\") names the "
      "line, the field and the index (" +
          evidence + ")");
}

static Status damaged() {
  return deviceWentOutOfRange("the state of the device is damaged");
}

Status mlir::tai::runtime::readDeviceReport(const TaiDeviceState &state,
                                            const void *output, uint64_t bytes,
                                            DeviceReport &report) {
  if (state.magic != TAI_DEVICE_STATE_MAGIC ||
      state.version != TAI_DEVICE_STATE_VERSION)
    return damaged();
  const char *at = static_cast<const char *>(output);
  uint64_t left = std::min(bytes, deviceOutputBytes(state));
  while (left) {
    Record line;
    if (!line.parse(at, left))
      return damaged();
    report.lines.push_back(line.format());
    at += line.header.bytes;
    left -= line.header.bytes;
  }
  report.lostLines = state.lostLines;
  report.stoppedBy = state.stopped;
  if (!state.failed)
    return Status::success();
  Record failure;
  if (!failure.parse(reinterpret_cast<const char *>(state.failure),
                     sizeof(state.failure)))
    return damaged();
  int32_t kind = failure.header.kind;
  StatusCode code = kind >= TAI_FAIL_ASSERT && kind <= TAI_FAIL_CHECK
                        ? static_cast<StatusCode>(kind)
                        : StatusCode::Internal;
  report.failure =
      Status::failure(code, failure.format(), std::move(failure.where));
  return Status::success();
}

static std::atomic<FailureNotice> noticeOfProcess{nullptr};

void mlir::tai::runtime::setFailureNotice(FailureNotice notice) {
  noticeOfProcess.store(notice, std::memory_order_release);
}

void mlir::tai::runtime::noticeDeviceFailure(const std::string &message) {
  if (FailureNotice notice = noticeOfProcess.load(std::memory_order_acquire))
    notice(message);
}
