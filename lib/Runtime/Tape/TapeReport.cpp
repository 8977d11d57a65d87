//===- TapeReport.cpp - Texts about sweeps --------------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapeReport.h"
#include "Plan/LiveSlabs.h"
#include "tai/Runtime/Text/Format.h"
#include <algorithm>

using namespace mlir::tai::runtime;
using Decision = TapePlan::Decision;

static std::string join(const std::vector<Field *> &fields) {
  if (fields.empty())
    return "arrays or returned values";
  std::string text;
  for (const Field *field : fields)
    text += (text.empty() ? "@" : ", @") + field->name();
  return text;
}

static std::string explainReplay(const Kernel &kernel) {
  std::string text =
      "replayed, from the adjoints of " + join(kernel.tables().adjointSources);
  if (!kernel.tables().adjointTargets.empty())
    text += " to those of " + join(kernel.tables().adjointTargets);
  return text;
}

static std::string explainStored(const Kernel &kernel, bool loads) {
  const std::vector<Access> *stored = kernel.adjoint().stored();
  if (!stored)
    return "";
  if (!loads)
    return "; computes again what it stored";
  std::string text = "; loads what it stored";
  std::vector<const Field *> named;
  for (const Access &access : *stored) {
    if (std::find(named.begin(), named.end(), access.field.get()) !=
        named.end())
      continue;
    text += (named.empty() ? " in @" : ", @") + access.field->name();
    named.push_back(access.field.get());
  }
  return text;
}

/// Describes the elements that an access in a launch touches: "@x[3, :]".
static std::string describePlace(const Access &access, const uint64_t *args) {
  std::string text = "@" + access.field->name();
  if (access.fixed.empty())
    return text;
  auto next = access.fixed.begin();
  for (int64_t d = 0; d < access.field->rank(); ++d) {
    bool isFixed = next != access.fixed.end() && next->dimension == d;
    text += d == 0 ? "[" : ", ";
    text += isFixed ? std::to_string((next++)->evaluate(args)) : ":";
  }
  return text + "]";
}

/// Whether the launches of `kernel` count as accesses to all of a field that
/// this access reaches, and why; empty if its fixed indices count.
static const char *findWhole(const Kernel &kernel, const Access &access) {
  if (access.field->rank() == 0)
    return "";
  if (!kernel.adjoint().canZero())
    return "its adjoint may access other elements";
  if (LiveSlabs::hasManyPlaces(kernel, *access.field))
    return "it has too many accesses to tell them apart";
  if (access.fixed.empty())
    return "no index is the same in all iterations";
  return "";
}

/// Whether two launches certainly access different elements of one field.
static bool areApart(const Kernel &kernel, const Access &access,
                     const uint64_t *args, const Kernel &otherKernel,
                     const Access &other, const uint64_t *otherArgs) {
  if (*findWhole(kernel, access) || *findWhole(otherKernel, other))
    return false;
  for (const FixedIndex &index : access.fixed)
    for (const FixedIndex &otherIndex : other.fixed)
      if (index.dimension == otherIndex.dimension &&
          index.evaluate(args) != otherIndex.evaluate(otherArgs))
        return true;
  return false;
}

/// Names the next record in the sweep's plan that reads what the record at
/// `index` writes, and says why accesses count as accesses to a whole field.
static std::string explainReach(const TapeRecording &recording,
                                const TapePlan &plan, size_t index) {
  // Most values are read soon; tapes can have millions of records.
  constexpr size_t kMostRecords = 1024;
  const TapeRecording::Record &record = recording[index];
  const Kernel &kernel = *record.kernel;
  const uint64_t *args = recording.args(record);
  size_t end = std::min(recording.size(), index + 1 + kMostRecords);
  for (size_t next = index + 1; next < end; ++next) {
    const TapeRecording::Record &reader = recording[next];
    if (plan[next] != Decision::Replay || !reader.kernel)
      continue;
    const uint64_t *readerArgs = recording.args(reader);
    for (const Access &read : reader.kernel->summary()) {
      if (read.kind != AccessKind::Read || !read.field->adjoint())
        continue;
      for (const Access &write : kernel.summary()) {
        if (write.kind == AccessKind::Read || write.field != read.field ||
            areApart(kernel, write, args, *reader.kernel, read, readerArgs))
          continue;
        std::string text = "; record " + std::to_string(next) + " reads " +
                           describePlace(read, readerArgs);
        const char *wholeRead = findWhole(*reader.kernel, read);
        const char *wholeWrite = findWhole(kernel, write);
        if (*wholeRead && !*wholeWrite)
          text += " (all of it: " + std::string(wholeRead) + ")";
        else if (*wholeWrite && !*wholeRead)
          text += ", and this one writes all of it: " + std::string(wholeWrite);
        return text;
      }
    }
  }
  return "";
}

