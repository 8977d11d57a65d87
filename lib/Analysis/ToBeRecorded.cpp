//===- ToBeRecorded.cpp - To-be-recorded (TBR) analysis -------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Analysis/ToBeRecorded.h"
#include "mlir/Dialect/MemRef/IR/MemRef.h"
#include "mlir/IR/SymbolTable.h"
#include "tai/Analysis/ZeroAdjoints.h"
#include "llvm/ADT/SetVector.h"
#include "llvm/ADT/StringExtras.h"
#include "llvm/Support/Endian.h"

using namespace mlir;
using namespace mlir::tai;

//===----------------------------------------------------------------------===//
// Analysis
//===----------------------------------------------------------------------===//

/// Finds the loads that determine which elements the stores of a kernel reach.
/// The form of the adjoint that sets adjoints of overwritten elements to zero
/// executes these loads too.
static SetVector<Operation *> findLoadsBehindStores(KernelOp kernel) {
  SetVector<Operation *> slice, loads;
  auto addValues = [&](ValueRange values) {
    for (Value value : values) {
      if (Operation *op = value.getDefiningOp())
        slice.insert(op);
      else if (Operation *owner =
                   cast<BlockArgument>(value).getOwner()->getParentOp())
        if (owner != kernel)
          slice.insert(owner);
    }
  };
  auto addParents = [&](Operation *op) {
    for (Operation *parent = op->getParentOp(); parent != kernel;
         parent = parent->getParentOp())
      addValues(parent->getOperands());
  };
  kernel.walk([&](StoreOp store) {
    addValues(store.getIndices());
    addValues(store.getComponents());
    addParents(store);
  });
  kernel.walk([&](memref::StoreOp store) {
    addValues(store.getIndices());
    addParents(store);
  });
  for (size_t i = 0; i < slice.size(); ++i) {
    Operation *op = slice[i];
    if (isa<LoadOp, memref::LoadOp>(op))
      loads.insert(op);
    addValues(op->getOperands());
    addParents(op);
    // The result of a loop or branch may depend on any operation within it.
    for (Region &region : op->getRegions())
      region.walk([&](Operation *inner) { slice.insert(inner); });
  }
  return loads;
}

/// True if the elements of an array argument may be read: it has uses other
/// than queries of its extents and stores to it.
static bool mayBeRead(Value array) {
  return llvm::any_of(array.getUses(), [&](OpOperand &use) {
    if (auto store = dyn_cast<memref::StoreOp>(use.getOwner()))
      return store.getValueToStore() == array;
    return !isa<memref::DimOp>(use.getOwner());
  });
}

/// Returns the slots of the arrays of `kernel` that its adjoint or the given
/// `loads` read. If `adjoint` is null, the slots of all arrays that the kernel
/// reads.
static std::vector<int64_t> findArraysRead(KernelOp kernel, KernelOp adjoint,
                                           ArrayRef<Operation *> loads) {
  std::vector<int64_t> arrays;
  int64_t slot = 0;
  KernelOp reader = adjoint ? adjoint : kernel;
  for (auto [i, argument] : llvm::enumerate(kernel.getBody().getArguments())) {
    Value array = argument;
    bool isLoaded = llvm::any_of(loads, [&](Operation *op) {
      auto load = dyn_cast<memref::LoadOp>(op);
      return load && load.getMemRef() == array;
    });
    if (isa<MemRefType>(argument.getType()) &&
        (isLoaded || mayBeRead(reader.getBody().getArgument(i))))
      arrays.push_back(slot);
    slot += countSlots(argument.getType());
  }
  return arrays;
}

ToBeRecorded mlir::tai::findToBeRecorded(ModuleOp module, StringRef name) {
  ToBeRecorded found;
  auto add = [&](std::vector<NamedAccess> accesses) {
    for (NamedAccess &access : accesses)
      if (access.kind == runtime::AccessKind::Read &&
          !llvm::is_contained(found.reads, access))
        found.reads.push_back(std::move(access));
  };
  auto kernel = module.lookupSymbol<KernelOp>(name);
  if (!kernel)
    return found;
  for (KernelOp part : module.getOps<KernelOp>()) {
    if (part.getPartOf() != name)
      continue;
    llvm::raw_string_ostream stream(found.parts);
    module->print(stream, OpPrintingFlags().enableDebugInfo().assumeVerified());
    found.arrays = findArraysRead(kernel, nullptr, {});
    return found;
  }
  SetVector<Operation *> loads = findLoadsBehindStores(kernel);
  for (Operation *load : loads)
    if (isa<LoadOp>(load))
      add(listAccesses(load));
  auto adjoint = kernel.getAdjoint()
                     ? module.lookupSymbol<KernelOp>(*kernel.getAdjoint())
                     : KernelOp();
  if (!adjoint)
    return found;
  add(listAccesses(adjoint));
  found.arrays = findArraysRead(kernel, adjoint, loads.getArrayRef());
  adjoint.walk([&](Operation *op) {
    if (!isa<IsActiveOp, LengthOp>(op))
      return;
    StringRef field =
        cast<FieldAccessOpInterface>(op).getFieldAttr().getValue();
    if (!llvm::is_contained(found.activity, field))
      found.activity.push_back(field.str());
  });
  found.flags = findLoopFlags(kernel, adjoint);
  for (Operation &helper : *module.getBody())
    if (!isa<KernelOp>(helper))
      add(listAccesses(&helper));
  if (FlatSymbolRefAttr name = adjoint.getStoredFormAttr()) {
    found.loadsStored = true;
    for (NamedAccess &access :
         listAccesses(module.lookupSymbol<KernelOp>(name)))
      if (access.kind == runtime::AccessKind::Read &&
          !llvm::is_contained(found.reads, access))
        found.stored.push_back(std::move(access));
  }
  if (ArrayAttr names = adjoint.getReadsBeforeAttr())
    for (auto field : names.getAsRange<FlatSymbolRefAttr>())
      if (!llvm::is_contained(found.before, field.getValue()))
        found.before.push_back(field.getValue().str());
  found.reexecutes = adjoint.getReexecutes();
  return found;
}

