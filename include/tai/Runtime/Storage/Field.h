//===- Field.h - Trees and fields on the host -------------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Trees and fields: memory and its description. The compiler determines the
// layout; the runtime gets it as a FieldLayout and uses it for host access
// only. Compiled kernels compute addresses themselves.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_STORAGE_FIELD_H
#define TAI_RUNTIME_STORAGE_FIELD_H

#include "tai/Runtime/Sparse/Sparse.h"
#include "tai/Support/Status.h"
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace mlir::tai::runtime {

class Field;
class Mirror;
struct OwedZeros;

/// Scalar types, with the numbers of TaiScalarType. i1 is stored as one byte.
enum class ScalarKind : uint8_t {
  I8 = 0,
  I16,
  I32,
  I64,
  F16,
  BF16,
  F32,
  F64,
  I1
};
int64_t byteSize(ScalarKind kind);
bool isFloat(ScalarKind kind);
const char *spelling(ScalarKind kind);

/// The memory of a tree, one allocation that is initially zero. Pages are
/// committed when first written. With a device, the tree has memory on the
/// device too, and either copy may be stale, so the host must access the
/// contents by `readable` and `writable`.
class Tree {
public:
  const std::string &name() const { return treeName; }
  /// The base address, which identifies the tree; null once it has been
  /// destroyed. Aligned to 64 bytes. The contents may be stale if there is a
  /// device.
  char *base() const { return cells.base; }
  /// Access to the current contents of the tree on the host, for reading, or
  /// for reading and writing. Valid until the next launch. If the device fails,
  /// a later call returns the failure.
  const char *readable() const {
    if (__builtin_expect(mirrored != nullptr, false))
      bringToHost();
    return cells.base;
  }
  char *writable() const {
    if (__builtin_expect(mirrored != nullptr, false))
      bringToHostToChange();
    return cells.base;
  }
  /// The tree's memory on the device; null if there is none.
  Mirror *mirror() const { return mirrored.get(); }
  int64_t bytes() const { return size; }
  /// The sparse levels of the tree, parents before children.
  const std::vector<std::unique_ptr<SparseNode>> &sparseNodes() const {
    return nodes;
  }
  /// True if other libraries have the address of the tree, so that they may
  /// write to it at any time.
  bool isExported() const {
    return exports.load(std::memory_order_relaxed) > 0;
  }
  /// The bytes of the active cells of the tree's innermost sparse levels.
  int64_t activeCellBytes() const {
    return cells.activeBytes.load(std::memory_order_relaxed);
  }
  /// True if new launches may use the tree.
  bool isThere() const {
    return cells.base && !isClosing.load(std::memory_order_acquire);
  }
  /// For exported buffers: the owners of the tree's memory on the host and on
  /// the device, which keep the memory when the tree is destroyed; and the
  /// count of exports.
  const std::shared_ptr<void> &sharedMemory() const { return memory; }
  const std::shared_ptr<Mirror> &sharedMirror() const { return mirrored; }
  void countExport(int by) {
    exports.fetch_add(by, std::memory_order_relaxed);
    if (by > 0)
      noteLent();
  }
  /// True if something outside of the runtime has ever had an address in the
  /// tree: the versions of its fields then say nothing.
  bool wasLent() const { return lent.load(std::memory_order_relaxed); }
  void noteLent() const { lent.store(true, std::memory_order_relaxed); }
  /// The tree with this base address.
  static Tree &of(void *base) { return *static_cast<Tree **>(base)[-1]; }

private:
  friend class TreeStore;
  void bringToHost() const;
  void bringToHostToChange() const;

  std::string treeName;
  std::shared_ptr<Mirror> mirrored;
  CellMemory cells;
  int64_t size = 0;
  int64_t charged = 0; // of the memory limit
  /// Owner of the tree's memory; exported buffers share the ownership.
  std::shared_ptr<void> memory;
  std::atomic<int> exports{0};
  mutable std::atomic<bool> lent{false};
  /// Set while the runtime checks whether the tree can be destroyed: new
  /// launches must not use the tree then.
  std::atomic<bool> isClosing{false};
  std::vector<std::unique_ptr<SparseNode>> nodes;
};
using TreePtr = std::shared_ptr<Tree>;

/// A level of the tree divides one index into digits:
///   digit = index / divisor % extent, and the address grows by digit * stride.
struct LayoutLevel {
  int64_t divisor;
  int64_t extent;
  int64_t stride; // bytes
  /// The weight of the digit in the number of the cell of the innermost sparse
  /// level.
  int64_t cells = 0;
};

/// The address function of a field in its tree: component c of element (i0, i1,
/// ...) is at
///   tree + placeOffset + sum over indices and levels of digit * stride
///        + c * componentStride.
struct FieldLayout {
  ScalarKind scalar = ScalarKind::F32;
  /// The shape of an element: empty for a scalar, one number for a vector, two
  /// for a matrix.
  std::vector<int64_t> elementShape;
  int64_t placeOffset = 0;
  /// Bytes from one component of an element to the next; 0 means the size of
  /// the scalar.
  int64_t componentStride = 0;
  /// For each index, in the order in which the field is indexed: the levels of
  /// the tree that divide its axis. The extent of the field along that index is
  /// the product of the extents of these levels.
  std::vector<std::vector<LayoutLevel>> indices;
  /// The first index of the field along each dimension; empty means all zeros.
  std::vector<int64_t> offset;
  /// The innermost sparse level above the place, by its number in the tree; or
  /// -1.
  int sparseNode = -1;
};

class Recorder;

/// The number of the calling thread; 0 if the thread has no number yet.
extern __thread uint64_t ownThreadNumber;
uint64_t numberThread();
/// The number of the calling thread, unique in the process and never reused.
inline uint64_t threadNumber() {
  return __builtin_expect(ownThreadNumber != 0, true) ? ownThreadNumber
                                                      : numberThread();
}

/// How a tape uses a field, from its first launch with it to the end of the
/// sweep. Tapes of several threads may all read the same field, or all add to
/// it.
enum class HoldKind : uint8_t { Read, Add, Write };
struct Hold {
  const Recorder *tape;
  uint64_t thread;
  HoldKind kind;
};
/// A summary of the tapes that use a field now; see Recordings.
struct FieldHolds {
  /// The thread of the tapes that hold the field, or 0; kManyThreads for
  /// several threads.
  std::atomic<uint64_t> holder{0};
  static constexpr uint64_t kManyThreads = UINT64_MAX;
  std::vector<Hold> all;
};

class Field {
public:
  const std::string &name() const { return fieldName; }
  const FieldLayout &layout() const { return fieldLayout; }
  ScalarKind scalar() const { return fieldLayout.scalar; }
  int rank() const { return static_cast<int>(shapeOf.size()); }
  const std::vector<int64_t> &shape() const { return shapeOf; }
  const std::vector<int64_t> &elementShape() const {
    return fieldLayout.elementShape;
  }
  int64_t numElements() const { return elements; }
  /// The number of components of one element.
  int64_t numComponents() const { return components; }
  /// The first index of the field along a dimension.
  int64_t firstIndex(int64_t dimension) const {
    return fieldLayout.offset.empty() ? 0 : fieldLayout.offset[dimension];
  }
  /// The bytes of a row-major host array with all elements of the field.
  int64_t hostBytes() const {
    return elements * components * byteSize(fieldLayout.scalar);
  }
  const Tree &tree() const { return *owner; }
  const TreePtr &sharedTree() const { return owner; }
  /// False once the tree that holds the field has been destroyed.
  bool valid() const { return owner->base() != nullptr; }
  /// True if the elements of the field are contiguous in row-major order.
  bool contiguous() const { return isContiguous; }
  /// The distance in bytes between consecutive elements if elements are dense
  /// and have a uniform stride in row-major order, else 0.
  int64_t evenStep() const { return elementStep; }
  /// The address of the first element of the field; see Tree::base().
  char *data() const { return owner->base() + fieldLayout.placeOffset; }
  /// The address of the first element, for reading or for changing the current
  /// contents; see Tree::readable.
  const char *readable() const {
    settleZeros();
    return owner->readable() + fieldLayout.placeOffset;
  }
  char *writable() const {
    settleZeros();
    return owner->writable() + fieldLayout.placeOffset;
  }

  /// owesZeros: true if this is an adjoint field of which some elements are
  /// zero, but the zeros are not stored yet. See OwedZeros.h.
  bool owesZeros() const {
    return __builtin_expect(owes.load(std::memory_order_acquire), false);
  }
  std::shared_ptr<const OwedZeros> owedZeros() const;
  void oweZeros(std::shared_ptr<const OwedZeros> zeros) const;
  /// Stores the owed zeros of the field. Must be called before any access to
  /// the elements; returns when the zeros are stored, whichever thread stores
  /// them.
  void settleZeros() const {
    if (owesZeros())
      storeZeros();
  }

  /// The field that accumulates the derivative of the loss with respect to this
  /// field, or null.
  Field *adjoint() const { return adjointField.get(); }
  const std::shared_ptr<Field> &sharedAdjoint() const { return adjointField; }
  Field *dual() const { return dualField.get(); }
  /// True if this field is the adjoint field of another field.
  bool isAdjoint() const { return ofPrimal; }

  /// For an adjoint field: true if any element may be non-zero.
  bool dirty() const { return dirtiedBy() != 0 || owner->isExported(); }
  void markDirty() {
    uint64_t self = threadNumber();
    if (dirtiedBy() != self)
      lastWriter.store(self, std::memory_order_relaxed);
  }
  /// The number of the thread that wrote the field last, or 0 if the field has
  /// been set to zero since.
  uint64_t dirtiedBy() const {
    return lastWriter.load(std::memory_order_relaxed);
  }
  /// Notes that the field has been set to zero.
  void markClean() { lastWriter.store(0, std::memory_order_relaxed); }
  /// True if a thread other than the calling thread wrote the field last.
  bool isDirtiedByOther() const {
    uint64_t writer = dirtiedBy();
    return writer != 0 && writer != threadNumber();
  }
  /// For an adjoint field: true if the last reverse sweep stored all elements
  /// before it read any. If the field is clean as well, its memory may hold old
  /// numbers until the next sweep: then it owes all zeros.
  bool isStoredFirst() const {
    return lastSweep.load(std::memory_order_relaxed) == LastSweep::StoredFirst;
  }
  void setStoredFirst(bool on) {
    lastSweep.store(on ? LastSweep::StoredFirst : LastSweep::Other,
                    std::memory_order_relaxed);
  }
  /// The number of changes that the host has made to the field.
  uint64_t version() const { return hostVersion; }
  void countChange() {
    ++hostVersion;
    countWrite();
  }
  /// The number of writes to the field, by the host or by launches; those of
  /// launches count only if Launcher::countWrites() has been called before.
  uint64_t numWrites() const { return writes.load(std::memory_order_relaxed); }
  void countWrite() const { writes.fetch_add(1, std::memory_order_relaxed); }
  /// The tapes that use the field at present.
  FieldHolds holds;

  /// The innermost sparse level above the field, or null.
  SparseNode *sparseNode() const {
    return fieldLayout.sparseNode < 0
               ? nullptr
               : owner->sparseNodes()[fieldLayout.sparseNode].get();
  }
  /// The number of the cell of the level sparseNode() that holds the element,
  /// or -1 if an index is out of range.
  int64_t cellNumber(const int64_t *index) const;

  /// The offset of the element in the tree, or -1 if an index is out of range.
  /// Indices start at the offset of the field.
  int64_t elementOffset(const int64_t *index) const;

  /// Access one component (row-major) of one element, converted from or to the
  /// type of the field. Integers wrap, as in C; writing marks the field as
  /// dirty. Not recorded by tapes: see HostWrites::writeF64.
  Status readF64(const int64_t *index, int64_t component, double &value) const;
  Status writeF64(const int64_t *index, int64_t component, double value);
  Status readI64(const int64_t *index, int64_t component, int64_t &value) const;
  Status writeI64(const int64_t *index, int64_t component, int64_t value);
  /// Reads all components of the elements at `count` index tuples, in the type
  /// of the field. HostWrites::writeElements writes elements.
  Status readElements(const int64_t *indices, int64_t count,
                      void *values) const;
  /// Computes the offset in the tree of one component of one element. Fails if
  /// an index or the component is out of range.
  Status locate(const int64_t *index, int64_t component, int64_t &offset) const;
  /// Load or store one component, at an offset that `locate` has computed.
  Status loadBytes(int64_t offset, void *to) const {
    settleZeros();
    if (__builtin_expect(owner->mirror() != nullptr, false))
      return loadMirrored(offset, to);
    std::memcpy(to, owner->base() + offset,
                static_cast<size_t>(byteSize(fieldLayout.scalar)));
    return Status::success();
  }
  Status storeBytes(int64_t offset, const void *from) const {
    countWrite();
    settleZeros();
    if (__builtin_expect(owner->mirror() != nullptr, false))
      return storeMirrored(offset, from);
    std::memcpy(owner->base() + offset, from,
                static_cast<size_t>(byteSize(fieldLayout.scalar)));
    return Status::success();
  }

private:
  friend class TreeStore;

  Status loadMirrored(int64_t offset, void *to) const;
  Status storeMirrored(int64_t offset, const void *from) const;
  void storeZeros() const;

  std::string fieldName;
  TreePtr owner;
  FieldLayout fieldLayout;
  std::vector<int64_t> shapeOf;
  int64_t elements = 1;
  int64_t components = 1;
  bool isContiguous = false;
  int64_t elementStep = 0;
  bool ofPrimal = false;
  std::string adjointName, dualName;
  std::shared_ptr<Field> adjointField, dualField;
  std::atomic<uint64_t> lastWriter{0};
  /// How the last reverse sweep that used an adjoint field began with it.
  enum class LastSweep : uint8_t { Other, StoredFirst };
  std::atomic<LastSweep> lastSweep{LastSweep::Other};
  /// The zeros of the field that are not stored yet, guarded by one mutex for
  /// all fields; and a flag that tells whether there are any.
  mutable std::shared_ptr<const OwedZeros> owed;
  mutable std::atomic<bool> owes{false};
  uint64_t hostVersion = 0;
  mutable std::atomic<uint64_t> writes{0};
};
using FieldPtr = std::shared_ptr<Field>;

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_STORAGE_FIELD_H