static std::string explainUnreached(const Kernel *kernel,
                                    const uint64_t *args) {
  if (!kernel)
    return "skipped: no adjoint reaches it";
  std::vector<std::string> places;
  for (const Access &access : kernel->summary()) {
    if (access.kind == AccessKind::Read || !access.field->adjoint())
      continue;
    std::string place = describePlace(access, args);
    if (std::find(places.begin(), places.end(), place) == places.end())
      places.push_back(std::move(place));
  }
  if (places.empty())
    return "skipped: it changes no field that has an adjoint";
  std::string text = "skipped: no adjoint reaches ";
  for (const std::string &place : places)
    text += (&place == &places.front() ? "" : ", ") + place;
  return text;
}

static std::string explainDecision(Decision decision, const Kernel *kernel,
                                   const uint64_t *args, bool loadsStored,
                                   const std::string &reader) {
  switch (decision) {
  case Decision::Replay:
    return explainReplay(*kernel) + reader +
           explainStored(*kernel, loadsStored);
  case Decision::Unpruned:
    return "replayed, without effect: 'dead-launches' is off";
  case Decision::SkipNoDerivative:
    return "skipped: it has nothing to differentiate";
  case Decision::SkipUnreached:
    return explainUnreached(kernel, args);
  case Decision::SkipNoEffect:
    return "skipped: it reads no field that has an adjoint";
  case Decision::SkipUnwanted:
    return "skipped: it leads to no gradient that is asked for";
  case Decision::Callback:
    return "called";
  case Decision::SkipCallback:
    return "skipped: it has no reverse function";
  case Decision::Overwrite:
    return "ends the adjoints of what it overwrites";
  }
  __builtin_unreachable();
}

void TapeReport::addRecord(const TapeRecording &recording, const TapePlan &plan,
                           const AdjointForms &forms, size_t index,
                           int64_t savedBytes, uint32_t timesRecomputed,
                           const RunReason *ran) {
  const TapeRecording::Record &record = recording[index];
  std::string reader;
  if (plan[index] == Decision::Replay)
    reader = explainReach(recording, plan, index);
  text += std::to_string(index) + ": " + recording.describe(record) + ": " +
          explainDecision(plan[index], record.kernel,
                          record.kernel ? recording.args(record) : nullptr,
                          forms.loadsStored(index), reader);
  if (savedBytes)
    text += "; saved " + formatBytes(savedBytes);
  if (timesRecomputed)
    text += "; recomputed " + std::to_string(timesRecomputed) + " times";
  if (ran)
    text += (*ran ? "; ran: " : "; did not run: ") + ran->describe();
  text += '\n';
}

void TapeReport::addDirect(size_t count, const char *what) {
  text += "a replay calls the " + std::to_string(count) + " " + what +
          " one after another, without a look between them\n";
}

void TapeReport::addZeroAdjoints() {
  auto [visited, skipped] = zeroAdjoints;
  if (visited + skipped != 0)
    text += "of " + std::to_string(visited + skipped) +
            " iterations of loops that look for adjoints, the last sweep "
            "skipped " +
            std::to_string(skipped) + " because their adjoints are zero\n";
}

void TapeReport::addFirstStores(const std::vector<std::string> &fields,
                                int64_t bytes) {
  if (fields.empty())
    return;
  text += "not cleared, since the last sweep stored them before it read them: ";
  for (const std::string &field : fields)
    text += (&field == &fields.front() ? "@" : ", @") + field;
  text += " (" + formatBytes(bytes) + ")\n";
}

void TapeReport::checkEffect(const TapeRecording &recording,
                             const TapePlan &plan, const std::string &losses,
                             bool hasWanted) {
  if (recording.empty())
    notes.push_back("the tape has recorded no launch: there is nothing to "
                    "differentiate");
  else if (!losses.empty() && !recording.callsInReverse() && !plan.replaysAny())
    notes.push_back(
        "the loss " + losses + " does not depend on any field " +
        (hasWanted ? "whose gradient is asked for" : "that has a gradient"));
}
