//===- LaunchCells.cpp - Cells that the loops of a launch visit -----------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/CellElements.h"
#include "tai/Runtime/Mirror/DeviceCells.h"
#include <algorithm>
#include <array>
#include <iterator>

using namespace mlir::tai;
using namespace mlir::tai::runtime;

const std::vector<int64_t> &Launch::visitedCells(SparseNode &node) {
  static const std::vector<int64_t> none;
  // The list of cells outlives this call: `loops`, `fetched` or the record of
  // the primal holds it.
  ActiveListPtr list = visitedList(node);
  return list ? list->cells : none;
}

/// Finds the cells that the primal's loops over the level visited; null after a
/// failure.
const LoopLists::Entry *Launch::findGiven(SparseNode &node) {
  const LoopLists::Entry *entry = given->find(node);
  bool differs = entry && entry->others == LoopLists::Others::Differ;
  if (entry && entry->others == LoopLists::Others::Unknown) {
    Status status = findDifference(*given, node, differs);
    if (!status) {
      fail(std::move(status));
      return nullptr;
    }
  }
  if (entry && !differs)
    return entry;
  std::string what = "the gradient of kernel '" + *primalName + "' ";
  if (entry && owner().inReverseFunction())
    what += "loops over the active cells of " + node.info().label +
            ", and the host function that launched it has changed them; change "
            "them outside of that function";
  else if (entry)
    what += "needs the cells of " + node.info().label +
            " that each of its loops went over, but they went over different "
            "ones; split the kernel, with such a loop in each part";
  else
    what += "loops over the active cells of " + node.info().label +
            ", but there is no launch of the kernel that it could belong to";
  fail(Status::failure(StatusCode::Usage, std::move(what)));
  return nullptr;
}

ActiveListPtr Launch::visitedList(SparseNode &node) {
  if (given) {
    const LoopLists::Entry *entry = findGiven(node);
    if (!entry || entry->list)
      return entry ? entry->list : nullptr;
    // The host needs a list that the device has made, which is rare.
    auto list = std::make_shared<ActiveList>();
    Status status = fetchCells(*entry->onDevice, list->cells);
    if (!status) {
      fail(std::move(status));
      return nullptr;
    }
    std::lock_guard<std::mutex> lock(failureMutex);
    fetched.push_back(list);
    return list;
  }
  ActiveListPtr list = node.list();
  std::lock_guard<std::mutex> lock(failureMutex);
  loops.add(node, list);
  return list;
}

const std::vector<int64_t> &Launch::cellsFor(SparseNode &node) {
  const std::vector<int64_t> &cells = visitedCells(node);
  return flags ? withoutZeroAdjoints(node, cells) : cells;
}

//===----------------------------------------------------------------------===//
// Cells that the loops of an adjoint may skip
//===----------------------------------------------------------------------===//

// An iteration need not run if each of its contributions is a product with
// adjoints of its own cell, and these adjoints are zero. Before the loop, the
// adjoints of all cells are compared with zero: reading a few bytes of each
// cell costs little compared with the loop's body.

/// True if both fields compute the number of a cell of the level from the same
/// digits (parts) of the same indices.
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

/// Returns the fields that must be zero in a cell for loops over the level to
/// skip it; none if some loop over the level cannot skip cells.
static std::vector<const Field *>
findSources(const std::vector<SkippableLoop> &flags, const SparseNode &node) {
  std::vector<const Field *> sources;
  for (const SkippableLoop &loop : flags) {
    if (loop.loop->sparseNode() != &node)
      continue;
    if (loop.sources.empty())
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
Launch::withoutZeroAdjoints(const SparseNode &node,
                            const std::vector<int64_t> &cells) {
  std::vector<const Field *> sources = findSources(*flags, node);
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
  owner().workers().parallel(
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

namespace {
/// The cells of the innermost sparse level above a field as a grid.
class CellGrid {
public:
  explicit CellGrid(const Field &field) {
    const FieldLayout &layout = field.layout();
    for (size_t d = 0; d < layout.indices.size(); ++d) {
      Dimension dimension;
      int64_t unit = field.shape()[d];
      for (const LayoutLevel &level : layout.indices[d])
        if (level.cells != 0) {
          dimension.levels.push_back(level);
          unit = std::min(unit, level.divisor);
        }
      for (LayoutLevel &level : dimension.levels)
        level.divisor /= unit;
      dimension.extent = dimension.levels.empty() ? 1 : field.shape()[d] / unit;
      dimensions.push_back(std::move(dimension));
    }
  }

  /// The most cells that one call of addAround adds.
  int64_t numAround(int64_t reach) const {
    int64_t count = 1;
    for (const Dimension &dimension : dimensions)
      if (__builtin_mul_overflow(
              count, std::min(2 * reach + 1, dimension.extent), &count))
        return INT64_MAX;
    return count;
  }

  /// Adds the cell and all cells up to `reach` away along each dimension to
  /// `found`.
  void addAround(int64_t cell, int64_t reach,
                 std::vector<int64_t> &found) const {
    addAround(cell, reach, 0, 0, found);
  }

private:
  struct Dimension {
    std::vector<LayoutLevel> levels;
    int64_t extent;
  };

  void addAround(int64_t cell, int64_t reach, size_t d, int64_t number,
                 std::vector<int64_t> &found) const {
    if (d == dimensions.size())
      return found.push_back(number);
    const Dimension &dimension = dimensions[d];
    int64_t position = 0;
    for (const LayoutLevel &level : dimension.levels)
      position += cell / level.cells % level.extent * level.divisor;
    int64_t end = std::min(position + reach + 1, dimension.extent);
    for (int64_t at = std::max<int64_t>(position - reach, 0); at < end; ++at) {
      int64_t next = number;
      for (const LayoutLevel &level : dimension.levels)
        next += at / level.divisor % level.extent * level.cells;
      addAround(cell, reach, d + 1, next, found);
    }
  }

  std::vector<Dimension> dimensions;
};
} // namespace

const std::vector<int64_t> &Launch::gatheredCellsFor(SparseNode &node,
                                                     int64_t reach) {
  const std::vector<int64_t> &cells = visitedCells(node);
  if (!flags || reach < 0)
    return cells;
  const std::vector<int64_t> &busy = withoutZeroAdjoints(node, cells);
  if (&busy == &cells)
    return cells;
  auto loop =
      std::find_if(flags->begin(), flags->end(), [&](const SkippableLoop &f) {
        return f.loop->sparseNode() == &node;
      });
  CellGrid grid(*loop->loop);
  auto note = [&](const std::vector<int64_t> &result) {
    auto more = static_cast<int64_t>(result.size() - busy.size());
    owner().skipCounters().add(SkipCount::FlaggedVisited, more);
    owner().skipCounters().add(SkipCount::FlaggedSkipped, -more);
  };
  // If most cells are busy, or many cells are within reach of each busy cell,
  // finding those cells would cost more than skipping the rest saves.
  if (2 * busy.size() > cells.size() || grid.numAround(reach) > 64) {
    note(cells);
    return cells;
  }
  std::vector<int64_t> around;
  for (int64_t cell : busy)
    grid.addAround(cell, reach, around);
  std::sort(around.begin(), around.end());
  around.erase(std::unique(around.begin(), around.end()), around.end());
  auto all = std::make_unique<std::vector<int64_t>>();
  std::set_intersection(cells.begin(), cells.end(), around.begin(),
                        around.end(), std::back_inserter(*all));
  note(*all);
  std::lock_guard<std::mutex> lock(failureMutex);
  filtered.push_back(std::move(all));
  return *filtered.back();
}
