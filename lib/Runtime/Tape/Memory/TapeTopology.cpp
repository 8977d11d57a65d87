//===- TapeTopology.cpp - The history of activity -------------------------===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#include "TapeTopology.h"
#include "tai/Runtime/Launch/Launch.h"
#include "tai/Runtime/Mirror/CellMover.h"
#include "tai/Runtime/Mirror/Mirror.h"
#include <algorithm>
#include <iterator>

using namespace mlir::tai::runtime;

//===----------------------------------------------------------------------===//
// Forward
//===----------------------------------------------------------------------===//

void TapeTopology::watch(const TreePtr &tree) {
  if (tree->sparseNodes().empty() || !tree->base())
    return;
  for (const Watched &entry : watched)
    if (entry.tree == tree)
      return;
  for (const std::unique_ptr<SparseNode> &node : tree->sparseNodes()) {
    ActiveListPtr now = node->list();
    watched.push_back({tree, node.get(), now, now});
    node->noteRemovals(true);
  }
}

void TapeTopology::noteRemovals(bool on) {
  for (Watched &entry : watched)
    entry.node->noteRemovals(on);
}

void TapeTopology::end() {
  settle(kEnd);
  noteRemovals(false);
}

void TapeTopology::update(Watched &entry, uint32_t record) {
  if (!entry.tree->base())
    return;
  // The call of epoch() fetches activity from a device, and runs deferred
  // updates first.
  uint64_t epoch = entry.node->epoch();
  if (entry.known->epoch == epoch)
    return;
  ActiveListPtr now = entry.node->list();
  Change change{record, entry.node, {}, {}, {}};
  const std::vector<int64_t> &before = entry.known->cells, &after = now->cells;
  std::set_difference(after.begin(), after.end(), before.begin(), before.end(),
                      std::back_inserter(change.added));
  std::set_difference(before.begin(), before.end(), after.begin(), after.end(),
                      std::back_inserter(change.removed));
  std::vector<int64_t> gone = entry.node->takeRemovals();
  std::sort(gone.begin(), gone.end());
  gone.erase(std::unique(gone.begin(), gone.end()), gone.end());
  std::set_intersection(before.begin(), before.end(), gone.begin(), gone.end(),
                        std::back_inserter(change.cleared));
  entry.known = std::move(now);
  if (!change.cleared.empty() || !change.added.empty() ||
      !change.removed.empty())
    add(std::move(change));
}

/// Inserts a change in the order of records: a deferred update on a device adds
/// its change after changes of later records.
void TapeTopology::add(Change change) {
  auto after = std::upper_bound(
      changed.begin(), changed.end(), change.record,
      [](uint32_t r, const Change &other) { return r < other.record; });
  changed.insert(after, std::move(change));
  cursor = passed = changed.size();
  knowsEver = false;
}

bool TapeTopology::updateLater(const TreePtr &tree, uint32_t record) {
  Mirror *mirror = tree->mirror();
  if (record == kEnd || !tree->base() || !mirror ||
      !mirror->sparse()->isBehind())
    return false;
  return mirror->sparse()->keepActivity([this, record, tree = tree.get()] {
    for (Watched &entry : watched)
      if (entry.tree.get() == tree)
        update(entry, record);
  });
}

void TapeTopology::settle(uint32_t record) {
  // The levels of a tree are adjacent in the list of watched levels, so one
  // update serves them all.
  const Tree *later = nullptr;
  for (Watched &entry : watched) {
    if (entry.tree.get() == later)
      continue;
    if (updateLater(entry.tree, record))
      later = entry.tree.get();
    else
      update(entry, record);
  }
  cursor = passed = changed.size();
  knowsEver = false;
}

void TapeTopology::noteLoops(uint32_t record, const LoopLists &lists) {
  if (!lists.empty())
    loops[record] = lists;
}

void TapeTopology::restart() {
  // The call of epoch() runs deferred updates of earlier records, so it must
  // come before the list of changes is cleared.
  for (Watched &entry : watched)
    if (entry.tree->base())
      (void)entry.node->epoch();
  changed.clear();
  loops.clear();
  cursor = passed = 0;
  for (Watched &entry : watched)
    if (entry.tree->base())
      entry.known = entry.first = entry.node->list();
  noteRemovals(true);
}

//===----------------------------------------------------------------------===//
// Reverse
//===----------------------------------------------------------------------===//

