//===- HostProgram.cpp - Host programs ------------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Launches, tapes and gradient checks in a `func.func` that runs on the host.
// The check runs the region many times from the same state: the trees are saved
// before, and restored for every evaluation.
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Tape/HostProgram.h"
#include "tai/ABI/Abi.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Storage/Scalars.h"
#include "tai/Runtime/Tape/Tape.h"
#include "tai/Support/Philox.h"
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>

using namespace mlir::tai::runtime;

struct mlir::tai::runtime::HostState {
  HostModule *module;
  /// The trees that the host program itself can access, besides the trees of
  /// its kernels.
  const std::vector<TreePtr> *trees;
  std::unique_ptr<Tape> tape;
  /// The kernels that the host program launches, by the address of their name,
  /// a string literal of the compiled module.
  std::unordered_map<const char *, Kernel *> kernels;
};

static Gradients::Uses fieldsIn(const std::vector<TreePtr> &trees) {
  return [&](const FieldPtr &field) {
    return std::any_of(trees.begin(), trees.end(), [&](const TreePtr &tree) {
      return tree.get() == &field->tree();
    });
  };
}

Status mlir::tai::runtime::runHost(Runtime &runtime, TaiKernelFn function,
                                   const std::vector<TreePtr> &trees,
                                   HostModule &module, const uint64_t *args,
                                   uint64_t *results) {
  runtime.settleZeros(fieldsIn(trees));
  runtime.launcher().noteUnknownWrites();
  std::vector<void *> bases;
  for (const TreePtr &tree : trees) {
    if (!tree->base())
      return Status::failure(StatusCode::Usage, "the host program uses tree '" +
                                                    tree->name() +
                                                    "', which has been "
                                                    "destroyed");
    bases.push_back(module.usesTrees ? tree->writable() : tree->base());
  }
  HostState state;
  state.module = &module;
  state.trees = &trees;
  Launch *launch = runtime.launcher().acquire();
  launch->host = &state;
  launch->loopTimes = nullptr;
  launch->trees = bases.data();
  launch->args = args;
  launch->results = results;
  launch->seed = runtime.options().seed;
  launch->launch =
      runtime.launcher().numbers().fetch_add(1, std::memory_order_relaxed);
  int32_t code = function(launch);
  state.tape.reset();
  launch->host = nullptr;
  if (launch->arena.used())
    launch->arena.reset();
  Status status;
  if (code != 0 || launch->hasFailed()) {
    launch->freeSinks();
    status = launch->hasFailed() ? launch->takeFailure()
                                 : Status::failure(StatusCode::Internal,
                                                   "the host program failed");
  }
  runtime.launcher().release(launch);
  return status ? runtime.synchronize() : std::move(status);
}

/// Passes a failure on to the host program. Returns 1 for a failure, else 0.
static int32_t report(Launch &launch, Status status) {
  if (status)
    return 0;
  launch.fail(std::move(status));
  return 1;
}

static int32_t reportUsage(Launch &launch, std::string message,
                           const char *where = "") {
  return report(launch, Status::failure(StatusCode::Usage, std::move(message),
                                        where ? where : ""));
}

/// Returns control to the host program with `status`. The program accesses its
/// trees directly, so they are made current on the host before.
static int32_t returnTo(Launch &launch, Status status) {
  launch.owner().settleZeros(fieldsIn(*launch.host->trees));
  if (launch.owner().devices().device() && launch.host->module->usesTrees)
    for (const TreePtr &tree : *launch.host->trees)
      (void)tree->writable();
  return report(launch, std::move(status));
}

static FieldPtr findField(Launch &launch, const char *name) {
  return launch.owner().store().findField(*name == '@' ? name + 1 : name);
}