//===----------------------------------------------------------------------===//
// Bytes
//===----------------------------------------------------------------------===//

namespace {
class Writer {
public:
  void add(int64_t number) {
    char buffer[8];
    llvm::support::endian::write64le(buffer, static_cast<uint64_t>(number));
    bytes.append(buffer, sizeof(buffer));
  }
  void add(StringRef text) {
    add(static_cast<int64_t>(text.size()));
    bytes.append(text.data(), text.size());
  }
  std::string bytes;
};

/// Reads the bytes of a serialized ToBeRecorded; `ok` says in the end whether
/// they were complete.
class Reader {
public:
  explicit Reader(StringRef bytes) : bytes(bytes) {}
  int64_t number() {
    if (bytes.size() < 8) {
      ok = false;
      bytes = {};
      return 0;
    }
    auto value =
        static_cast<int64_t>(llvm::support::endian::read64le(bytes.data()));
    bytes = bytes.drop_front(8);
    return value;
  }
  /// Reads the length of a list. Fails unless the rest of the bytes can hold
  /// this many entries of at least eight bytes.
  int64_t length() {
    int64_t value = number();
    if (value < 0 || value > static_cast<int64_t>(bytes.size() / 8)) {
      ok = false;
      return 0;
    }
    return value;
  }
  std::string text() {
    int64_t size = number();
    if (size < 0 || size > static_cast<int64_t>(bytes.size())) {
      ok = false;
      return "";
    }
    std::string result = bytes.take_front(size).str();
    bytes = bytes.drop_front(size);
    return result;
  }
  bool ok = true;
  bool atEnd() const { return bytes.empty(); }

private:
  StringRef bytes;
};
} // namespace

static void addReads(Writer &writer, const std::vector<NamedAccess> &reads) {
  writer.add(static_cast<int64_t>(reads.size()));
  for (const NamedAccess &access : reads) {
    writer.add(access.field);
    writer.add(static_cast<int64_t>(access.fixed.size()));
    for (const runtime::FixedIndex &fixed : access.fixed) {
      writer.add(fixed.dimension);
      writer.add(fixed.constant);
      writer.add(fixed.bits);
      writer.add(static_cast<int64_t>(fixed.terms.size()));
      for (const runtime::LaunchTerm &term : fixed.terms) {
        writer.add(term.slot);
        writer.add(term.bits);
        writer.add(term.factor);
      }
    }
  }
}

std::string ToBeRecorded::serialize() const {
  Writer writer;
  addReads(writer, reads);
  writer.add(static_cast<int64_t>(loadsStored));
  addReads(writer, stored);
  writer.add(static_cast<int64_t>(before.size()));
  for (const std::string &field : before)
    writer.add(field);
  writer.add(static_cast<int64_t>(activity.size()));
  for (const std::string &field : activity)
    writer.add(field);
  writer.add(static_cast<int64_t>(flags.size()));
  for (const LoopFlags &loop : flags) {
    writer.add(loop.field);
    writer.add(static_cast<int64_t>(loop.sumsUp));
    writer.add(static_cast<int64_t>(loop.sources.size()));
    for (const std::string &source : loop.sources)
      writer.add(source);
  }
  writer.add(static_cast<int64_t>(arrays.size()));
  for (int64_t slot : arrays)
    writer.add(slot);
  writer.add(static_cast<int64_t>(reexecutes));
  writer.add(parts);
  return std::move(writer.bytes);
}

static void takeReads(Reader &reader, std::vector<NamedAccess> &reads) {
  for (int64_t i = reader.length(); i > 0; --i) {
    NamedAccess access{reader.text(), runtime::AccessKind::Read, {}};
    for (int64_t f = reader.length(); f > 0; --f) {
      int64_t dimension = reader.number();
      runtime::FixedIndex fixed{
          dimension, reader.number(), {}, reader.number()};
      reader.ok &= dimension >= 0;
      auto isWidth = [](int64_t bits) { return bits >= 1 && bits <= 64; };
      reader.ok &= isWidth(fixed.bits);
      for (int64_t t = reader.length(); t > 0; --t) {
        int64_t slot = reader.number();
        int64_t bits = reader.number();
        reader.ok &= isWidth(bits);
        fixed.terms.push_back({slot, bits, reader.number()});
      }
      access.fixed.push_back(std::move(fixed));
    }
    reads.push_back(std::move(access));
  }
}

std::optional<ToBeRecorded> ToBeRecorded::deserialize(StringRef bytes) {
  ToBeRecorded found;
  Reader reader(bytes);
  takeReads(reader, found.reads);
  found.loadsStored = reader.number() != 0;
  takeReads(reader, found.stored);
  for (int64_t i = reader.length(); i > 0; --i)
    found.before.push_back(reader.text());
  for (int64_t i = reader.length(); i > 0; --i)
    found.activity.push_back(reader.text());
  for (int64_t i = reader.length(); i > 0; --i) {
    LoopFlags loop{reader.text(), {}, reader.number() != 0};
    for (int64_t s = reader.length(); s > 0; --s)
      loop.sources.push_back(reader.text());
    found.flags.push_back(std::move(loop));
  }
  for (int64_t i = reader.length(); i > 0; --i)
    found.arrays.push_back(reader.number());
  found.reexecutes = reader.number() != 0;
  found.parts = reader.text();
  if (!reader.ok || !reader.atEnd())
    return std::nullopt;
  return found;
}