std::vector<TapeTopology::Change>::const_iterator
TapeTopology::firstAt(uint32_t record) const {
  return std::lower_bound(
      changed.begin(), changed.end(), record,
      [](const Change &change, uint32_t r) { return change.record < r; });
}

bool TapeTopology::changes(uint32_t record, const SparseNode &node) const {
  auto at = firstAt(record);
  for (; at != changed.end() && at->record == record; ++at)
    if (at->node == &node)
      return true;
  return false;
}

Status TapeTopology::check() const {
  for (const Watched &entry : watched) {
    const std::string &label = entry.node->info().label;
    if (!entry.tree->base())
      return Status::failure(StatusCode::Usage,
                             "the tape has recorded the activity of " + label +
                                 " of tree '" + entry.tree->name() +
                                 "', which has been destroyed");
    const std::vector<int64_t> &cells = entry.known->cells;
    auto gone = entry.known->epoch == entry.node->epoch()
                    ? 0
                    : std::count_if(cells.begin(), cells.end(), [&](int64_t c) {
                        return !entry.node->isActive(c);
                      });
    if (gone)
      return Status::failure(
          StatusCode::Usage,
          std::to_string(gone) + " cells of " + label +
              " were deactivated after the tape had recorded, and the gradient "
              "may need them; take the gradient first, or replay the tape "
              "forward and backward");
  }
  return Status::success();
}

void TapeTopology::seek(uint32_t position) {
  for (; cursor > 0 && changed[cursor - 1].record >= position; --cursor) {
    const Change &change = changed[cursor - 1];
    change.node->setActivity(change.added, false);
    change.node->setActivity(change.removed, true);
  }
  for (; cursor < changed.size() && changed[cursor].record < position;
       ++cursor) {
    const Change &change = changed[cursor];
    change.node->setActivity(change.removed, false);
    change.node->setActivity(change.added, true);
  }
}

/// Visits the adjoints in the cells of a level, and in forward mode their
/// tangents.
template <typename Body>
void TapeTopology::forEachAdjoint(const SparseNode &node,
                                  const Body &body) const {
  for (const FieldPtr &field : runtime.store().fields()) {
    if (!field->isAdjoint())
      continue;
    if (field->sparseNode() == &node)
      body(*field);
    Field *tangent = runtime.recordings().isForward() ? field->dual() : nullptr;
    if (tangent && tangent->valid() && tangent->sparseNode() == &node)
      body(*tangent);
  }
}

void TapeTopology::findEver() {
  for (Watched &entry : watched) {
    std::vector<int64_t> all = entry.first->cells;
    for (const Change &change : changed)
      if (change.node == entry.node)
        all.insert(all.end(), change.added.begin(), change.added.end());
    std::sort(all.begin(), all.end());
    all.erase(std::unique(all.begin(), all.end()), all.end());
    entry.ever = std::move(all);
  }
  knowsEver = true;
}

static bool isBelow(const SparseNode *node, const SparseNode *above) {
  while (node && node != above)
    node = node->above();
  return node;
}

namespace {
/// The elements of a field in some cells, on the host or on the device,
/// wherever they are current.
class CellValues {
public:
  explicit CellValues(Field &field) : field(field), elements(field) {
    note(CellMover::find(field, elements, mover));
  }
  size_t bytes() const { return static_cast<size_t>(elements.bytes()); }
  void load(const std::vector<int64_t> &cells, char *to) const {
    if (mover)
      return note(mover->load(cells, to));
    for (size_t i = 0; i < cells.size(); ++i)
      elements.load(cells[i], to + i * bytes());
  }
  void store(const std::vector<int64_t> &cells, const char *from) const {
    if (mover)
      return note(mover->store(cells, from));
    for (size_t i = 0; i < cells.size(); ++i)
      elements.store(cells[i], from + i * bytes());
  }
  void clear(const std::vector<int64_t> &cells) const {
    if (mover)
      return note(mover->clear(cells));
    for (int64_t cell : cells)
      elements.clear(cell);
  }

private:
  void note(Status status) const {
    if (!status)
      field.tree().mirror()->context().note(std::move(status));
  }

  Field &field;
  CellElements elements;
  std::shared_ptr<CellMover> mover;
};
} // namespace