extern "C" int32_t tai_rt_host_launch(TaiFrame *frame, const char *name,
                                      const uint64_t *args, int64_t slots,
                                      uint64_t *results, int64_t resultSlots) {
  Launch &launch = launchOf(frame);
  if (!launch.host)
    return reportUsage(launch, "kernels are launched from the host only");
  Kernel *&kernel = launch.host->kernels[name];
  if (!kernel && launch.host->module->findKernel)
    kernel = launch.host->module->findKernel(*name == '@' ? name + 1 : name);
  if (!kernel)
    return reportUsage(launch, std::string("there is no kernel '") + name +
                                   "' in this module");
  if (resultSlots != kernel->resultSlots())
    return reportUsage(launch, "kernel '" + kernel->name() + "' returns " +
                                   std::to_string(kernel->resultSlots()) +
                                   " slots, but the launch expects " +
                                   std::to_string(resultSlots));
  return returnTo(launch, launch.owner().launch(*kernel, args, slots, results));
}

extern "C" int32_t tai_rt_host_tape_begin(TaiFrame *frame, const char *name) {
  Launch &launch = launchOf(frame);
  if (!launch.host)
    return reportUsage(launch, "a tape belongs to the host");
  FieldPtr loss;
  if (name && *name && !(loss = findField(launch, name)))
    return reportUsage(launch, std::string("there is no field '") + name + "'");
  return returnTo(launch, launch.owner().beginTape(std::move(loss),
                                                   /*clearGradients=*/true,
                                                   launch.host->tape));
}

extern "C" int32_t tai_rt_host_tape_checkpoint(TaiFrame *frame, int32_t kind,
                                               int64_t snapshots,
                                               int64_t budget) {
  Launch &launch = launchOf(frame);
  if (!launch.host)
    return reportUsage(launch, "a tape belongs to the host");
  // If there is no tape, tai_rt_host_tape_begin has reported the reason.
  if (!launch.host->tape)
    return 1;
  CheckpointPolicy policy;
  policy.kind = static_cast<CheckpointPolicy::Kind>(kind);
  policy.snapshots = snapshots;
  policy.budget = budget;
  return report(launch, launch.host->tape->setCheckpoints(policy));
}

extern "C" int32_t tai_rt_host_tape_end(TaiFrame *frame) {
  Launch &launch = launchOf(frame);
  if (!launch.host || !launch.host->tape)
    return reportUsage(launch, "no tape is open");
  Status status = launch.host->tape->backward();
  for (const std::string &line : launch.host->tape->warnings())
    std::fprintf(stderr, "warning: %s\n", line.c_str());
  launch.host->tape.reset();
  return returnTo(launch, std::move(status));
}

//===----------------------------------------------------------------------===//
// Gradient check
//===----------------------------------------------------------------------===//

namespace {
/// A copy of the contents of all trees, and of the state that random numbers
/// depend on.
struct Snapshot {
  std::vector<std::pair<const Tree *, std::string>> trees;
  uint64_t launches = 0;

  void restore() const {
    for (const auto &[tree, bytes] : trees)
      std::memcpy(tree->writable(), bytes.data(), bytes.size());
  }
};

/// Addresses of all components of a field in row-major order, to be used while
/// its tree is on the host.
std::vector<char *> componentsOf(const Field &field) {
  std::vector<char *> result;
  std::vector<int64_t> index(static_cast<size_t>(field.rank()));
  const std::vector<int64_t> &offset = field.layout().offset;
  for (int64_t e = 0; e < field.numElements(); ++e) {
    int64_t rest = e;
    for (size_t d = index.size(); d-- > 0;) {
      index[d] = rest % field.shape()[d] + (offset.empty() ? 0 : offset[d]);
      rest /= field.shape()[d];
    }
    char *address = field.tree().base() + field.elementOffset(index.data());
    for (int64_t c = 0; c < field.numComponents(); ++c)
      result.push_back(address + c * field.layout().componentStride);
  }
  return result;
}

std::string number(double value) {
  char text[40];
  std::snprintf(text, sizeof(text), "%.12g", value);
  return text;
}

/// Compares gradients with central differences, one field at a time.
class GradientCheck {
public:
  GradientCheck(Launch &launch, FieldPtr loss,
                int32_t (*region)(TaiFrame *, void *), void *closure)
      : launch(launch), runtime(launch.owner()), loss(std::move(loss)),
        region(region), closure(closure) {}

