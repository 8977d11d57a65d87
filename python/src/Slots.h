//===- Slots.h - Arguments of a launch --------------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_PYTHON_SLOTS_H
#define TAI_PYTHON_SLOTS_H

#include <cstddef>
#include <cstdint>
#include <vector>

namespace taipy {

/// The slots of a launch, on the stack unless there are many. Not static: a
/// launch may call Python code, which may launch in turn.
class Slots {
public:
  Slots() = default;
  Slots(const Slots &) = delete;
  Slots &operator=(const Slots &) = delete;

  void push_back(uint64_t slot) {
    if (__builtin_expect(count == capacity, false))
      grow();
    memory[count++] = slot;
  }
  void append(const std::vector<uint64_t> &more) {
    for (uint64_t slot : more)
      push_back(slot);
  }

  size_t size() const { return count; }
  const uint64_t *data() const { return memory; }
  uint64_t operator[](size_t i) const { return memory[i]; }
  uint64_t &operator[](size_t i) { return memory[i]; }
  const uint64_t *begin() const { return memory; }
  const uint64_t *end() const { return memory + count; }

private:
  void grow() {
    if (many.empty())
      many.assign(memory, memory + count);
    many.resize(2 * capacity);
    memory = many.data();
    capacity = many.size();
  }

  static constexpr size_t few = 32;
  size_t count = 0, capacity = few;
  uint64_t *memory = inPlace;
  uint64_t inPlace[few];
  std::vector<uint64_t> many;
};

} // namespace taipy

#endif // TAI_PYTHON_SLOTS_H
