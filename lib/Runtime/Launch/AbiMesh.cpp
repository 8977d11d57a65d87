//===- AbiMesh.cpp - Exchanges between ranks ------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Implements tai/ABI/MeshAbi.h.
//
//===----------------------------------------------------------------------===//

#include "tai/ABI/MeshAbi.h"
#include "tai/Runtime/Device/FailureNotice.h"
#include "tai/Runtime/Launch/Kernel.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Launch/Mesh.h"
#include "tai/Runtime/Launch/Runtime.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <atomic>

using namespace mlir::tai::runtime;

/// The mesh of the process, and the exchanges that it has left out.
static Mesh ofProcess;
static std::atomic<int64_t> leftOut{0};

void mlir::tai::runtime::setMesh(Mesh mesh) {
  ofProcess = std::move(mesh);
  setFailureNotice(
      [](const std::string &failure) { tellRanks(failure, "", ""); });
}

std::optional<int64_t> mlir::tai::runtime::rankOfProcess() {
  if (ofProcess.ranks == 0)
    return std::nullopt;
  return ofProcess.rank;
}

int64_t mlir::tai::runtime::numExchangesLeftOut() { return leftOut.load(); }

/// By ExchangeKind of the dialect.
static constexpr const char *kKinds[] = {"fetch", "clear",  "collect",
                                         "open",  "sum",    "min",
                                         "max",   "gather", "stale"};

static constexpr size_t kFetch = 0, kStale = 8;

/// The stream of a GPU on which handlers queue their work.
static constexpr uint64_t kDefaultStream = 0;

/// True for launches of a reverse sweep or a replay, between which a tape may
/// restore former rows.
static bool isOfSweep(const Launch &launch) {
  if (launch.isUnrecorded.load(std::memory_order_relaxed))
    return false;
  const Recorder *tape = launch.owner().recordings().current();
  return !tape || tape->isSuspended();
}

/// The last launch of the thread that has asked for the rank, with its number.
static thread_local std::pair<const Launch *, uint64_t> lastOnRanks;

bool mlir::tai::runtime::isOnRanks(const Launch &launch) {
  return lastOnRanks.first == &launch && lastOnRanks.second == launch.launch;
}

extern "C" int64_t tai_rt_rank(TaiFrame *frame, int64_t ranks,
                               const char *where) {
  Launch &launch = launchOf(frame);
  const Mesh &mesh = ofProcess;
  lastOnRanks = {&launch, launch.launch};
  if (isOfSweep(launch))
    launch.owner().halos().removeAll();
  if (mesh.ranks == ranks)
    return mesh.rank;
  orFail(frame, [&] {
    std::string message =
        "the loop is over a field of " + std::to_string(ranks) + " ranks, and ";
    message += mesh.ranks
                   ? "the mesh of the process has " + std::to_string(mesh.ranks)
                   : std::string("the process belongs to no mesh");
    launch.fail(Status::failure(StatusCode::Usage, message, where));
  });
  return 0;
}

/// The elements of the exchange as an array. False if a fixed index is not in
/// the field.
static bool select(const TaiExchangePlan &plan, const int64_t *at, char *tree,
                   Exchange &exchange) {
  char *address = tree + plan.offset;
  const auto *digits = reinterpret_cast<const TaiExchangeDigit *>(&plan + 1);
  for (int64_t i = 0; i < plan.numDigits; ++i) {
    const TaiExchangeDigit &digit = digits[i];
    if (digit.role >= 0) {
      int64_t index = at[digit.role];
      // The outermost digit of a dimension tells its extent.
      bool isOutermost =
          std::none_of(digits, digits + i, [&](const TaiExchangeDigit &other) {
            return other.role == digit.role;
          });
      if (index < 0 || (isOutermost && index >= digit.divisor * digit.extent))
        return false;
      address += index / digit.divisor % digit.extent * digit.stride;
      continue;
    }
    if (digit.role == TAI_DIGIT_ROW)
      exchange.rows = static_cast<int64_t>(exchange.extents.size());
    exchange.extents.push_back(digit.extent);
    exchange.strides.push_back(digit.stride);
  }
  exchange.address = address;
  return true;
}