  /// Runs the region of the host program under a tape. Returns zero if all went
  /// well.
  int32_t run(const char *where) {
    for (const auto &entry : runtime.store().trees())
      if (!entry.second->sparseNodes().empty())
        return reportUsage(
            launch,
            "a gradient is checked on copies of all trees, and tree '" +
                entry.second->name() +
                "' has sparse levels; compare with 'tai_check.close' instead",
            where);
    Status status = runtime.beginTape(loss, true, launch.host->tape);
    if (!status)
      return report(launch, std::move(status));
    // Each evaluation of the region starts from this snapshot of all trees.
    before = save();
    if (region(&launch, closure) != 0 || launch.hasFailed())
      return 1;
    status = launch.host->tape->backward();
    launch.host->tape.reset();
    if (!status)
      return report(launch, std::move(status));
    runtime.settleZeros(fieldsIn(*launch.host->trees));
    after = save();
    return 0;
  }

  int32_t check(Field &field, double tolerance, const char *where) {
    std::vector<char *> values = componentsOf(field);
    std::vector<char *> adjoints = componentsOf(*field.adjoint());
    std::vector<double> gradient;
    gradient.reserve(adjoints.size());
    (void)field.adjoint()->readable();
    for (char *adjoint : adjoints)
      gradient.push_back(loadF64(field.adjoint()->scalar(), adjoint));
    std::vector<bool> checked;
    if (!findInputs(field, values, checked))
      return 1;
    if (std::find(checked.begin(), checked.end(), true) == checked.end()) {
      restoreAfter();
      return report(launch,
                    Status::failure(
                        StatusCode::Check,
                        "nothing is checked: all elements of '" + field.name() +
                            "' are overwritten before they are read, and no "
                            "difference of them reaches '" +
                            loss->name() + "'",
                        where ? where : ""));
    }
    constexpr uint32_t directions = 4;
    for (uint32_t d = 0; d < directions; ++d) {
      std::vector<double> direction = makeDirection(values.size(), d);
      double product = 0;
      for (size_t i = 0; i < values.size(); ++i) {
        direction[i] = checked[i] ? direction[i] : 0;
        product += checked[i] ? gradient[i] * direction[i] : 0;
      }
      Estimate best;
      if (!estimate(field, values, direction, product, best))
        return 1;
      // If the error is NaN, this comparison is false, and so the gradient
      // check fails.
      if (best.error <= tolerance)
        continue;
      restoreAfter();
      return report(
          launch,
          Status::failure(
              StatusCode::Check,
              "the gradient of '" + loss->name() + "' by '" + field.name() +
                  "' disagrees with central differences: along direction " +
                  std::to_string(d) + " the derivative is " + number(product) +
                  " by the adjoint and " + number(best.value) +
                  " by differences, relative error " + number(best.error) +
                  " above the tolerance " + number(tolerance),
              where ? where : ""));
    }
    restoreAfter();
    return 0;
  }

private:
  struct Estimate {
    double value = 0;
    double error = std::nan("");
  };

  Snapshot save() const {
    Snapshot snapshot;
    for (const auto &entry : runtime.store().trees())
      snapshot.trees.emplace_back(
          entry.second.get(),
          std::string(entry.second->readable(),
                      static_cast<size_t>(entry.second->bytes())));
    snapshot.launches = runtime.launcher().numbers().load();
    return snapshot;
  }

  void restoreAfter() {
    after.restore();
    runtime.launcher().numbers().store(after.launches);
  }

