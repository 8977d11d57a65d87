//===- AdjointFlags.cpp - Cells that a reverse loop may leave out ---------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// Where every contribution of an iteration is a product with adjoints of its
// own cell, and these are zero, it need not run. Whether they are is found by
// looking at them, before the loop: a few bytes of each cell against the body.
//
//===----------------------------------------------------------------------===//

#include "CellElements.h"
#include "Launch.h"
#include <algorithm>
#include <array>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

/// True if cells of the level are numbered for both fields by the same digits
/// of the same indices.
static bool numbersAlike(const Field &a, const Field &b) {
  auto digits = [](const std::vector<LayoutLevel> &levels) {
    std::vector<std::array<int64_t, 3>> result;
    for (const LayoutLevel &level : levels)
      if (level.cells != 0)
        result.push_back({level.divisor, level.extent, level.cells});
    return result;
  };
  const FieldLayout &first = a.layout(), &second = b.layout();
  if (a.sparseNode() != b.sparseNode() || first.offset != second.offset ||
      first.indices.size() != second.indices.size())
    return false;
  for (size_t d = 0; d < first.indices.size(); ++d)
    if (digits(first.indices[d]) != digits(second.indices[d]))
      return false;
  return true;
}

/// The fields that must be zero; none if some loop over the level does more.
static std::vector<const Field *>
findSources(const std::vector<AdjointFlags> &flags, const SparseNode &node,
            bool deterministic) {
  std::vector<const Field *> sources;
  for (const AdjointFlags &loop : flags) {
    if (loop.loop->sparseNode() != &node)
      continue;
    // Sums are split by the number of iterations.
    if (loop.sources.empty() || (deterministic && loop.sumsUp))
      return {};
    for (const FieldPtr &source : loop.sources) {
      if (!source || !source->valid() || !numbersAlike(*loop.loop, *source))
        return {};
      if (std::find(sources.begin(), sources.end(), source.get()) ==
          sources.end())
        sources.push_back(source.get());
    }
  }
  return sources;
}

const std::vector<int64_t> &
Launch::withoutVain(const SparseNode &node, const std::vector<int64_t> &cells) {
  std::vector<const Field *> sources =
      findSources(*flags, node, owner().options().deterministic);
  if (sources.empty() || cells.empty())
    return cells;
  struct Job {
    std::vector<CellElements> elements;
    const std::vector<int64_t> &cells;
    int64_t parts;
    std::vector<std::vector<int64_t>> kept;
  } job{{}, cells, 1, {}};
  int64_t bytes = 0;
  for (const Field *source : sources) {
    job.elements.emplace_back(*source);
    bytes += job.elements.back().bytes();
  }
  constexpr int64_t bytesPerPart = 256 << 10;
  auto count = static_cast<int64_t>(cells.size());
  job.parts = std::clamp<int64_t>(count * bytes / bytesPerPart, 1,
                                  2 * int64_t(owner().threads()));
  job.kept.resize(static_cast<size_t>(job.parts));
  owner().parallel(
      job.parts,
      [](void *context, int64_t part) {
        Job &job = *static_cast<Job *>(context);
        auto count = static_cast<int64_t>(job.cells.size());
        int64_t end = count * (part + 1) / job.parts;
        for (int64_t i = count * part / job.parts; i < end; ++i) {
          int64_t cell = job.cells[i];
          if (!std::all_of(
                  job.elements.begin(), job.elements.end(),
                  [&](const CellElements &e) { return e.isZero(cell); }))
            job.kept[part].push_back(cell);
        }
      },
      &job);
  auto all = std::make_unique<std::vector<int64_t>>();
  for (const std::vector<int64_t> &kept : job.kept)
    all->insert(all->end(), kept.begin(), kept.end());
  auto visited = static_cast<int64_t>(all->size());
  owner().skipCounters().add(SkipCount::FlaggedVisited, visited);
  owner().skipCounters().add(SkipCount::FlaggedSkipped, count - visited);
  std::lock_guard<std::mutex> lock(failureMutex);
  filtered.push_back(std::move(all));
  return *filtered.back();
}