void mlir::tai::runtime::tellRanks(const std::string &failure,
                                   const std::string &kernel,
                                   const char *where) {
  const Mesh &mesh = ofProcess;
  if (!mesh.exchange || mesh.ranks < 2)
    return;
  Exchange told{};
  told.kind = "fail";
  told.field = failure.c_str();
  told.kernel = kernel.c_str();
  told.where = where;
  told.rows = -1;
  (void)mesh.exchange(told);
}

/// Tells the other ranks, which wait in the exchange, that the launch has
/// failed on this one.
static void tellOfFailure(Launch &launch, const char *where) {
  std::string message;
  {
    std::lock_guard<std::mutex> lock(launch.failureMutex);
    message = launch.failure.message();
  }
  const Kernel *kernel = launch.running.load(std::memory_order_relaxed);
  tellRanks(message, kernel ? kernel->name() : "", where);
}

extern "C" void tai_rt_exchange(TaiFrame *frame, void *tree,
                                const TaiExchangePlan *plan, const int64_t *at,
                                const char *field, const char *where) {
  Launch &launch = launchOf(frame);
  if (launch.hasFailed())
    return orFail(frame, [&] { tellOfFailure(launch, where); });
  orFail(frame, [&] {
    bool maySkip = !isOfSweep(launch);
    Halos &halos = launch.owner().halos();
    if (!maySkip)
      halos.removeAll();
    const Kernel *kernel = launch.running.load(std::memory_order_relaxed);
    Exchange exchange{kKinds[plan->kind],
                      field,
                      kernel ? kernel->name().c_str() : "",
                      where,
                      plan->element,
                      plan->digest,
                      plan->block,
                      plan->before,
                      plan->after,
                      nullptr,
                      /*rows=*/-1,
                      {},
                      {}};
    if (!select(*plan, at, static_cast<char *>(tree), exchange))
      return;
    Halo halo{static_cast<const char *>(tree) + plan->offset,
              exchange.address,
              exchange.extents,
              exchange.strides,
              exchange.before,
              exchange.after};
    auto kind = static_cast<size_t>(plan->kind);
    if (kind == kStale)
      return halos.removeChanged(halo);
    if (kind == kFetch && maySkip && halos.isCurrent(halo)) {
      leftOut.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    // The other kinds write halos, except those of fields that each rank has.
    if (kind != kFetch)
      halos.remove(halo.field);
    DeviceQueue *queue = nullptr;
    if (launch.onDevice && launch.onDevice->code) {
      // The handler's work comes after the launches so far, on the default
      // stream, and before the later ones.
      exchange.isOnDevice = true;
      queue = &launch.onDevice->context->queue();
      if (Status status = queue->letStreamWait(kDefaultStream); !status)
        return launch.fail(std::move(status));
    }
    const Mesh &mesh = ofProcess;
    std::string message = mesh.exchange
                              ? mesh.exchange(exchange)
                              : "the process belongs to no mesh, and the "
                                "launch exchanges rows of a sharded field";
    if (queue)
      if (Status status = queue->waitForStream(kDefaultStream); !status)
        return launch.fail(std::move(status));
    if (!message.empty())
      launch.fail(Status::failure(StatusCode::Usage, message, where));
    else if (kind == kFetch && maySkip)
      halos.add(std::move(halo));
  });
}

void mlir::tai::runtime::appendMeshCalls(std::vector<RuntimeSymbol> &symbols) {
  symbols.push_back({"tai_rt_rank", reinterpret_cast<void *>(&tai_rt_rank)});
  symbols.push_back(
      {"tai_rt_exchange", reinterpret_cast<void *>(&tai_rt_exchange)});
}