  /// A pseudorandom direction whose components have both signs and magnitudes
  /// between 0.5 and 1.5.
  static std::vector<double> makeDirection(size_t count, uint32_t which) {
    std::vector<double> direction(count);
    for (size_t i = 0; i < count; ++i) {
      auto bits = philox4x32(
          {static_cast<uint32_t>(i), static_cast<uint32_t>(i >> 32), which, 0},
          {0x7461u, 0x69u});
      double size = 0.5 + bits[0] * 0x1p-32;
      direction[i] = bits[1] & 1 ? size : -size;
    }
    return direction;
  }

  bool evaluate(Field &field, const std::vector<char *> &values,
                const std::vector<double> &direction, double step,
                double &result) {
    before.restore();
    runtime.launcher().numbers().store(before.launches);
    for (size_t i = 0; i < values.size(); ++i)
      storeF64(field.scalar(), values[i],
               loadF64(field.scalar(), values[i]) + step * direction[i]);
    if (region(&launch, closure) != 0 || launch.hasFailed())
      return false;
    result = loadF64(loss->scalar(), loss->readable());
    return true;
  }

  /// Finds the elements whose initial values affect the loss. Elements that the
  /// region overwrites before it reads them (all but the first step of a field
  /// with a time axis, say) have adjoints, but the loss does not depend on
  /// their initial values.
  bool findInputs(Field &field, const std::vector<char *> &values,
                  std::vector<bool> &checked) {
    constexpr double step = 0.125;
    checked.assign(values.size(), true);
    std::vector<double> direction = makeDirection(values.size(), 0);
    std::vector<double> start(values.size()), none(values.size());
    before.restore();
    for (size_t i = 0; i < values.size(); ++i)
      start[i] = loadF64(field.scalar(), values[i]);
    double reference, moved;
    if (!evaluate(field, values, direction, step, moved))
      return false;
    (void)field.readable();
    std::vector<size_t> written;
    for (size_t i = 0; i < values.size(); ++i) {
      // The value of the element as `evaluate` has stored it, rounded to the
      // field's type.
      double now = loadF64(field.scalar(), values[i]);
      storeF64(field.scalar(), values[i], start[i] + step * direction[i]);
      if (!(now == loadF64(field.scalar(), values[i])))
        written.push_back(i);
    }
    if (written.empty())
      return true;
    if (!evaluate(field, values, none, 0, reference))
      return false;
    // Groups of elements are changed at once, and groups that affect the loss
    // are bisected. Elements on which the budget allows no decision are
    // checked.
    unsigned budget = 48;
    std::vector<std::pair<size_t, size_t>> groups = {{0, written.size()}};
    for (size_t g = 0; g < groups.size(); ++g) {
      auto [begin, end] = groups[g];
      std::vector<double> part(values.size());
      for (size_t k = begin; k < end; ++k)
        part[written[k]] = direction[written[k]];
      // To decide on a group of elements takes up to two evaluations, one for
      // each sign.
      if (budget < 2)
        break;
      bool matters = false;
      for (double sign : {1.0, -1.0}) {
        double result;
        --budget;
        if (!evaluate(field, values, part, sign * step, result))
          return false;
        // Parallel sums vary in their last bits. A NaN counts as an effect.
        matters |= !(std::fabs(result - reference) <=
                     1e-13 * std::max(1e-300, std::fabs(reference)));
        if (matters)
          break;
      }
      if (!matters) {
        for (size_t k = begin; k < end; ++k)
          checked[written[k]] = false;
      } else if (end - begin > 1) {
        size_t middle = begin + (end - begin) / 2;
        groups.push_back({begin, middle});
        groups.push_back({middle, end});
      }
    }
    return true;
  }

  /// Evaluates central differences for a ladder of steps, each step half of the
  /// previous one, and their Richardson extrapolations. Keeps the estimate that
  /// is closest to the derivative by the adjoint.
  bool estimate(Field &field, const std::vector<char *> &values,
                const std::vector<double> &direction, double product,
                Estimate &best) {
    double previous = 0, largestLoss = 0;
    bool havePrevious = false;
    double step = 0.125;
    for (int rung = 0; rung < 18; ++rung, step /= 2) {
      double plus, minus;
      if (!evaluate(field, values, direction, step, plus) ||
          !evaluate(field, values, direction, -step, minus))
        return false;
      largestLoss = std::max({largestLoss, std::fabs(plus), std::fabs(minus)});
      double difference = (plus - minus) / (2 * step);
      consider(difference, product, largestLoss, best);
      if (havePrevious)
        consider((4 * difference - previous) / 3, product, largestLoss, best);
      previous = difference;
      havePrevious = true;
    }
    return true;
  }

