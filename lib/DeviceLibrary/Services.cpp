//===- Services.cpp - Random numbers, failures, output, stacks ------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// The functions of tai/ABI/Abi.h that device code calls. Their frame is the
// device state. Rare paths are out of line, so that they cost kernels neither
// registers nor code.
//
//===----------------------------------------------------------------------===//

#include "Target.h"
#include "tai/ABI/Abi.h"
#include "tai/ABI/DeviceAbi.h"
#include "tai/ABI/DeviceState.h"
#include "tai/Support/Philox.h"

using namespace tai::device;

#define TAI_RARE __attribute__((noinline, cold))

static TaiDeviceState &stateOf(TaiFrame *frame) {
  return *reinterpret_cast<TaiDeviceState *>(frame);
}

uint32_t tai_rt_random_u32(uint64_t seed, uint64_t launch, uint64_t iteration,
                           uint32_t stream, uint32_t sequence) {
  return mlir::tai::runtime::randomBits(seed, launch, iteration, stream,
                                        sequence);
}

//===----------------------------------------------------------------------===//
// Records
//===----------------------------------------------------------------------===//

static uint32_t lengthOf(const char *text) {
  uint32_t length = 0;
  if (text)
    while (text[length])
      ++length;
  return length;
}

static uint32_t least(uint32_t a, uint32_t b) { return a < b ? a : b; }

/// Copies a string of `length` characters, appends a zero, and returns the end.
static char *putText(char *to, const char *text, uint32_t length) {
  for (uint32_t i = 0; i < length; ++i)
    *to++ = text[i];
  *to++ = 0;
  return to;
}

namespace {
/// The contents of a record: a failure or a printed line.
struct Content {
  int32_t kind;
  const char *text, *where;
  int32_t count;
  const int32_t *kinds, *shapes;
  const uint64_t *slots;

  TaiDeviceRecord measure() const;
  void write(const TaiDeviceRecord &header, void *to) const;
  int32_t shapeOf(int32_t value) const { return shapes ? shapes[value] : 1; }
};
} // namespace

/// Computes the header of the record from the parts that fit in it. Values come
/// first, then the place, then the text.
TaiDeviceRecord Content::measure() const {
  uint32_t left = TAI_DEVICE_RECORD_BYTES - sizeof(TaiDeviceRecord) - 2;
  // The number of bytes of a message that are reserved for the place and the
  // text, and that values must not use.
  constexpr uint32_t textReserve = 256;
  TaiDeviceRecord header = {};
  header.kind = kind;
  for (int32_t value = 0; value < count; ++value) {
    auto components = static_cast<uint32_t>(shapeOf(value));
    uint32_t bytes = 8 * components + 8;
    if (bytes + textReserve > left) {
      header.lostValues = static_cast<uint32_t>(count - value);
      break;
    }
    left -= bytes;
    header.slots += static_cast<int32_t>(components);
    ++header.count;
  }
  uint32_t textLength = lengthOf(text), whereLength = lengthOf(where);
  uint32_t reserve = least(textLength, textReserve / 2);
  header.whereBytes = least(whereLength, left - reserve);
  header.textBytes = least(textLength, left - header.whereBytes);
  header.lostBytes =
      whereLength - header.whereBytes + textLength - header.textBytes;
  uint32_t bytes = static_cast<uint32_t>(sizeof(TaiDeviceRecord)) +
                   8 * static_cast<uint32_t>(header.slots + header.count) +
                   header.textBytes + header.whereBytes + 2;
  header.bytes = (bytes + 7) / 8 * 8;
  return header;
}

void Content::write(const TaiDeviceRecord &header, void *to) const {
  auto *record = static_cast<TaiDeviceRecord *>(to);
  *record = header;
  // The host fetches whole words, so set the last word of the record to zero,
  // which includes its padding.
  reinterpret_cast<uint64_t *>(to)[header.bytes / 8 - 1] = 0;
  auto *slot = reinterpret_cast<uint64_t *>(record + 1);
  for (int32_t i = 0; i < header.slots; ++i)
    *slot++ = slots[i];
  auto *number = reinterpret_cast<int32_t *>(slot);
  for (int32_t i = 0; i < header.count; ++i)
    *number++ = kinds[i];
  for (int32_t i = 0; i < header.count; ++i)
    *number++ = shapeOf(i);
  char *at = putText(reinterpret_cast<char *>(number), text, header.textBytes);
  putText(at, where, header.whereBytes);
}

