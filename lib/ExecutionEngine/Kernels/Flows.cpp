//===- Flows.cpp - Data flow of floats ------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A tape warns if a derivative is lost in a field or an array without gradient,
// and forward mode warns if a derivative is lost in a field without dual. So
// the data flow from each read to each store of floats is tracked, through ops
// that carry derivatives, whether the fields have gradients or not.
//
//===----------------------------------------------------------------------===//

#include "tai/AD/Signature.h"
#include "tai/Analysis/AccessOrder.h"
#include "tai/Analysis/KernelAccesses.h"
#include "tai/Analysis/ValueFlows.h"
#include "tai/CodeGen/Diagnostics.h"
#include "tai/ExecutionEngine/Kernels/Summaries.h"
#include "tai/Support/Places.h"
#include "llvm/ADT/SmallBitVector.h"

using namespace mlir;
using namespace mlir::tai;

/// Returns the name of a kernel argument in the source program.
static std::string getName(BlockArgument argument) {
  if (auto name = argument.getLoc()->findInstanceOf<NameLoc>())
    return name.getName().str();
  return std::to_string(argument.getArgNumber());
}

namespace {
/// The numbered ends of data flows of a kernel: fields, arrays and results.
class PlaceList {
public:
  PlaceList(KernelOp kernel, ArrayRef<runtime::Access> summary,
            const AdjointSignature &signature)
      : kernel(kernel), summary(summary), signature(signature) {}

  /// The number of the place of a storage; nullopt for fields that are not in
  /// the summary, for buffers of the kernel, and for the gradients of arrays.
  std::optional<size_t> find(Storage storage) {
    auto [entry, isNew] = numbers.try_emplace(storage.getOpaque());
    if (isNew)
      if (std::optional<runtime::FlowPlace> place = make(storage)) {
        entry->second = places.size();
        places.push_back(std::move(*place));
      }
    return entry->second;
  }
  size_t addResult() {
    runtime::FlowPlace place;
    place.isResult = true;
    places.push_back(std::move(place));
    return places.size() - 1;
  }

  std::vector<runtime::FlowPlace> places;

private:
  std::optional<runtime::FlowPlace> make(Storage storage) {
    runtime::FlowPlace place;
    if (storage.field) {
      for (const runtime::Access &access : summary)
        if (access.field->name() == storage.field.getValue())
          place.field = access.field;
      if (!place.field)
        return std::nullopt;
      place.name = place.field->name();
      return place;
    }
    auto argument = dyn_cast<BlockArgument>(storage.memref);
    if (!argument || argument.getOwner() != &kernel.getBody().front())
      return std::nullopt;
    place.name = getName(argument);
    // An argument that is the gradient of an array is no place of its own in
    // the data flow, because gradients follow their arrays.
    if (StringRef(place.name).ends_with(".grad"))
      return std::nullopt;
    unsigned number = argument.getArgNumber();
    const auto *wanted = llvm::find(signature.arguments, number);
    place.hasGradient = wanted != signature.arguments.end();
    auto array = dyn_cast<MemRefType>(argument.getType());
    if (!array)
      return place;
    place.slot = countSlots(kernel.getArgumentTypes().take_front(number));
    place.rank = array.getRank();
    place.elementBytes = array.getElementTypeBitWidth() / 8;
    place.boxes = findStoredBoxes(kernel, argument);
    if (place.hasGradient) {
      auto shadows = signature.getShadowTypes(kernel);
      auto before = ArrayRef(shadows).take_front(
          std::distance(signature.arguments.begin(), wanted));
      place.adjointSlot = countSlots(kernel.getArgumentTypes()) +
                          countSlots(SmallVector<Type>(before));
    }
    return place;
  }

  KernelOp kernel;
  ArrayRef<runtime::Access> summary;
  const AdjointSignature &signature;
  DenseMap<const void *, std::optional<size_t>> numbers;
};
} // namespace

runtime::KernelFlows mlir::tai::findFlows(KernelOp kernel,
                                          ArrayRef<runtime::Access> summary) {
  FailureOr<AdjointSignature> signature =
      AdjointSignature::get(kernel, /*arrays=*/false);
  if (failed(signature))
    return {};
  SmallVector<Value> numbers;
  for (unsigned position : signature->arguments)
    if (Value argument = kernel.getArgument(position);
        !isa<MemRefType>(argument.getType()))
      numbers.push_back(argument);
  ValueFlows flows(kernel, numbers);
  PlaceList list(kernel, summary, *signature);
  runtime::KernelFlows found;
  auto add = [&](Value value, std::optional<size_t> to, Location loc,
                 bool isReadAgain) {
    const llvm::SmallBitVector sources = flows.sourcesOf(value);
    for (unsigned source : sources.set_bits()) {
      std::optional<size_t> from = list.find(flows.storages[source]);
      if (from && to)
        found.flows.push_back({*from, *to, describePlace(loc), isReadAgain});
    }
  };
  for (DifferentiableAccessInterface write : flows.writes) {
    bool isReadAgain =
        llvm::any_of(flows.reads, [&](DifferentiableAccessInterface read) {
          return read.getAccessedStorage() == write.getAccessedStorage() &&
                 mayReachLater(write, read);
        });
    add(write.getAccessedValue(), list.find(write.getAccessedStorage()),
        write->getLoc(), isReadAgain);
  }
  kernel.walk([&](ReturnOp end) {
    std::optional<size_t> result;
    for (Value value : end->getOperands())
      if (isFloatOrVector(value.getType())) {
        if (!result)
          result = list.addResult();
        add(value, result, end.getLoc(), false);
      }
  });
  // Arrays that the kernel overwrites without reading them are also listed as
  // places of the data flow.
  for (BlockArgument argument : kernel.getArguments())
    if (auto array = dyn_cast<MemRefType>(argument.getType()))
      if (isFloatOrVector(array.getElementType()))
        (void)list.find(Storage(argument));
  found.places = std::move(list.places);
  return found;
}
