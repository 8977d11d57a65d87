//===- DeviceState.h - Failures and output of device code -------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The state of a device, in its memory, in C: failures and printed lines, which
// device code writes and the host reads when it waits for the device (see
// DeviceReport.h). The functions of Abi.h that device code calls get the
// address of the state as their frame. Host and device use the same offsets.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_ABI_DEVICESTATE_H
#define TAI_ABI_DEVICESTATE_H

#include <stdint.h>

#define TAI_DEVICE_STATE_MAGIC 0x74616964u
#define TAI_DEVICE_STATE_VERSION 1u

/// The maximum size in bytes of a message of a kernel; a longer message is
/// truncated, and says how much was cut off.
#define TAI_DEVICE_RECORD_BYTES 2048u

/// A further TaiValueKind, which only occurs in records of device code: a
/// number of bytes, printed with a unit.
#define TAI_DEVICE_VALUE_BYTES 64

#ifdef __cplusplus
extern "C" {
#endif

/// A failure or a printed line: this header, `slots` slots of eight bytes,
/// `count` kinds and `count` shapes of four bytes, the text, the place. Text
/// and place end with a zero, which their lengths do not count. The size is a
/// multiple of eight bytes.
typedef struct TaiDeviceRecord {
  /// The size of the record in bytes.
  uint32_t bytes;
  /// The TaiFailure that the record reports; 0 if the record is a printed line.
  int32_t kind;
  int32_t count;
  int32_t slots;
  uint32_t textBytes;
  uint32_t whereBytes;
  /// The number of values, and the number of characters of the text and of the
  /// place, that were cut off because the record was too long.
  uint32_t lostValues;
  uint32_t lostBytes;
} TaiDeviceRecord;

/// Followed in memory by `outputCapacity` bytes for the records of lines.
typedef struct TaiDeviceState {
  uint32_t magic;
  uint32_t version;
  /// Non-zero once a thread has claimed the member `failure`, to write the
  /// first failure.
  uint32_t failed;
  /// The number of printed lines that were dropped because the buffer was full.
  uint32_t lostLines;
  uint64_t outputCapacity;
  /// Bytes of the output buffer claimed so far; claims that did not fit count
  /// as well, so this may exceed the capacity.
  uint64_t outputUsed;
  /// The end of the printed records that fit into the buffer, if more bytes
  /// than its capacity were claimed.
  uint64_t outputEnd;
  /// The maximum size in bytes of a stack (TaiStack).
  uint64_t stackLimit;
  /// State of tai_dev_grid_barrier: the number of blocks that have arrived, and
  /// the number of the barrier.
  uint32_t barrier[2];
  /// Non-zero while kernels are asked to stop: the number of the host thread
  /// that asks.
  uint32_t stop;
  /// The value of `stop` that made a device thread exit; 0 if none has.
  uint32_t stopped;
  /// The record (TaiDeviceRecord) of the first failure.
  uint64_t failure[TAI_DEVICE_RECORD_BYTES / 8];
} TaiDeviceState;

#ifdef __cplusplus
} // extern "C"

static_assert(sizeof(TaiDeviceRecord) == 32 &&
                  sizeof(TaiDeviceState) == 64 + TAI_DEVICE_RECORD_BYTES,
              "both sides know these by their offsets");
#endif

#endif // TAI_ABI_DEVICESTATE_H