TAI_RARE void tai_rt_fail(TaiFrame *frame, int32_t failure, const char *message,
                          const char *where, int32_t count,
                          const int32_t *kinds, const int32_t *shapes,
                          const uint64_t *slots) {
  TaiDeviceState &state = stateOf(frame);
  uint32_t seen = atomicRead(&state.failed);
  // Repeat while `seen` is zero: a compare-and-exchange can fail although the
  // word has the expected value.
  while (!seen)
    if (atomicReplace(&state.failed, seen, uint32_t(1))) {
      Content content{failure, message, where, count, kinds, shapes, slots};
      content.write(content.measure(), state.failure);
      return;
    }
}

int32_t tai_rt_failed(TaiFrame *frame) {
  return static_cast<int32_t>(atomicRead(&stateOf(frame).failed));
}

TAI_RARE void tai_rt_print(TaiFrame *frame, const char *format, int32_t count,
                           const int32_t *kinds, const int32_t *shapes,
                           const uint64_t *slots) {
  TaiDeviceState &state = stateOf(frame);
  Content content{0, format, nullptr, count, kinds, shapes, slots};
  TaiDeviceRecord header = content.measure();
  uint64_t place = atomicAdd(&state.outputUsed, uint64_t(header.bytes));
  if (place + header.bytes <= state.outputCapacity) {
    content.write(header, reinterpret_cast<char *>(&state + 1) + place);
    return;
  }
  // At most one record begins before the end of the buffer and does not fit:
  // all later records begin after the end.
  if (place <= state.outputCapacity)
    state.outputEnd = place;
  atomicAdd(&state.lostLines, uint32_t(1));
}

//===----------------------------------------------------------------------===//
// Stacks
//===----------------------------------------------------------------------===//

static char *inlineSlots(TaiStack *stack) {
  return reinterpret_cast<char *>(stack + 1);
}

/// Fails for lack of memory, with the message `text`, which names `bytes`.
static TAI_RARE void failFor(TaiFrame *frame, uint64_t bytes, const char *text,
                             const char *where) {
  int32_t kind = TAI_DEVICE_VALUE_BYTES;
  tai_rt_fail(frame, TAI_FAIL_MEMORY, text, where, 1, &kind, nullptr, &bytes);
}

static const char tooManyValues[] =
    "out of memory: a gradient records more than {} of values in one iteration";

TAI_RARE void tai_rt_stack_grow_at(TaiFrame *frame, TaiStack *stack,
                                   const char *text, const char *where) {
  auto bytes = static_cast<uint64_t>(stack->capacity) * sizeof(uint64_t);
  bool isTooLarge = bytes > stateOf(frame).stackLimit / 2;
  void *larger = isTooLarge ? nullptr : allocateBytes(2 * bytes);
  if (!larger) {
    if (isTooLarge)
      failFor(frame, bytes, tooManyValues, where);
    else
      failFor(frame, 2 * bytes, text, where);
    stack->size = 0;
    return;
  }
  auto *from = reinterpret_cast<const uint64_t *>(stack->slots);
  auto *to = static_cast<uint64_t *>(larger);
  for (int64_t i = 0; i < stack->capacity; ++i)
    to[i] = from[i];
  tai_rt_stack_free(stack);
  stack->slots = static_cast<char *>(larger);
  stack->capacity *= 2;
}

TAI_RARE void tai_rt_stack_grow(TaiFrame *frame, TaiStack *stack) {
  tai_rt_stack_grow_at(frame, stack, tooManyValues, "");
}

TAI_RARE void tai_rt_stack_free(TaiStack *stack) {
  if (stack->slots != inlineSlots(stack))
    freeBytes(stack->slots);
}

//===----------------------------------------------------------------------===//
// Memory of a thread
//===----------------------------------------------------------------------===//

/// The address that an allocation of zero bytes returns. It is not null.
static void *const noBytes = reinterpret_cast<void *>(alignof(uint64_t));

__attribute__((noinline)) void *tai_rt_local_alloc(TaiFrame *frame,
                                                   uint64_t bytes,
                                                   const char *text,
                                                   const char *where) {
  if (bytes == 0)
    return noBytes;
  void *memory = allocateBytes(bytes);
  if (!memory)
    failFor(frame, bytes, text, where);
  return memory;
}

__attribute__((noinline)) void tai_rt_local_free(void *memory) {
  if (memory && memory != noBytes)
    freeBytes(memory);
}

//===----------------------------------------------------------------------===//
// Loops that may be long
//===----------------------------------------------------------------------===//

TAI_RARE void *tai_rt_go_on(TaiFrame *frame, int32_t) {
  TaiDeviceState &state = stateOf(frame);
  uint32_t who = lookAt(&state.stop);
  if (!who)
    return &state;
  state.stopped = who;
  return nullptr;
}