  static void consider(double value, double product, double loss,
                       Estimate &best) {
    // Central differences cannot resolve derivatives below 1e-6 of the loss.
    double scale =
        std::max({std::fabs(value), std::fabs(product), 1e-6 * loss, 1e-300});
    double error = std::fabs(value - product) / scale;
    if (!(best.error <= error) && !std::isnan(error))
      best = {value, error};
  }

  Launch &launch;
  Runtime &runtime;
  FieldPtr loss;
  int32_t (*region)(TaiFrame *, void *);
  void *closure;
  Snapshot before, after;
};
} // namespace

static int32_t checkGradients(Launch &launch, const FieldPtr &loss,
                              const std::vector<FieldPtr> &wrt,
                              double tolerance,
                              int32_t (*region)(TaiFrame *, void *),
                              void *closure, const char *where) {
  for (const FieldPtr &field : wrt)
    if (!field->adjoint() || !isFloat(field->scalar()))
      return reportUsage(
          launch, "field '" + field->name() + "' has no adjoint to be checked",
          where);
  GradientCheck check(launch, loss, region, closure);
  if (check.run(where) != 0)
    return 1;
  for (const FieldPtr &field : wrt)
    if (check.check(*field, tolerance, where) != 0)
      return 1;
  return 0;
}

extern "C" int32_t
tai_rt_host_check_gradient(TaiFrame *frame, const char *lossName,
                           const char **wrt, int64_t count, double tolerance,
                           int32_t (*region)(TaiFrame *, void *), void *closure,
                           const char *where) {
  Launch &launch = launchOf(frame);
  if (!launch.host)
    return reportUsage(launch, "a gradient is checked on the host only", where);
  FieldPtr loss = findField(launch, lossName);
  if (!loss)
    return reportUsage(
        launch, std::string("there is no field '") + lossName + "'", where);
  std::vector<FieldPtr> fields;
  for (int64_t i = 0; i < count; ++i) {
    FieldPtr field = findField(launch, wrt[i]);
    if (!field)
      return reportUsage(
          launch, std::string("there is no field '") + wrt[i] + "'", where);
    fields.push_back(std::move(field));
  }
  return checkGradients(launch, loss, fields, tolerance, region, closure,
                        where);
}

Status mlir::tai::runtime::checkGradient(Runtime &runtime, const FieldPtr &loss,
                                         const std::vector<FieldPtr> &wrt,
                                         double tolerance,
                                         std::function<Status()> region) {
  std::vector<TreePtr> trees;
  for (const auto &entry : runtime.store().trees())
    trees.push_back(entry.second);
  HostModule module;
  HostState state;
  state.module = &module;
  state.trees = &trees;
  Launch *launch = runtime.launcher().acquire();
  launch->host = &state;
  // `run` is a C function pointer and cannot capture `region`, which it gets
  // through its data argument.
  struct Closure {
    Launch &launch;
    const std::function<Status()> &region;
  } closure{*launch, region};
  auto run = [](TaiFrame *, void *data) -> int32_t {
    auto &[launch, region] = *static_cast<Closure *>(data);
    return report(launch, region());
  };
  (void)orFail(launch, 1, [&] {
    return checkGradients(*launch, loss, wrt, tolerance, run, &closure, "");
  });
  state.tape.reset();
  launch->host = nullptr;
  Status status =
      launch->hasFailed() ? launch->takeFailure() : Status::success();
  runtime.launcher().release(launch);
  return status ? runtime.synchronize() : std::move(status);
}