template <typename Body>
void TapeTopology::forEachCleared(uint32_t record, const Body &body) const {
  for (auto at = firstAt(record); at != changed.end() && at->record == record;
       ++at)
    for (const Watched &entry : watched) {
      if (at->cleared.empty() || !isBelow(entry.node, at->node))
        continue;
      int64_t span = entry.node->numCells() / at->node->numCells();
      std::vector<int64_t> cells;
      for (int64_t cell : at->cleared)
        for (auto below = std::lower_bound(entry.ever.begin(), entry.ever.end(),
                                           cell * span);
             below != entry.ever.end() && *below < (cell + 1) * span; ++below)
          cells.push_back(*below);
      forEachAdjoint(*entry.node,
                     [&](Field &field) { body(CellValues(field), cells); });
    }
}

void TapeTopology::beginReexecution(uint32_t record) {
  keptAdjoints.clear();
  if (!knowsEver)
    findEver();
  forEachCleared(
      record, [&](const CellValues &values, const std::vector<int64_t> &cells) {
        size_t at = keptAdjoints.size();
        keptAdjoints.resize(at + cells.size() * values.bytes());
        values.load(cells, keptAdjoints.data() + at);
      });
}

void TapeTopology::endReexecution(uint32_t record) {
  const char *kept = keptAdjoints.data();
  forEachCleared(
      record, [&](const CellValues &values, const std::vector<int64_t> &cells) {
        values.store(cells, kept);
        kept += cells.size() * values.bytes();
      });
  // Re-execution has restored the activity, except for lists that threads have
  // filled in another order.
  seek(record + 1);
}

void TapeTopology::clearAdjoints(const Change &change) {
  if (!change.cleared.empty())
    forEachAdjoint(*change.node, [&](Field &field) {
      CellValues(field).clear(change.cleared);
    });
}

void TapeTopology::enter(uint32_t record) {
  for (; passed > 0 && changed[passed - 1].record > record; --passed)
    clearAdjoints(changed[passed - 1]);
  goAfter(record);
}

int64_t TapeTopology::dropAdjoints(const Change &change, Field &field,
                                   size_t firstPassed) const {
  const std::vector<int64_t> *first = nullptr;
  for (const Watched &entry : watched)
    if (entry.node == change.node)
      first = &entry.first->cells;
  auto has = [](const std::vector<int64_t> &cells, int64_t cell) {
    return std::binary_search(cells.begin(), cells.end(), cell);
  };
  // In a cell that an earlier record has cleared, the field has no initial
  // value.
  auto wasCleared = [&](int64_t cell) {
    for (size_t i = 0; i < firstPassed; ++i)
      if (changed[i].node == change.node && has(changed[i].cleared, cell))
        return true;
    return false;
  };
  std::vector<int64_t> inactive;
  for (int64_t cell : change.cleared)
    if (!change.node->isActive(cell))
      inactive.push_back(cell);
  CellValues values(field);
  std::vector<char> held(inactive.size() * values.bytes());
  values.load(inactive, held.data());
  std::vector<int64_t> stale;
  int64_t lost = 0;
  for (size_t i = 0; i < inactive.size(); ++i) {
    auto begin = held.begin() + static_cast<ptrdiff_t>(i * values.bytes());
    if (std::all_of(begin, begin + static_cast<ptrdiff_t>(values.bytes()),
                    [](char byte) { return byte == 0; }))
      continue;
    stale.push_back(inactive[i]);
    lost += has(*first, inactive[i]) && !wasCleared(inactive[i]);
  }
  values.clear(stale);
  return lost;
}

void TapeTopology::endReverse(std::vector<std::string> &notes) {
  seek(UINT32_MAX);
  // Inactive cells hold zeros, so the adjoints in them are zeroed.
  for (size_t i = passed; i < changed.size(); ++i) {
    const Change &change = changed[i];
    if (change.cleared.empty())
      continue;
    forEachAdjoint(*change.node, [&](Field &field) {
      int64_t lost = dropAdjoints(change, field, passed);
      if (lost > 0 && field.isAdjoint())
        notes.push_back(
            "the gradient '" + field.name() + "' is lost in " +
            std::to_string(lost) + " cells of " + change.node->info().label +
            ", which were deactivated while the tape recorded and are inactive "
            "now; copy what matters to a field that stays, and differentiate "
            "by that");
    });
  }
  passed = changed.size();
  for (Watched &entry : watched)
    if (entry.tree->base())
      entry.known = entry.node->list();
}
