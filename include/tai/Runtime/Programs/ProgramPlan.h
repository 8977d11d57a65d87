//===- ProgramPlan.h - The contents of a program ----------------*- C++ -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//
//
// A plan is all that the compiler needs to know to make one kernel of a
// sequence of launches.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_RUNTIME_PROGRAMS_PROGRAMPLAN_H
#define TAI_RUNTIME_PROGRAMS_PROGRAMPLAN_H

#include "tai/Runtime/Device/Device.h"
#include "tai/Runtime/Programs/ProgramTiles.h"
#include <functional>

namespace mlir::tai::runtime {

/// A device function that becomes part of a program.
struct ProgramPart {
  /// The code of the function, see DeviceImage::bitcode; null for an unused
  /// part number. Shared, because a program may be compiled after the module of
  /// the function is gone.
  std::shared_ptr<const std::string> bitcode;
  std::string function;
  /// Whether steps in the program's table call the part, and not only loops.
  bool isInTable = true;
  /// Whether the function runs a single iteration: true for parts of tile
  /// chains.
  bool isTile = false;
  /// The maximum block size of the launches that the part replaces, if known.
  unsigned threads = 0;
};

/// Where a step in a program's loop finds one of its parameters.
struct ProgramSlot {
  enum Kind {
    /// The parameter is word number `word` of the program's parameters.
    Fixed,
    /// The parameter grows by a constant: word number `word` of the program's
    /// parameters, plus the following word times the iteration number.
    Growing,
    /// The parameter is word number `word` of the row that the loop's list has
    /// for this iteration.
    Listed
  };
  Kind kind = Fixed;
  unsigned word = 0;
};

struct ProgramLoopStep {
  uint64_t part = 0;
  /// Whether a barrier follows.
  bool waits = true;
  std::vector<ProgramSlot> slots;
};

/// Consecutive steps of a program: either a loop, or rows of the step table.
struct ProgramSegment {
  /// The steps of the loop's body; empty for a segment of table rows.
  std::vector<ProgramLoopStep> steps;
  /// The number of the loop's iterations, or of the table rows.
  size_t count = 0;
  /// The position, in the sequence, of the segment's first step.
  size_t first = 0;
  /// For a loop with a list: the position of the list in the table, and the
  /// number of words in one of its rows.
  size_t listStart = 0, listWidth = 0;

  bool isLoop() const { return !steps.empty(); }
};

/// The description from which a program is compiled.
struct ProgramPlan {
  std::vector<ProgramPart> parts;
  std::vector<ProgramSegment> segments;
  /// The tile chains of the program; the chain of part number p has index p -
  /// firstChainPart.
  std::vector<TileChain> chains;
  /// The number of 8-byte words that hold parameters of loops.
  size_t words = 0;
  /// One of TAI_SCOPE_*.
  int scope = 0;
  /// The maximum block size.
  unsigned threads = 1;
  /// Whether the program records a time stamp for each of its steps.
  bool isTimed = false;
};

/// A function that compiles a plan to one kernel, `tai_program`; see
/// tai/ABI/DeviceAbi.h. For TAI_SCOPE_LAUNCHES, it makes a kernel of each part,
/// with the parameters of the part's function. For TAI_SCOPE_NONE, it makes a
/// kernel of each part too; these parts are functions of the device library and
/// have no bitcode.
using ProgramMaker =
    std::function<Status(const ProgramPlan &plan, DeviceImage &image)>;

/// A program that another thread compiles.
class ProgramJob {
public:
  /// Destroying a job that is not done abandons the program.
  virtual ~ProgramJob() = default;
  virtual bool isDone() const = 0;
  /// Takes the compiled program, or the error. To be called once, after the job
  /// is done.
  virtual Status take(DeviceImage &image) = 0;
};

/// Starts to compile a plan and returns at once; null if no thread can do it.
using ProgramStarter =
    std::function<std::unique_ptr<ProgramJob>(ProgramPlan plan)>;

/// The form in which sequences of launches are run. Automatic unless set, by
/// tests and measurements.
enum class ProgramMode {
  Automatic,
  Launches,
  Graph,
  Block,
  Cluster,
  Grid,
  /// Like Grid; chains of stencil launches run in tiles (ProgramTiles.h).
  Tiles,
  /// Like Graph; the launches use programmatic dependent launch.
  Overlapped,
  /// Like Overlapped; fills that are not needed at once are on a parallel
  /// branch of the graph.
  Aside
};

} // namespace mlir::tai::runtime

#endif // TAI_RUNTIME_PROGRAMS_PROGRAMPLAN_H
